import errno
import io
import logging
import os
import subprocess
import sys
import time
import types
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import pytest
from numba.core import event
from tyro.extras import SubcommandApp

from egocap import commandline
from egocap.commandline import progress, run, start
from egocap.errors import FileError, InputError, MachineError


def code_of(command, *args):
    app = SubcommandApp()
    app.command(command, name="do")
    return run(app, prog="thing", args=["do", *args])


def from_compiled_code(interruption):
    """What C code raises that returned a result although a signal's handler had raised."""
    error = SystemError("solve_frame returned a result with an exception set")
    error.__cause__ = interruption
    return error


def raising(error):
    def do() -> None:
        raise error

    return do


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("no such motion", valid=["walk", "squat"]), 2),
        (FileError("a.toml", "unknown key", key="rig", line=3), 2),
        (MachineError("no OpenGL", remedy="install libegl1"), 1),
        (OSError(errno.ENOSPC, "No space left on device", "x.tar"), 1),
        (PermissionError(errno.EACCES, "Permission denied", "/locked/x"), 1),
        (FileExistsError(errno.EEXIST, "File exists", "a.toml"), 2),
        (KeyboardInterrupt(), 130),
        (from_compiled_code(KeyboardInterrupt()), 130),
    ],
)
def test_errors_become_one_line_and_a_code(error, code, capsys):
    assert code_of(raising(error)) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("thing: ") and captured.err.count("\n") == 1
    assert "Traceback" not in captured.err


def test_messages_say_what_is_valid_and_where(capsys):
    code_of(raising(InputError("no such motion", valid=["walk", "squat"])))
    assert capsys.readouterr().err == "thing: no such motion (valid: walk, squat)\n"
    code_of(raising(OSError(errno.ENOSPC, "No space left on device", "x.tar")))
    assert "x.tar: No space left" in capsys.readouterr().err


@pytest.mark.parametrize(("returned", "code"), [(None, 0), (0, 0), (3, 3)])
def test_commands_return_their_code(returned, code):
    assert code_of(lambda: returned) == code


def test_a_package_missing_at_start_is_said(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["thing", "do"])
    assert start("thing", raising(MachineError("no torch", remedy="pip install it"))) == 1
    assert capsys.readouterr().err == "thing: no torch; pip install it\n"


@pytest.mark.parametrize("bug", [ZeroDivisionError(), from_compiled_code(ValueError())])
def test_bugs_keep_their_traceback(bug):
    with pytest.raises(type(bug)):
        code_of(raising(bug))


@pytest.mark.parametrize("args", [[], ["undo"], ["do"], ["do", "--count", "x"], ["do", "--no"]])
def test_wrong_usage_is_2_on_stderr(args, capsys):
    app = SubcommandApp()

    @app.command
    def do(count: int) -> None: ...

    assert run(app, prog="thing", args=args) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert captured.err.startswith("thing: ") and len(captured.err) <= 300


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["undo"], "no command 'undo' (valid: do, other)"),
        (["do"], "--count"),
        (["do", "--count", "1", "--nonsense"], "(see thing do --help)"),
        (["do", "--count", "x"], "count"),
        (["do", "--count", "1", "--kind", "c"], "'a', 'b'"),
        (["do", "--count", "1", "--a\x07b"], "x07"),
        (["do", "--count", "1", *["--nonsense"] * 500], "Unrecognized"),
    ],
)
def test_wrong_usage_names_what_is_wrong(args, said, capsys):
    app = SubcommandApp()

    @app.command
    def do(count: int, kind: Literal["a", "b"] = "a") -> None: ...

    @app.command
    def other() -> None: ...

    assert run(app, prog="thing", args=args) == 2
    shown = capsys.readouterr().err
    assert said in shown and shown.strip().isprintable() and len(shown) <= 300
    assert not set("│╭╯") & set(shown)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--count", "1.5"], "--count: not a whole number: '1.5'"),
        (["--share", "half"], "--share: not a number: 'half'"),
        (["--size", "320"], "Missing value for argument '--size'. Expected 2 values."),
        (["--kind", "c"], "invalid choice 'c' for argument '--kind'. Expected one of ('a', 'b')."),
    ],
)
def test_wrong_values_of_options_that_may_be_left_out_are_named_plainly(args, said, capsys):
    def do(
        count: int | None = None, share: float = 0.5, size: tuple[int, int] | None = None,
        kind: Literal["a", "b"] | None = None,
    ) -> int:  # fmt: skip
        return 3 if count is size is kind is None else 4

    assert code_of(do) == 3 and code_of(do, "--count", "1", "--size", "3", "4") == 4
    capsys.readouterr()
    assert code_of(do, *args) == 2
    assert capsys.readouterr().err.startswith(f"thing: {said} (see thing ")
    assert code_of(do, "--help") == 0
    assert "--count INT " in (shown := capsys.readouterr().out) and "{None}" not in shown


