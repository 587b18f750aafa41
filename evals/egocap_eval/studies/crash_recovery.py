"""Kill a generation repeatedly and verify that its result is complete and byte-identical.

`egocap-sim generate` receives SIGKILLs at random times, each for the parent or one of its workers;
a killed parent is restarted with the same command. After the kills it runs to the end. The data set
is verified, and some episodes are generated again without kills and compared byte for byte.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from egocap.errors import InputError, MachineError
from egocap.evaluation.table import Table
from egocap_eval.harness.study import Outcome

SPAWNED = "spawn_main"  # in the command line of a worker
SEED = 0  # of times and processes
SETTLE_S = 0.2


def study(
    folder: Annotated[Path, arg(metavar="DIR")],
    scene: str = "train-varied",
    frames: int = 20_000,
    minutes: float = 30.0,
    kills: int = 50,
    workers: int = 2,
    sample: int = 5,
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
) -> Outcome:
    """Kill a generation repeatedly; the result must be complete and byte-identical.

    Args:
        folder: Folder of the data set, which takes longer than the kills; a part is continued.
        scene: Scene of episodes.
        frames: Stereo frames in all.
        minutes: Duration of the kills.
        kills: Number of SIGKILLs, at random times.
        workers: Rendering processes.
        sample: Episodes to generate again without kills and compare.
        motions: Folder of clips to mix in.
    """
    if frames < 1 or kills < 0 or minutes <= 0 or workers < 1 or sample < 0:
        raise InputError("frames, minutes and workers are above 0; kills and sample at least 0")
    words = ["-m", "egocap_sim", "generate", scene, "--out", str(folder),
             "--frames", str(frames), "--workers", str(workers)]  # fmt: skip
    if motions is not None:
        words += ["--motions", str(motions)]
    command = [sys.executable, *words]
    begun = time.perf_counter()
    killed = run_with_kills(command, folder, 60 * minutes, kills)
    rest = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    seconds = time.perf_counter() - begun
    if rest.returncode:
        raise MachineError(f"the last run ended with {rest.returncode}: {shlex.join(command)}")
    result: dict[str, Any] = {**killed, "seconds": seconds, **verify_dataset(folder, sample)}
    missed = [*result["problems"]]
    if result["kills"] < kills:
        missed.append(f"{result['kills']} of {kills} kills: the data set was complete before")
    if result["frames"] != frames:
        missed.append(f"{result['frames']} frames, not {frames}")
    if result["different"]:
        missed.append(f"other bytes without kills: {', '.join(result['different'])}")
    rows = tuple((k, str(v)) for k, v in result.items() if not isinstance(v, list))
    return Outcome(result, [Table("Killed and continued", ("what", "found"), rows)], missed)


def run_with_kills(command: list[str], folder: Path, seconds: float, kills: int) -> dict[str, Any]:
    """Run a command while its processes are killed at random times; stop it at the end."""
    rng = np.random.default_rng(SEED)
    moments = np.sort(rng.uniform(0.0, seconds, kills))
    counts = {"kills": 0, "parents": 0, "workers": 0, "restarts": 0}
    start = time.perf_counter()
    running = _start(command)
    try:
        for moment in moments:
            while True:
                if running.poll() is not None:  # checked at least once between two kills
                    if running.returncode == 0:
                        return counts  # finished early
                    running = _start(command)
                    counts["restarts"] += 1
                if (left := moment - (time.perf_counter() - start)) <= 0:
                    break
                time.sleep(min(0.1, left))
            kind = "workers" if rng.random() < 0.5 else "parents"
            victims = _workers(running.pid) if kind == "workers" else []
            if not victims:
                kind, victims = "parents", [running.pid]
            try:
                os.kill(int(rng.choice(victims)), signal.SIGKILL)
            except ProcessLookupError:
                continue  # already ended
            counts["kills"] += 1
            counts[kind] += 1
            time.sleep(SETTLE_S)
    finally:
        if running.poll() is None:
            running.send_signal(signal.SIGINT)
        running.wait()
    return counts


def _start(command: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def _workers(parent: int) -> list[int]:
    """Process ids of a process's spawned workers, from /proc."""
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            about = status.read_text()
            line = (status.parent / "cmdline").read_bytes()
        except OSError:
            continue  # already ended
        if f"\nPPid:\t{parent}\n" in about and SPAWNED.encode() in line:
            found.append(int(status.parent.name))
    return found


def verify_dataset(folder: Path, sample: int) -> dict[str, Any]:
    """Verify a data set, and generate some of its episodes again to compare."""
    from egocap.data.dataset import episode_name, load_dataset
    from egocap_sim.verification.integrity import verify

    checked = verify(folder)
    recording = load_dataset(folder)
    chosen = np.random.default_rng(SEED).permutation(len(recording.episodes))[:sample]
    indices = sorted(recording.episodes[int(i)].index for i in chosen)
    different = [episode_name(i) for i in indices if not _same_again(folder, i)]
    return {
        "frames": checked.frames,
        "episodes": len(recording.episodes),
        "bytes": checked.bytes,
        "problems": list(checked.problems),
        "compared": len(indices),
        "different": different,
        "leftovers": len(list(folder.glob(".*.tmp"))),
    }


def _same_again(folder: Path, index: int) -> bool:
    """Whether an episode generated again, in a fresh process, has the same files."""
    made = folder.parent / f".{folder.name}-again-{index}"
    script = (
        "import sys; from egocap_eval.studies.crash_recovery import remake; remake(*sys.argv[1:])"
    )
    try:
        subprocess.run([sys.executable, "-c", script, str(folder), str(index), str(made)],
                       check=True, env=os.environ | {"LP_NUM_THREADS": "1"})  # fmt: skip
        from egocap.data.dataset import episode_name

        return _hashes(made) == _hashes(folder / episode_name(index))
    finally:
        import shutil

        shutil.rmtree(made, ignore_errors=True)


def remake(folder: str, index: str, made: str) -> None:
    """Generate an episode of a data set again, from its own scene."""
    from egocap.data.dataset import episode_name
    from egocap_sim.record.recorder import generate
    from egocap_sim.scene.config import load_scene

    scene = load_scene(Path(folder) / episode_name(int(index)) / "scene.toml")
    generate(scene, Path(made), workers=0)


def _hashes(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(folder.iterdir())}  # fmt: skip
