"""Footage simulated for one rig, to train a detector for it: egocap-sim, run as a program."""

from __future__ import annotations

import importlib.util
import logging
import subprocess
import sys
import time
from pathlib import Path

from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError, MachineError

log = logging.getLogger(__name__)

SCENE = "train-varied"
FIRST_SEED = 500_000  # of training footage for a rig
FRAMES = 50  # of one person in one place
_SIZE = ("640", "512")


def simulate_for_rig(rig: Path, out: Path, seconds: float, seed: int = 0) -> Path:
    """Simulate short sequences of ever other people with a rig until the time is up.

    Sequences that are there already stay, so that a run that was killed goes on; with no time left
    none is added. At least two are made, one to hold out.

    Args:
        rig: a rig's file; anything `egocap.cameras.rig.load_rig` reads.
        out: folder of the sequences.
        seconds: how long to go on.
        seed: which people and places; no two seeds share one.

    Returns:
        `out`.

    Raises:
        FileError: the rig's file.
        MachineError: egocap-sim is not installed, or fails.
    """
    if load_rig(rig).views != ("left", "right"):
        raise InputError(f"{rig}: views {load_rig(rig).views}", valid="left and right")
    if importlib.util.find_spec("egocap_sim") is None:
        raise MachineError(
            "the simulator egocap-sim is not installed",
            remedy="install the package with egocap_sim, or train on folders of sequences",
        )
    out.mkdir(parents=True, exist_ok=True)
    until = time.monotonic() + seconds
    number = 0
    while number < 2 or time.monotonic() < until:
        folder = out / f"s{number:05d}"
        if not any(folder.rglob("truth.npz")):
            _simulate(rig, folder, FIRST_SEED + 10_000 * seed + number)
        number += 1
    log.info("%d sequences of %d stereo frames simulated", number, FRAMES)
    return out


def _simulate(rig: Path, folder: Path, seed: int) -> None:
    words = [
        sys.executable, "-m", "egocap_sim", "generate", SCENE, "--out", str(folder),
        "--rig", str(rig.resolve()), "--frames", str(FRAMES), "--seed", str(seed),
        "--size", *_SIZE, "--masks", "True",
    ]  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = [line for line in done.stderr.strip().splitlines() if line] or ["no message"]
        raise MachineError(f"simulating for {rig} failed: {last[-1]}")