def test_what_a_command_writes_to_stderr_is_left_as_it_is(capsys):
    def do() -> None:
        print("│ box │\n│ more │", file=sys.stderr)
        raise SystemExit(2)

    assert code_of(do) == 2
    assert capsys.readouterr().err == "│ box │\n│ more │\n"


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(closed, tmp_path):
    # the first file opened must not take the place of stdout
    script = (
        "import sys; from tyro.extras import SubcommandApp; from egocap.commandline import run\n"
        "app = SubcommandApp()\n"
        "def do() -> None:\n"
        f"    file = open({str(tmp_path / 'file')!r}, 'w'); print('lost'); file.write('kept')\n"
        "    file.close(); print('lost', file=sys.stderr)\n"
        "app.command(do, name='do'); app.command(do, name='again')\n"
        "sys.exit(run(app, prog='thing', args=sys.argv[1:]))\n"
    )
    for args, code in (("do", 0), ("--help", 0), ("undo", 2)):
        command = f'{sys.executable} -c "$SCRIPT" {args} {closed}'
        env = os.environ | {"SCRIPT": script}
        assert subprocess.run(["bash", "-c", command], env=env).returncode == code
    assert (tmp_path / "file").read_text() == "kept"


def test_help_is_0_and_flags_have_no_twin(capsys):
    app = SubcommandApp()

    @app.command
    def do(json: bool = False) -> None: ...

    assert run(app, prog="thing", args=["do", "--help"]) == 0
    out = capsys.readouterr().out
    assert "--json" in out and "--no-json" not in out


