"""Adaptation of the detector to footage of one rig, room and wearer, without annotations.

The offline tracker labels the footage (`egocap.adaptation.labels`), and the detector is trained on
those labels under augmentation. The result is the mean of the weights before and after, which keeps
what the footage does not show. Stretches that were held out decide whether it is kept.

Source: the idea of training a network by what a stronger, slower method finds in its footage:
Simon et al. 2017, "Hand keypoint detection in single images using multiview bootstrapping"; the
mean of weights: Wortsman et al. 2022, "Robust fine-tuning of zero-shot models".
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.adaptation.config import AdaptOptions
from egocap.adaptation.footage import (
    Recording,
    check_footage,
    labelled_views,
    track_footage,
)
from egocap.data.sequence_writer import digest
from egocap.detect.detector import Detector
from egocap.detect.train.config import LossConfig, TrainingConfig
from egocap.detect.train.examples import HIDDEN, ViewStore
from egocap.detect.train.quantise import eight_bit_graph, keep_eight_bit, some_views
from egocap.detect.weights import Weights, open_weights, save_weights
from egocap.errors import InputError, require
from egocap.files import make_folder, write_json
from egocap.fitting.wearer import find_body
from egocap.footage.sources import Step

if TYPE_CHECKING:
    from egocap.detect.network import DetectorNetwork

WEIGHTS, REPORT = "detector.safetensors", "adapt.json"


@dataclass(frozen=True, eq=False)
class Adaptation:
    """Result of `adapt`. Scores are percentages on the tracker's labels of held-out stretches."""

    folder: Path
    before: Float[Array, "S"]  # score of the starting weights in each held-out stretch
    after: Float[Array, "S"]  # of the adapted ones
    labelled: float  # share of joints in view that have a label
    corrected: float  # share of the labels that the detector had elsewhere
    images: int  # to train on
    steps: int

    @property
    def gain(self) -> float:
        """Mean gain of the held-out stretches."""
        return float(np.mean(self.after - self.before))

    @property
    def gain_error(self) -> float:
        """Standard error of `gain`."""
        difference = self.after - self.before
        return float(np.std(difference, ddof=1) / np.sqrt(len(difference)))

    @property
    def kept(self) -> bool:
        """Whether the gain is above its standard error."""
        return self.gain > self.gain_error

    @property
    def weights(self) -> Path | None:
        """File of the adapted weights, where they are kept."""
        return self.folder / WEIGHTS if self.kept else None

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready summary."""
        return {
            "kept": self.kept, "weights": None if self.weights is None else str(self.weights),
            "auc_before": float(self.before.mean()), "auc_after": float(self.after.mean()),
            "gain": self.gain, "gain_standard_error": self.gain_error,
            "stretches": len(self.before), "labelled": self.labelled,
            "corrected": self.corrected, "images": self.images, "steps": self.steps,
        }  # fmt: skip


def adapt(
    footage: Sequence[str | Path],
    out: str | Path,
    options: AdaptOptions = AdaptOptions(),  # noqa: B008 (frozen)
    on_step: Step = lambda name, total: lambda count: None,
) -> Adaptation | None:
    """Adapt detector weights to footage; None where the training was interrupted.

    The same call goes on where an interrupted one stopped.

    Args:
        footage: folders of sequences of one wearer, or folders of `mocap`. Truth is not read.
        out: folder of the results: detector.safetensors, if they are better, and adapt.json.
        options: what is known of the wearer, and how long to train.
        on_step: called at the beginning of every step.

    Raises:
        FileError: a sequence, the weights or the body are missing or damaged.
        InputError: footage shorter than 10 s, or without a joint of which the tracker is sure. All
            but the last is found before the work begins.
        MachineError: torch or onnx is missing.
    """
    for package in ("torch", "onnx"):
        require(package, "train")
    if not footage:
        raise InputError("no footage", valid="folders of sequences, or of egocap mocap")
    weights = open_weights(options.weights)
    if options.body is not None:
        find_body(options.body)
    for source in footage:
        check_footage(Path(source))
    folder = Path(out)
    make_folder(folder)
    recordings = [
        track_footage(Path(source), folder / f"footage-{number}", options, on_step)
        for number, source in enumerate(footage)
    ]
    detectors = [Detector(recording.sequence.rig, weights) for recording in recordings]
    kept, held_out = labelled_views(recordings, detectors, options.views, on_step)
    start = weights.network()
    network, steps = _train(start, kept, weights, folder, options, recordings)
    if network is None:
        return None
    known, corrected, in_view = (
        sum(int(getattr(r.labels, name).sum()) for r in recordings)
        for name in ("known", "corrected", "in_view")
    )
    result = Adaptation(
        folder, _scores(start, held_out), _scores(network, held_out),
        known / max(in_view, 1), corrected / max(known, 1), len(kept), steps,
    )  # fmt: skip
    (folder / WEIGHTS).unlink(missing_ok=True)
    if result.kept:
        account = {"adapted_from": {"name": weights.name, "sha256": weights.sha256},
                   "options": asdict(options) | {"weights": None, "body": None},
                   "steps": steps}  # fmt: skip
        save_weights(folder / WEIGHTS, network, account, weights.calibration)
        adapted = open_weights(folder / WEIGHTS)
        keep_eight_bit(adapted, eight_bit_graph(adapted, some_views(kept)))
    write_json(folder / REPORT, result.to_dict())
    return result


def _train(
    start: DetectorNetwork, kept: ViewStore, weights: Weights, folder: Path,
    options: AdaptOptions, recordings: list[Recording],
) -> tuple[DetectorNetwork | None, int]:  # fmt: skip
    """The adapted network and its steps; None where interrupted.

    Standard deviations and visibility are not trained: the labels are the tracker's sure ones, on
    which a network would learn too much confidence.
    """
    from egocap.detect.train.trainer import Trainer

    training = TrainingConfig(
        minutes=options.minutes, steps=options.steps, batch=min(32, max(2, len(kept))),
        learning_rate=options.learning_rate, warm_up=0.1, average=0.99, seed=options.seed,
        checkpoint_minutes=1.0, loss=LossConfig(visibility=0.0, spread=0.0),
    )  # fmt: skip
    known = [r.sequence.manifest.config_sha256 for r in recordings]
    labels = [hashlib.sha256(r.labels.points.tobytes() + r.labels.state.tobytes()).hexdigest()
              for r in recordings]  # fmt: skip
    what = {"training": asdict(training), "weights": weights.sha256, "footage": known,
            "labels": labels, "views": options.views}  # fmt: skip
    run = folder / f"run-{digest(what)[:8]}"
    make_folder(run)
    trainer = Trainer(start.config, training, kept, None, run, start.state_dict())
    trainer.resume()
    outcome = trainer.run()
    network = _mean(start, trainer.average) if outcome.finished else None
    return network, outcome.state.step


def _mean(start: DetectorNetwork, trained: DetectorNetwork) -> DetectorNetwork:
    """The network with the mean of both networks' weights."""
    mean = deepcopy(trained)
    before = start.state_dict()
    for name, value in mean.state_dict().items():
        if value.is_floating_point():  # not a counter
            value.lerp_(before[name].to(value.device), 0.5)
    return mean


def _scores(network: DetectorNetwork, held_out: ViewStore) -> Float[Array, "S"]:
    """Mean PCK over thresholds from 0 to 20 px of the labels in view, in each stretch, %."""
    from egocap.detect.train.validation import PCK_PX, predict

    found = []
    for views in held_out.sequences:
        one = predict(network, ViewStore((views,)), np.arange(len(views)))
        error = np.linalg.norm(one.off, axis=-1) * one.magnification
        within = np.clip(1.0 - error[one.state <= HIDDEN] / PCK_PX, 0.0, 1.0)
        found.append(100.0 * float(within.mean()))
    return np.array(found)
