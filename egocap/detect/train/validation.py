"""Accuracy of a network on held-out views, in pixels at image width 640."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, Int64
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.detect.heatmaps import decode
from egocap.detect.train.examples import HIDDEN, SEEN, ViewStore
from egocap.detect.train.mixed_precision import mixed_precision

if TYPE_CHECKING:
    from egocap.detect.network import DetectorNetwork

PCK_PX = 20.0  # at 640 x 512


@dataclass(frozen=True)
class Scores:
    """Over labels of held-out views. Percentages from 0 to 100."""

    pck: float  # visible labels within 20 px
    auc: float  # mean PCK over thresholds 0..20 px
    error_px: float  # mean over visible labels
    median_px: float
    pck_in_view: float  # visible and occluded labels
    pck_wrist: float
    pck_ankle: float
    pck_hand: float
    pck_foot: float
    pck_knee: float
    normalised_error: float  # root mean square of error / sigma along an axis, visible; ideally 1
    occluded_auroc: float  # how well P(visible) separates visible from occluded labels, 0 to 1

    def to_dict(self) -> dict[str, float]:
        """The fields."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Predictions:
    """Outputs of a network for N views, and the truth, in canonical pixels."""

    off: Float[Array, "N 18 2"]  # decoded minus true
    log_sigma: Float[Array, "N 18"]
    visible: Float[Array, "N 18"]  # P(visible)
    state: Int64[Array, "N 18"]
    magnification: Float[Array, "N 18"]


def predict(
    network: DetectorNetwork, store: ViewStore, indices: Array, batch: int = 32
) -> Predictions:
    """Run a network, in evaluation mode, on views of a store."""
    device = next(network.parameters()).device
    was_training = network.training
    network.eval()
    columns: list[tuple[Array, ...]] = []
    with torch.no_grad(), mixed_precision(device):
        for images, points, state, magnification in _batches(store, indices, batch):
            heat, info = network(torch.from_numpy(images).to(device))
            heat, info = heat.float().cpu().numpy(), info.float().cpu()
            found = decode(heat, network.config.stride).points
            visible = torch.softmax(info[..., :3], -1)[..., 0].numpy()
            columns.append((found - points, info[..., 3].numpy(), visible, state, magnification))
    network.train(was_training)
    return Predictions(*(np.concatenate(c) for c in zip(*columns, strict=True)))


def score(found: Predictions) -> Scores:
    """Scores of predictions."""
    error = np.linalg.norm(found.off, axis=-1) * found.magnification
    seen, hidden = found.state == SEEN, found.state == HIDDEN
    names = np.array([n.split("_")[-1] for n in LABELS])

    def pck(part: str) -> float:
        return _share(error[:, names == part][seen[:, names == part]] <= PCK_PX)

    thresholds = (np.arange(80) + 0.5) * (PCK_PX / 80)  # the middles of 80 equal steps
    ratio = found.off[seen] * np.exp(-found.log_sigma[seen])[:, None]
    return Scores(
        pck=_share(error[seen] <= PCK_PX),
        auc=float(np.mean([_share(error[seen] <= t) for t in thresholds])),
        error_px=float(error[seen].mean()),
        median_px=float(np.median(error[seen])),
        pck_in_view=_share(error[seen | hidden] <= PCK_PX),
        pck_wrist=pck("wrist"),
        pck_ankle=pck("ankle"),
        pck_hand=pck("hand"),
        pck_foot=pck("foot"),
        pck_knee=pck("knee"),
        normalised_error=float(np.sqrt(np.mean(ratio**2))),
        occluded_auroc=auroc(found.visible[seen], found.visible[hidden]),
    )


def auroc(higher: Float[Array, "n"], lower: Float[Array, "m"]) -> float:
    """Probability that a draw from `higher` exceeds one from `lower`; nan if either is empty."""
    from scipy.stats import rankdata

    n, m = len(higher), len(lower)
    if not n or not m:
        return float("nan")
    ranks = rankdata(np.concatenate([higher, lower]))
    return float((ranks[:n].sum() - n * (n + 1) / 2) / (n * m))


def sigma_bias(found: Predictions) -> Float[Array, "18"]:
    """Offset of log sigma for a normalised error of 1 over visible views, per label.

    Labels with few visible views are shrunk towards the mean of all labels.
    """
    seen = found.state == SEEN
    squared = (found.off**2).mean(-1) * np.exp(-2.0 * found.log_sigma)
    overall = float(squared[seen].mean()) if seen.any() else 1.0
    counts = seen.sum(0)
    few = 20.0  # visible views at which a label and the mean have equal weight
    each = ((squared * seen).sum(0) + few * overall) / (counts + few)
    return 0.5 * np.log(np.maximum(each, 1e-6))


def _share(good: Array) -> float:
    return 100.0 * float(np.mean(good)) if good.size else float("nan")


def _batches(
    store: ViewStore, indices: Array, batch: int
) -> Iterator[tuple[Array, Array, Array, Array]]:
    for start in range(0, len(indices), batch):
        rows = [store.locate(int(i)) for i in indices[start : start + batch]]
        yield (
            np.stack([views.images[r] for views, r in rows]),
            np.stack([views.points[r] for views, r in rows]).astype(float),
            np.stack([views.state[r] for views, r in rows]).astype(np.int64),
            np.stack([views.magnification[r] for views, r in rows]).astype(float),
        )