def test_a_closed_pipe_is_quiet():
    code = (
        "import sys; from tyro.extras import SubcommandApp; from egocap.commandline import run\n"
        "app = SubcommandApp()\n"
        "@app.command\n"
        "def do() -> None:\n"
        "    for _ in range(100_000): print('many words')\n"
        "sys.exit(run(app, prog='thing', args=['do']))"
    )
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(20) == 1


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass only when they are added."""
    clock = types.SimpleNamespace(now=100.0)
    monkeypatch.setattr(commandline.time, "monotonic", lambda: clock.now)
    return clock


def test_progress_prints_plain_lines_where_there_is_no_terminal(capsys, clock):
    with progress("render", 10) as advance:
        for _ in range(5):
            clock.now += 4.0
            advance(2)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "render: 4/10 frames, 0.5 frames/s, 0:00:12 left",
        "render: 8/10 frames, 0.5 frames/s, 0:00:04 left",
        "render: 10/10 frames, 0.5 frames/s",
    ]


def test_progress_goes_by_the_rate_of_this_run(capsys, clock):
    with progress("render", 1000, every=1.0) as advance:
        advance(900)  # what an earlier run left
        clock.now += 5.0
        advance(10)
        clock.now += 45.0
        advance(90)
    first, last = capsys.readouterr().err.splitlines()
    assert first == "render: 910/1000 frames, 2.0 frames/s, 0:00:45 left"
    assert last == "render: 1000/1000 frames, 2.0 frames/s"


def test_progress_says_while_kernels_are_compiled(capsys, clock, monkeypatch):
    beats = []
    monkeypatch.setattr(
        commandline, "repeated", lambda function, wait: nullcontext(beats.append(function))
    )
    with progress("track", 10, every=1.0):
        clock.now += 6.0
        with event.trigger_event("numba:compile"):
            beats[0]()
        clock.now += 6.0
        beats[0]()
    during, after = capsys.readouterr().err.splitlines()
    assert during == "track: 0/10 frames, 0:00:06 so far, compiling (once a machine)"
    assert after == "track: 0/10 frames, 0:00:12 so far"


def test_a_list_of_commands_shows_the_first_sentences_in_order(capsys):
    app = SubcommandApp()

    @app.command(name="write")
    def write(number: int) -> None:
        """Write a number.

        In Roman numerals.
        """

    @app.command(name="add")
    def add(number: int) -> None:
        """Add one to a number."""

    assert run(app, prog="sums", args=["--help"]) == 0
    listed = capsys.readouterr().out
    assert listed.index("Add one") < listed.index("Write a number.") and "Roman" not in listed
    assert run(app, prog="sums", args=["write", "--help"]) == 0
    assert "In Roman numerals." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("total", "shown"), [(10, "track: 0/10 frames, 0:00:12 so far"), (0, "track: running, 0:00:12")]
)
def test_progress_shows_life_before_anything_is_finished(total, shown, capsys, monkeypatch, clock):
    monkeypatch.setattr(commandline, "_BEAT_S", 0.01)
    with progress("track", total):
        clock.now += 12.0
        time.sleep(0.2)
    first, *_ = capsys.readouterr().err.splitlines()
    assert first.startswith(shown)


def test_progress_says_how_far_it_came_when_stopped(capsys):
    with pytest.raises(KeyboardInterrupt), progress("render", 10) as advance:
        advance()
        raise KeyboardInterrupt
    assert "render: 1/10 frames" in capsys.readouterr().err


def test_an_error_of_the_user_stays_one_line(capsys):
    with pytest.raises(InputError), progress("fit-body", 10) as advance:
        advance()
        raise InputError("no detection to fit a body to")
    assert capsys.readouterr().err == ""


def test_progress_draws_a_bar_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setitem(os.environ, "TERM", "xterm-256color")
    with progress("render", 2, unit="clips") as advance:
        advance(2)
        time.sleep(0.01)
    shown = sys.stderr.getvalue()
    assert "render" in shown and "2/2" in shown and "clips/s" in shown


def test_ctrl_c_while_a_program_is_imported_is_one_line(capsys):
    def program():
        raise KeyboardInterrupt

    assert commandline.start("slow", program) == commandline.INTERRUPTED
    assert capsys.readouterr().err == "slow: interrupted\n"


def test_ctrl_c_in_a_callback_of_compiled_code_ends_the_command(tmp_path):
    """ctypes discards what a callback raises, as llvmlite does in numba's compiler."""
    script = tmp_path / "script.py"
    script.write_text(
        "import ctypes, signal, sys, time\n"
        "from tyro.extras import SubcommandApp\n"
        "from egocap.commandline import run\n"
        "def compiled():\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    call = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))\n"
        "    call()\n"
        "    time.sleep(60)\n"
        "app = SubcommandApp()\n"
        "app.command(compiled, name='one')\n"
        "app.command(lambda: None, name='two')\n"
        "sys.exit(run(app, prog='x', args=['one']))\n"
    )
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=50)
    assert (ran.returncode, ran.stderr) == (commandline.INTERRUPTED, "x: interrupted\n")


def test_messages_that_quote_a_file_are_one_short_line(capsys):
    record = logging.LogRecord(
        "egocap.a", logging.WARNING, "", 0, "%s: no %s", ("f", "\x1b[31m\n" + "é" * 9000), None
    )
    line = commandline._OneLine("%(name)s: %(message)s").format(record)
    assert line.startswith("egocap.a: f: no \\x1b[31m") and len(line) < 330 and line.isprintable()


def test_garbage_is_looked_for_rarely_and_not_at_the_end(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import atexit, gc\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 1000, gc.get_threshold()[0]))\n"
        "from tyro.extras import SubcommandApp\n"
        "from egocap.commandline import run\n"
        "app = SubcommandApp()\n"
        "app.command(lambda: None, name='one')\n"
        "app.command(lambda: None, name='two')\n"
        "run(app, prog='x', args=['one'])\n"
    )
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert ran.stdout.split() == ["True", "100000"], ran.stderr
