"""Workers end: by Ctrl-C without a traceback or another job, and with a parent that is killed."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest

SCRIPT = r"""
import os, signal, sys, time
from egocap.workers import WorkerPool

WHEN = sys.argv[1]
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs
if __name__ == "__mp_main__":
    os.write(1, b"begun\n")  # whole, also beside another worker's
    if WHEN == "starting":
        time.sleep(1.0)

def job(seconds):
    os.write(1, b"working\n")
    time.sleep(seconds)

if __name__ == "__main__":
    try:
        with WorkerPool(2) as pool:
            long = 0.0 if WHEN == "idle" else 60.0
            for future in [pool.submit(job, long) for _ in range(2 if WHEN == "idle" else 6)]:
                future.result()
            print("done", flush=True)
            time.sleep(60.0)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
"""


@pytest.mark.parametrize(
    ("when", "word", "count", "jobs"),
    [("starting", "begun", 2, 0), ("working", "working", 2, 2), ("idle", "done", 1, 2)],
)
def test_ctrl_c_is_quiet_and_begins_no_other_job(tmp_path, when, word, count, jobs):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    run = subprocess.Popen([sys.executable, script, when], text=True, start_new_session=True,
                           stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip
    try:
        said = []
        while said.count(word) < count:
            line = run.stdout.readline()
            assert line, said
            said.append(line.strip())
        os.killpg(run.pid, signal.SIGINT)
        out, err = run.communicate(timeout=50)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)
    assert (run.returncode, err) == (0, "")
    assert out.split()[-1] == "interrupted"
    assert [*said, *out.split()].count("working") <= jobs


@pytest.mark.parametrize(("when", "word"), [("working", "working"), ("idle", "done")])
def test_workers_end_with_a_parent_that_is_killed(tmp_path, when, word):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    run = subprocess.Popen([sys.executable, script, when], text=True, start_new_session=True,
                           stdout=subprocess.PIPE)  # fmt: skip
    try:
        while run.stdout.readline().strip() != word:
            pass
        run.kill()
        run.communicate(timeout=50)  # the workers hold stdout until they end
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)
