"""Exit codes, error reporting, logging and progress of the three commands."""

from __future__ import annotations

import atexit
import errno
import gc
import io
import logging
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import timedelta
from typing import TYPE_CHECKING

from egocap.errors import EgocapError, InputError, one_line

if TYPE_CHECKING:
    from tyro.extras import SubcommandApp

log = logging.getLogger(__name__)

DONE, FAILED, USAGE, MISSED, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes: done; failure of the machine; bad usage or file; a target missed; Ctrl-C."""

_ALLOCATIONS = 100_000
"""Between collections of garbage; a start makes many objects, and most of them stay."""

_EVERY_S = 5.0  # between lines of progress
_BEAT_S = 1.0  # between looks at whether a sign of life is due
_REPEAT_S = 0.05  # until an interrupt that was discarded is raised again

_WRONG_PATH = (FileNotFoundError, NotADirectoryError, IsADirectoryError, FileExistsError)

_PLAIN = {
    "Error parsing ": "",
    "invalid literal for int() with base 10": "not a whole number",
    "could not convert string to float": "not a number",
}
"""What Python and tyro say of an option's value, and what is said in place of it."""

Advance = Callable[..., None]
Within = Callable[[Sequence[str]], AbstractContextManager[Sequence[str]]]


def run(
    app: SubcommandApp, *, prog: str, description: str = "", args: Sequence[str] | None = None,
    within: Within | None = None,
) -> int:  # fmt: skip
    """Run one command of `app` and return the process's exit code.

    A command returns None (done) or an exit code. An EgocapError becomes one line on stderr and the
    error's exit code; so do a full disk, a missing path, a closed pipe, Ctrl-C and SIGTERM. Any
    other exception is a bug and keeps its traceback.

    Args:
        app: subcommands; booleans become flags without a `--no-` twin.
        prog: the command's name in its help.
        description: summary in its help.
        args: command line; that of the process when None.
        within: what the command runs in, given the words; its value are the words that are read.
    """
    import tyro

    from egocap.options import registry

    words = sys.argv[1:] if args is None else args
    _collect_rarely()
    _open_closed_streams()
    _log_to_stderr()
    box = io.StringIO()
    try:
        with (
            _wrong_usage_to(box), _sigterm_as_interrupt(), _lost_interrupts_repeated(),
            registry, (within or nullcontext)(words) as read,
        ):  # fmt: skip
            _require_command(app, read)
            listed = _in_brief(app) if list(read) in (["-h"], ["--help"]) else app
            code = listed.cli(
                prog=prog, description=description, args=read,
                config=(tyro.conf.FlagCreatePairsOff,),
            )  # fmt: skip
        sys.stdout.flush()
    except SystemExit as stop:  # tyro: --help is 0, wrong usage 2
        if text := box.getvalue():
            command = f"{prog} {words[0]}" if words and words[0][:1] != "-" else prog
            _report(prog, _without_box(text).replace(f"(see {prog} -", f"(see {command} -"))
        return stop.code if isinstance(stop.code, int) else (USAGE if stop.code else DONE)
    except EgocapError as error:
        _report(prog, str(error))
        return error.exit_code
    except KeyboardInterrupt:
        _report(prog, "interrupted")
        return INTERRUPTED
    except SystemError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # as compiled code returned
            raise
        _report(prog, "interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # the reader of stdout has closed the pipe (`| head`): avoid a second error at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except OSError as error:
        if error.errno is None or error.strerror is None:
            raise
        where = f"{error.filename}: " if error.filename else ""
        hint = "; free some space and run the same command again" * (error.errno == errno.ENOSPC)
        _report(prog, one_line(f"{where}{error.strerror}{hint}"))
        log.debug("traceback", exc_info=True)
        return USAGE if isinstance(error, _WRONG_PATH) else FAILED
    return DONE if code is None else int(code)


def _require_command(app: SubcommandApp, words: Sequence[str]) -> None:
    """Raise InputError where the first word is neither an option nor a command."""
    known = sorted(name.replace("_", "-") for name in app._subcommands)
    if words and not words[0].startswith("-") and words[0].replace("_", "-") not in known:
        raise InputError(f"no command '{words[0]:.40}'", valid=known)


def _in_brief(app: SubcommandApp) -> SubcommandApp:
    """The same commands in alphabetical order, with the first paragraph of their help alone."""
    from dataclasses import replace

    from tyro.extras import SubcommandApp

    brief = SubcommandApp()
    for name, command in sorted(app._subcommands.items()):  # no public list in tyro 1.0.17
        told = command.help or command.target.__doc__ or ""
        brief._subcommands[name] = replace(command, help=" ".join(told.split("\n\n")[0].split()))
    return brief


def _collect_rarely() -> None:
    """Look for garbage less often, and not at the end: it takes up to a second of a command."""
    gc.set_threshold(_ALLOCATIONS)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)


