"""What the three commands share: exit codes, errors without tracebacks, logs and progress."""

from __future__ import annotations

import errno
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

from egocap.errors import EgocapError

if TYPE_CHECKING:
    from tyro.extras import SubcommandApp

log = logging.getLogger(__name__)

DONE, FAILED, USAGE, MISSED, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes: done; failed or the machine cannot; bad usage or file; a threshold missed; Ctrl-C."""

_WRONG_PATH = (FileNotFoundError, NotADirectoryError, IsADirectoryError, FileExistsError)

Advance = Callable[..., None]


def run(
    app: SubcommandApp, *, prog: str, description: str = "", args: Sequence[str] | None = None
) -> int:
    """Run one command of `app` and return the process's exit code.

    A command returns None (done) or an exit code. Its EgocapError becomes one line on stderr and
    the error's own exit code; so do a full disk, a path that leads nowhere, a closed pipe and
    Ctrl-C. Any other exception is a bug of ours and keeps its traceback.

    Args:
        app: subcommands; booleans become flags without a `--no-` twin.
        prog: the command's name in its help.
        description: what the command is, for its help.
        args: words of the command line; the process's own when None.
    """
    import tyro

    _log_to_stderr()
    try:
        code = app.cli(
            prog=prog, description=description, args=args, config=(tyro.conf.FlagCreatePairsOff,)
        )
        sys.stdout.flush()
    except SystemExit as stop:  # tyro: --help is 0, wrong usage 2
        return stop.code if isinstance(stop.code, int) else (USAGE if stop.code else DONE)
    except EgocapError as error:
        _complain(prog, str(error))
        return error.exit_code
    except KeyboardInterrupt:
        _complain(prog, "interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # whoever read our output has gone (`| head`); keep Python from complaining at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except OSError as error:
        if error.errno is None or error.strerror is None:
            raise
        where = f"{error.filename}: " if error.filename else ""
        hint = "; free some space and run the same command again" * (error.errno == errno.ENOSPC)
        _complain(prog, f"{where}{error.strerror}{hint}")
        log.debug("where it came from", exc_info=True)
        return USAGE if isinstance(error, _WRONG_PATH) else FAILED
    return DONE if code is None else int(code)


@contextmanager
def progress(
    what: str, total: int, *, unit: str = "frames", every: float = 5.0
) -> Iterator[Advance]:
    """Show how far some work is, on stderr: a bar on a terminal, a line now and then elsewhere.

    Yields a function to call with the number of units just finished (1 by default). The rate counts
    from its first call on, which may tell what an earlier run left. `every` is the least time in
    seconds between two lines.
    """
    report = _bar if sys.stderr.isatty() else _lines
    with report(what, _Pace(total, unit), every) as advance:
        yield advance


class _Pace:
    """How far work is, how fast it goes, and how long the rest takes at that rate."""

    def __init__(self, total: int, unit: str) -> None:
        self.total, self.unit, self.done = total, unit, 0
        self._from: tuple[int, float] | None = None
        self._start = time.monotonic()

    def add(self, count: int) -> None:
        self.done += count
        if self._from is None:
            self._from = self.done, time.monotonic()

    def __str__(self) -> str:
        shown = f"{self.done}/{self.total} {self.unit}"
        before, since = self._from or (0, self._start)
        if before == self.done:
            if self.done < self.total:  # nothing to go by yet
                return shown
            before, since = 0, self._start
        rate = (self.done - before) / max(time.monotonic() - since, 1e-9)
        shown += f", {rate:.1f} {self.unit}/s"
        if self.done < self.total:
            shown += f", {timedelta(seconds=round((self.total - self.done) / rate))} left"
        return shown


@contextmanager
def _bar(what: str, pace: _Pace, every: float) -> Iterator[Advance]:
    from rich import progress as columns
    from rich.console import Console

    with columns.Progress(
        columns.TextColumn("{task.description}"),
        columns.BarColumn(),
        columns.TextColumn("{task.fields[pace]}"),
        console=Console(stderr=True),
    ) as bar:
        task = bar.add_task(what, total=pace.total, pace="")

        def advance(count: int = 1) -> None:
            pace.add(count)
            bar.update(task, completed=pace.done, pace=str(pace))

        yield advance


@contextmanager
def _lines(what: str, pace: _Pace, every: float) -> Iterator[Advance]:
    last, said = time.monotonic(), 0

    def advance(count: int = 1) -> None:
        nonlocal last
        pace.add(count)
        if pace.done < pace.total and time.monotonic() - last >= every:
            last = time.monotonic()
            say()

    def say() -> None:
        nonlocal said
        said = pace.done
        print(f"{what}: {pace}", file=sys.stderr, flush=True)

    try:
        yield advance
    finally:
        if pace.done != said:
            say()


def _complain(prog: str, message: str) -> None:
    sys.stdout.flush()
    print(f"{prog}: {message}", file=sys.stderr, flush=True)


def _log_to_stderr() -> None:
    """Messages of this project at INFO, of other packages at WARNING; EGOCAP_LOG=DEBUG for more."""
    logging.basicConfig(stream=sys.stderr, format="%(name)s: %(message)s", level=logging.WARNING)
    level = os.environ.get("EGOCAP_LOG", "INFO").upper()
    for name in ("egocap", "egocap_sim", "egocap_eval"):
        logging.getLogger(name).setLevel(level if level in logging.getLevelNamesMapping() else 20)
