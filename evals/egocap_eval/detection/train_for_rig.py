"""Train a detector for one rig: simulate footage for a third of the time, then train on it."""

from __future__ import annotations

import json as json_format
import logging
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional

from egocap.cameras.rig_files import load_rig
from egocap.commandline import DONE, INTERRUPTED
from egocap.detect.train import run as runs
from egocap.detect.train.checkpoint import CHECKPOINT
from egocap.detect.train.config import RunConfig, TrainingConfig
from egocap.detect.weights import SHIPPED, shipped_file
from egocap.errors import InputError, MachineError

log = logging.getLogger(__name__)

SCENE = "train-varied"
FIRST_SEED = 500_000  # of training footage for a rig
FRAMES = 50  # of one person in one place
SIMULATION_SHARE = 0.35  # of the minutes
_SIZE = ("640", "512")


@dataclass(frozen=True, kw_only=True)
class RigRunConfig(RunConfig):
    """A training run on footage simulated for a rig. Raises InputError as `RunConfig` does."""

    rig: Path  # file of the rig, with views 'left' and 'right'
    data: Positional[tuple[Path, ...]] = ()  # further sequences, or folders of them, to train on
    start: Path | None = None  # weights to begin from; for the default network, the shipped ones
    scratch: bool = False  # begin from random weights
    shares: tuple[float, ...] = ()  # weight of each DATA and, last, of the simulated footage

    def __post_init__(self) -> None:
        if self.scratch and self.start is not None:
            raise InputError("--scratch and --start exclude each other", valid="one of them")
        if self.start is None and self.config == SHIPPED and not self.scratch:
            object.__setattr__(self, "start", shipped_file())
        object.__setattr__(self, "data", (*self.data, self.footage))
        super().__post_init__()

    @property
    def footage(self) -> Path:
        """Folder of the simulated sequences."""
        return self.out / "simulated"


def train(
    run: Annotated[RigRunConfig, OmitArgPrefixes],
    training: Annotated[TrainingConfig, OmitArgPrefixes] = TrainingConfig(),  # noqa: B008
    json: bool = False,
) -> int:
    """Simulate footage with a rig for a third of the minutes, and train a detector on it.

    Args:
        run: what to train; the footage is written to the folder 'simulated' in --out.
        training: how to train; its minutes include the simulation.
        json: print the summary as JSON.
    """
    shortened = replace(training, minutes=training.minutes * (1.0 - SIMULATION_SHARE))
    if "WORLD_SIZE" not in os.environ:  # once, before torchrun starts a process for each GPU
        runs.prepare_run(run, shortened)  # reports wrong options before the simulation
        share = 0.0 if (run.out / CHECKPOINT).exists() else SIMULATION_SHARE
        simulate_for_rig(run.rig, run.footage, 60.0 * share * training.minutes, training.seed)
        command = runs.command_for_devices(sys.argv[1:], "egocap_eval")
        if command is not None:
            return subprocess.call(command)
    runs.join_processes()
    outcome = runs.train_detector(run, shortened, ["egocap-eval", *sys.argv[1:]])
    found = runs.summary(run, outcome)
    print(json_format.dumps(found, indent=1) if json else runs.summary_text(run, outcome))
    return DONE if outcome.finished else INTERRUPTED


def simulate_for_rig(rig: Path, out: Path, seconds: float, seed: int = 0) -> Path:
    """Simulate short sequences of different people with a rig for a given time.

    Existing sequences are kept, so that an interrupted run can be resumed. At least two sequences
    are made, since one is held out.

    Args:
        rig: rig file, as for `egocap.cameras.rig_files.load_rig`.
        out: folder of the sequences.
        seconds: time budget.
        seed: of people and places; different seeds share none.

    Returns:
        `out`.

    Raises:
        FileError: the rig file is missing or wrong.
        InputError: the rig's views are not left and right.
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
