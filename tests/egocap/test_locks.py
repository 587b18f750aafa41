"""Locks of outputs: one writer at a time, who holds it, and no left-overs."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from egocap.errors import FileError, MachineError
from egocap.locks import holding, locks

HOLD = """
import sys, time
from pathlib import Path
from egocap.locks import holding
with holding(Path(sys.argv[1]), folder=sys.argv[2] == "folder"):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=["file", "folder"])
def held(request, tmp_path):
    """An output whose lock another process holds, what it is, and that process."""
    target = tmp_path / "made" / "out"
    words = [sys.executable, "-c", HOLD, str(target), request.param]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield target, request.param == "folder", process
    process.kill()
    process.wait()
    process.stdout.close()


def test_second_writer_is_told_who_writes_and_since_when(held):
    target, folder, process = held
    with pytest.raises(MachineError) as caught, holding(target, folder=folder):
        pass
    message = str(caught.value)
    assert str(target) in message and f"process {process.pid} on {os.uname().nodename}" in message
    assert "since 20" in message and "`-c" in message and "\n" not in message


def test_lock_of_a_killed_process_is_taken_over(held):
    target, folder, process = held
    process.send_signal(signal.SIGKILL)
    process.wait()
    with holding(target, folder=folder):
        pass
    assert not list(target.parent.glob(".*.lock")) and not list(target.glob(".lock"))


def test_nothing_is_left_of_a_failed_run_and_results_stay(tmp_path):
    with pytest.raises(ValueError), holding(tmp_path / "a" / "b" / "out.npz"):
        raise ValueError
    assert not list(tmp_path.iterdir())
    with holding(tmp_path / "a" / "out", folder=True):
        (tmp_path / "a" / "out" / "x").write_text("1")
    assert [p.name for p in tmp_path.rglob("*")] == ["a", "out", "x"]


def test_what_killed_processes_left_is_removed_in_folders_that_nobody_locks(tmp_path):
    left, held, kept = (tmp_path / name / ".a.npz.4711.tmp" for name in ("run", "held", "run/deep"))
    for file in (left, held, kept):
        file.parent.mkdir()
        file.touch()
    with holding(held.parent / "b.npz"):
        with holding(tmp_path, folder=True):
            pass
        with holding(tmp_path / "out.npz"):
            pass
    assert not left.exists()
    assert held.exists() and kept.exists()


def test_full_disk_leaves_no_lock(tmp_path, monkeypatch):
    def full(number, note):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(MachineError, match="disk is full"), holding(tmp_path / "a" / "out"):
            pass
    assert not list(tmp_path.iterdir())
    with holding(tmp_path / "a" / "out"):
        pass


def test_temporary_files_of_this_output_alone_are_removed(tmp_path):
    stale = [".out.npz.123.tmp", ".out.npz.123.tmp.npz"]
    others = [
        ".out.npz.tmp",
        ".other.npz.123.tmp",
        "out.npz",
        "truth.draft.tmp",
        ".out.npz.12x.tmp",
    ]
    for name in stale + others:
        (tmp_path / name).touch()
    with holding(tmp_path / "out.npz"):
        left = {p.name for p in tmp_path.iterdir()}
    assert left == {*others, ".out.npz.lock"}
    with holding(tmp_path, folder=True):
        pass
    assert {p.name for p in tmp_path.iterdir()} == {*others} - {".other.npz.123.tmp"}


def test_link_in_place_of_the_lock_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / ".out.lock").symlink_to(victim)
    with pytest.raises(OSError), holding(tmp_path / "out"):
        pass
    assert victim.read_text() == "mine"


def test_folder_in_place_of_a_file_is_refused_before_any_work(tmp_path):
    with pytest.raises(FileError, match="is a folder"), holding(tmp_path):
        pass


def test_decorated_command_holds_the_locks_of_its_outputs(tmp_path):
    @locks("out", "page")
    def command(out, page=None):
        return sorted(p.name for p in tmp_path.iterdir())

    assert command(tmp_path / "a", page=tmp_path / "b") == [".a.lock", ".b.lock"]
    assert command(tmp_path / "a") == [".a.lock"]
    assert not list(tmp_path.iterdir())
