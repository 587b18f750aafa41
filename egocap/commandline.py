"""What the three commands share: exit codes, errors without tracebacks, logs and progress."""

from __future__ import annotations

import errno
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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

    Yields a function to call with the number of units just finished (1 by default). `every` is the
    least time in seconds between two lines.
    """
    report = _bar if sys.stderr.isatty() else _lines
    with report(what, total, unit, every) as advance:
        yield advance


@contextmanager
def _bar(what: str, total: int, unit: str, every: float) -> Iterator[Advance]:
    from rich import progress as columns
    from rich.console import Console

    with columns.Progress(
        columns.TextColumn("{task.description}"),
        columns.BarColumn(),
        columns.MofNCompleteColumn(),
        columns.TextColumn("{task.fields[rate]}"),
        columns.TimeRemainingColumn(),
        console=Console(stderr=True),
    ) as bar:
        task = bar.add_task(what, total=total, rate="")
        start, done = time.monotonic(), 0

        def advance(count: int = 1) -> None:
            nonlocal done
            done += count
            bar.update(task, completed=done, rate=_rate(done, start, unit))

        yield advance


@contextmanager
def _lines(what: str, total: int, unit: str, every: float) -> Iterator[Advance]:
    start = last = time.monotonic()
    done = said = 0

    def advance(count: int = 1) -> None:
        nonlocal done, last
        done += count
        if done < total and time.monotonic() - last >= every:
            last = time.monotonic()
            say()

    def say() -> None:
        nonlocal said
        said = done
        line = f"{what}: {done}/{total} {unit}, {_rate(done, start, unit)}"
        print(line, file=sys.stderr, flush=True)

    try:
        yield advance
    finally:
        if done != said:
            say()


def _rate(done: int, start: float, unit: str) -> str:
    return f"{done / max(time.monotonic() - start, 1e-9):.1f} {unit}/s"


def _complain(prog: str, message: str) -> None:
    sys.stdout.flush()
    print(f"{prog}: {message}", file=sys.stderr, flush=True)


def _log_to_stderr() -> None:
    """Messages of this project at INFO, of other packages at WARNING; EGOCAP_LOG=DEBUG for more."""
    logging.basicConfig(stream=sys.stderr, format="%(name)s: %(message)s", level=logging.WARNING)
    level = os.environ.get("EGOCAP_LOG", "INFO").upper()
    for name in ("egocap", "egocap_sim", "evals"):
        logging.getLogger(name).setLevel(level if level in logging.getLevelNamesMapping() else 20)
