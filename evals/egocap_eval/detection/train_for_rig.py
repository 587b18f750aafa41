"""Train a detector for one rig: simulate footage for a third of the time, then train on it."""

from __future__ import annotations

import json as json_format
import logging
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes

from egocap.cameras.rig_files import load_rig
from egocap.commandline import DONE, INTERRUPTED
from egocap.detect.train.config import RunConfig, TrainingConfig
from egocap.errors import InputError, MachineError

log = logging.getLogger(__name__)

SCENE = "train-varied"
FIRST_SEED = 500_000  # of training footage for a rig
FRAMES = 50  # of one person in one place
SIMULATION_SHARE = 0.35  # of the minutes
_SIZE = ("640", "512")


def train(
    rig: Path,
    out: Path,
    data: tuple[Path, ...] = (),
    training: Annotated[TrainingConfig, OmitArgPrefixes] = TrainingConfig(),  # noqa: B008
    config: str = "default",
    resume: bool = False,
    start: Path | None = None,
    scratch: bool = False,
    json: bool = False,
) -> int:
    """Simulate footage with a rig for a third of the minutes, and train a detector on it.

    Args:
        rig: file of the rig, with views 'left' and 'right'.
        out: folder of the run; the footage is in its folder 'simulated'.
        data: further footage with annotations to train on.
        training: how to train; its minutes include the simulation.
        config: network to train: default, small, paper (ResNet-101) or tiny.
        resume: go on with the run in --out, if there is one.
        start: weights to begin from; for the default network, those that are shipped.
        scratch: begin from random weights.
        json: print the summary as JSON.
    """
    from egocap.detect.train import run as runs
    from egocap.detect.train.checkpoint import CHECKPOINT
    from egocap.detect.weights import SHIPPED, shipped_file

    if scratch and start is not None:
        raise InputError("--scratch and --start exclude each other", valid="one of them")
    if start is None and config == SHIPPED and not scratch:
        start = shipped_file()
    footage = out / "simulated"
    run = RunConfig(out, (*data, footage), config, start=start, resume=resume)
    shortened = replace(training, minutes=training.minutes * (1.0 - SIMULATION_SHARE))
    if "WORLD_SIZE" not in os.environ:  # once, before torchrun starts a process for each GPU
        runs.prepare_run(run, shortened)  # errors before the footage is made
        share = 0.0 if (out / CHECKPOINT).exists() else SIMULATION_SHARE
        simulate_for_rig(rig, footage, 60.0 * share * training.minutes, training.seed)
        command = runs.command_for_devices(sys.argv[1:], "egocap_eval")
        if command is not None:
            return subprocess.call(command)
    runs.join_processes()
    outcome = runs.train_detector(run, shortened, ["egocap-eval", *sys.argv[1:]])
    found = runs.summary(run, outcome)
    print(json_format.dumps(found, indent=1) if json else runs.summary_text(run, outcome))
    return DONE if outcome.finished else INTERRUPTED


def simulate_for_rig(rig: Path, out: Path, seconds: float, seed: int = 0) -> Path:
    """Simulate short sequences of different people with a rig until the time is up.

    Sequences that are there already stay, so that a run that was killed goes on; with no time left
    none is added. At least two are made, one to hold out.

    Args:
        rig: a rig's file; anything `egocap.cameras.rig_files.load_rig` reads.
        out: folder of the sequences.
        seconds: how long to go on.
        seed: which people and places; no two seeds share one.

    Returns:
        `out`.

    Raises:
        FileError: the rig's file.
        InputError: a rig with other views than left and right.
        MachineError: the simulation failed.
    """
    if load_rig(rig).views != ("left", "right"):
        raise InputError(f"{rig}: views {load_rig(rig).views}", valid="left and right")
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
        "--size", *_SIZE, "--masks",
    ]  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = [line for line in done.stderr.strip().splitlines() if line] or ["no message"]
        raise MachineError(f"simulating for {rig} failed: {last[-1]}")