def start(prog: str, program: Callable[[], int]) -> int:
    """Run what imports a program and runs it; returns its exit code, also for Ctrl-C meanwhile.

    `--version` alone prints the version instead.
    """
    if sys.argv[1:] == ["--version"]:
        from egocap import __version__

        print(prog, __version__)
        return DONE
    try:
        return program()
    except EgocapError as error:  # a package that a command needs is missing
        _report(prog, str(error))
        return error.exit_code
    except KeyboardInterrupt:
        _report(prog, "interrupted")
        return INTERRUPTED


@contextmanager
def progress(
    what: str, total: int, *, unit: str = "frames", every: float | None = None
) -> Iterator[Advance]:
    """Show progress on stderr: a bar on a terminal, otherwise a line every `every` seconds
    (5 by default).

    Yields a function to call with the number of units just finished (1 by default). The rate is
    measured from its first call on, which may report units finished by an earlier run. Until there
    is a rate, the time so far is shown, and whether kernels are compiled; without units (`total`
    0) always.
    """
    report = _bar if sys.stderr.isatty() else _lines
    every = _EVERY_S if every is None else every
    with _compilation() as compiling, report(what, _Pace(total, unit, compiling), every) as advance:
        yield advance


@contextmanager
def _compilation() -> Iterator[Callable[[], bool]]:
    """Yields a function that tells whether numba compiles at the moment."""
    events = sys.modules.get("numba.core.event")
    if events is None:
        yield lambda: False
        return
    with events.install_recorder("numba:compile") as found:
        yield lambda: sum(1 if event.is_start else -1 for _, event in found.buffer) > 0


class _Pace:
    """Units done, rate, and remaining time at that rate."""

    def __init__(self, total: int, unit: str, compiling: Callable[[], bool]) -> None:
        self.total, self.unit, self.done, self._compiling = total, unit, 0, compiling
        self._from: tuple[int, float] | None = None
        self._start = time.monotonic()

    def add(self, count: int) -> None:
        self.done += count
        if self._from is None:
            self._from = self.done, time.monotonic()

    def __str__(self) -> str:
        shown = f"{self.done}/{self.total} {self.unit}" if self.total else "running"
        before, since = self._from or (0, self._start)
        if before == self.done:
            if self.done < self.total or not self.total:  # no rate yet
                so_far = round(time.monotonic() - self._start)
                why = ", compiling (once a machine)" * self._compiling()
                return f"{shown}, {timedelta(seconds=so_far)} so far{why}" if so_far else shown
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
        task = bar.add_task(what, total=pace.total or None, pace="")

        def show() -> None:
            bar.update(task, completed=pace.done, pace=str(pace))

        def advance(count: int = 1) -> None:
            pace.add(count)
            show()

        with repeated(show, lambda: _BEAT_S):
            yield advance
        show()


