"""The commands of egocap-eval: a table of studies, and `main`, which runs one by name."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from tyro.extras import SubcommandApp

from egocap.commandline import run
from egocap.errors import require
from egocap.storage.words import local_words
from egocap_eval.harness.study import as_command

STUDIES = {
    # command: (module of egocap_eval with a function `study`, summary in `egocap-eval --help`)
    "pose": ("harness.score_pose", "Score a track, or any method's poses, against the truth."),
    "run": ("harness.run", "Run a suite: sequences, predictions, scores and a report."),
    "compare": ("harness.compare", "List what changed between two runs, with paired intervals."),
    "check": ("harness.check", "Run the regression guard: a fixed small suite and its baseline."),
    "recorded": (
        "studies.recorded",
        "Detect and track the recorded motions of a set, from images.",
    ),
    "world": ("world.study", "Track in the world: drift, feet that slide or sink, contacts."),
    "accuracy": ("studies.accuracy", "Track the validation scenes from simulated detections."),
    "stress": ("studies.stress", "Track under one growing fault at a time, without rendering."),
    "stress-rendered": ("studies.stress_rendered", "Track under one growing image fault."),
    "ablation": ("studies.ablation", "Track with one part left out at a time."),
    "personalised": ("studies.personalised", "Track a person with a body fitted to another clip."),
    "fit-body": ("studies.fit_body", "Compare fitted bone lengths with the true ones."),
    "fit-rig": ("studies.fit_rig", "Compare a rig's fitted pose on the head with the true."),
    "runtime": ("studies.runtime", "Time the detector, the solvers and the whole pipeline."),
    "head-pose": ("studies.head_pose", "Find the head's path in the world from the pictures."),
    "sync": ("footage.synchronisation", "Estimate clocks and colours of exported camera files."),
    "captures": ("footage.captures", "Capture motion from exported camera files."),
    "capture-memory": ("footage.memory", "Measure the memory of motion capture by length."),
    "soak": ("footage.soak", "Run live and generation for long: memory, open files, latency."),
    "physics": ("studies.physics", "Retarget and simulate every motion clip of a folder."),
    "visibility": ("studies.visibility", "Measure the visibility of each joint by field of view."),
    "crash-recovery": ("studies.crash_recovery", "Kill a generation repeatedly and verify it."),
    "faults": ("fuzz.faults", "Kill and disturb every long command, and run it again."),
    "adapt": ("studies.adaptation", "Adapt the detector to another camera without annotations."),
    "doubt": ("studies.doubt", "Track from wrong views, rigs, bodies or detections."),
    "fuzz": ("fuzz.study", "Feed mutated files to every reader."),
    "augmentation": ("studies.augmentation", "Train detectors with and without augmentation."),
    "training-set": ("studies.training_set", "Train detectors on fewer people or frames."),
    "learn-prior": ("priors.study", "Learn the priors of poses, motion and attitude from clips."),
    "learn-contacts": (
        "world.learn_contacts",
        "Learn when heels and toes touch the ground, from clips.",
    ),
    "motion-sets": ("sets.takes", "List the sets of motion clips; find takes that two sets share."),
    "dataset": ("studies.dataset_card", "Count a data set's people, rigs and visible joints."),
    "detector": ("detection.detector", "Score the learned detector: PCK, calibration, speed."),
    "image-model": ("image_model.study", "Measure the image model: accuracy, basin of attraction."),
    "calibration": ("posterior.calibration", "Measure coverage of the posterior's regions."),
    "posterior": ("posterior.sampling", "Compare the tracker's error with its lower bound."),
    "tables": ("evidence.tables", "Write the tables of README and docs from the results."),
    "refresh": ("evidence.refresh", "Measure again the results whose sources have changed."),
    "calibrate": ("calibration.study", "Calibrate stereo rigs from simulated boards."),
    "rig": ("rig_design.rig", "Compare stereo rigs: visibility, error bounds, tracked errors."),
}
"""A new study is one module and one line here (see `harness.study`)."""


def main(args: Sequence[str] | None = None) -> int:
    """Run a command line (the process's own when None) and return the exit code.

    Only the study that is called is imported.
    """
    words = sys.argv[1:] if args is None else list(args)
    app = SubcommandApp()
    summary = "Simulate footage for a rig and train a detector on it."
    app.command(name="train", help=summary)(
        _imported("detection.train_for_rig").train if words[:1] == ["train"] else _not_called
    )
    for name, (module, summary) in STUDIES.items():
        if words[:1] == [name]:
            study = _imported(module).study
            app.command(name=name)(as_command(study, name, words))
        else:
            app.command(name=name, help=summary)(_not_called)
    what = "Measure tracks, detections, rigs and the simulation."
    return run(app, prog="egocap-eval", description=what, args=words, within=local_words)


def _imported(name: str) -> ModuleType:
    """A module of the evals. Raises MachineError where it needs torch, which is missing."""
    try:
        return import_module(f"egocap_eval.{name}")
    except ModuleNotFoundError:
        require("torch", "train")
        raise


def _not_called() -> None:
    raise AssertionError("a study that was not called ran")