@contextmanager
def _lines(what: str, pace: _Pace, every: float) -> Iterator[Advance]:
    last, shown = time.monotonic(), 0

    def advance(count: int = 1) -> None:
        pace.add(count)
        show_if_due()

    def show_if_due() -> None:
        nonlocal last
        unfinished = pace.done < pace.total or not pace.total
        if unfinished and time.monotonic() - last >= every:
            last = time.monotonic()
            show()

    def show() -> None:
        nonlocal shown
        shown = pace.done
        print(f"{what}: {pace}", file=sys.stderr, flush=True)

    try:
        with repeated(show_if_due, lambda: _BEAT_S):
            yield advance
    except EgocapError:
        shown = pace.done  # its message is enough
        raise
    finally:
        if pace.done != shown:
            show()


@contextmanager
def repeated(function: Callable[[], None], wait: Callable[[], float]) -> Iterator[None]:
    """Call a function in a thread meanwhile, each time after the seconds that `wait` tells."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(wait()):
            function()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def _wrong_usage_to(box: io.StringIO) -> Iterator[None]:
    """Let tyro print what it says of wrong options into `box`, and nothing else."""
    from tyro import _errors  # the hook of tyro 1.0.17; the lock file pins it

    stderr = sys.stderr

    def collect(event: object) -> None:
        sys.stderr = box

    try:
        with _errors.on_parse_error(collect):
            yield
    finally:
        sys.stderr = stderr


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Have SIGTERM raise KeyboardInterrupt, so that temporary files and locks are removed."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _lost_interrupts_repeated() -> Iterator[None]:
    """Repeat an interrupt that arrived where Python discards exceptions, as in callbacks of C code.

    Numba's compiler calls back into Python: without this, Ctrl-C there prints a traceback and the
    command goes on.
    """
    before = sys.unraisablehook

    def repeat(unraisable: sys.UnraisableHookArgs) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            before(unraisable)
            return
        main = threading.main_thread().ident
        again = threading.Timer(_REPEAT_S, signal.pthread_kill, (main, signal.SIGINT))
        again.daemon = True
        again.start()

    sys.unraisablehook = repeat
    try:
        yield
    finally:
        sys.unraisablehook = before


def _without_box(text: str) -> str:
    """The lines of tyro's box as one line, with the command that shows the help."""
    lines = [line.strip("│╭╮╰╯|+ ") for line in re.sub(r"\x1b\[[0-9;]*m", "", text).split("\n")]
    parts = re.split("─{3,}|-{3,}", " ".join(lines))
    rest = [" ".join(part.split()) for part in (p.strip("─• ") for p in parts[1:]) if part]
    helps = [p for p in rest if p.startswith("For full helptext")]
    where = re.split("(?:run|see):? ", helps[0])[-1] if helps else ""
    told = [p for p in rest if p not in helps and not p.startswith("Argument helptext")]
    said = "; ".join(told) or parts[0].strip("─ ")
    for python, plain in _PLAIN.items():
        said = said.replace(python, plain)
    return one_line(said, 240) + (f" (see {where})" if where else "")


def _report(prog: str, message: str) -> None:
    sys.stdout.flush()
    print(f"{prog}: {message}", file=sys.stderr, flush=True)


def _open_closed_streams() -> None:
    """Give a process that was started without stdin, stdout or stderr null devices in place.

    Otherwise the first file that it opens would get the number of stdout, and what is printed.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) < 3:
        pass
    os.close(number)
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w"))


class _OneLine(logging.Formatter):
    """Messages in one line, as errors are: they may quote a file of any content."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = one_line(record.message)
        return super().formatMessage(record)


def _log_to_stderr() -> None:
    """Log this project at INFO (or $EGOCAP_LOG), other packages at WARNING."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine("%(name)s: %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    level = os.environ.get("EGOCAP_LOG", "INFO").upper()
    for name in ("egocap", "egocap_sim", "egocap_eval"):
        logging.getLogger(name).setLevel(level if level in logging.getLevelNamesMapping() else 20)
