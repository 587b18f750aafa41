"""Training losses of heat maps, visibility and predicted standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn import functional as F

from egocap.body.labels import LABELS
from egocap.detect.heatmaps import soft_points, targets
from egocap.detect.train.config import LossConfig
from egocap.detect.train.examples import OUTSIDE, SEEN, UNKNOWN

_EXTREMITIES = ("wrist", "hand", "knee", "ankle", "foot")
_FAR_PX = 48.0  # largest error in the likelihood of sigma
_NEAR_CELLS = 3.0  # largest error for the sub-cell loss


@dataclass(frozen=True, eq=False)
class Losses:
    """The terms, each a scalar."""

    heat: Tensor  # Kullback-Leibler divergence of heat maps from targets, nats
    place: Tensor  # smooth L1 distance of decoded places, cells
    visibility: Tensor  # cross entropy, nats
    spread: Tensor  # negative log likelihood of the places under the predicted sigma

    def total(self, config: LossConfig) -> Tensor:
        """Their weighted sum."""
        return (
            self.heat
            + config.place * self.place
            + config.visibility * self.visibility
            + config.spread * self.spread
        )


def losses(
    heat: Float[Tensor, "B 18 h w"],
    info: Float[Tensor, "B 18 4"],
    points: Float[Tensor, "B 18 2"],
    state: Int64[Tensor, "B 18"],
    stride: int,
    config: LossConfig,
) -> Losses:
    """Losses of a batch; OUTSIDE labels contribute to visibility only, UNKNOWN ones to nothing."""
    weight = label_weights(state, config)
    total = weight.sum().clamp(min=1.0)
    sigma = torch.where(state == SEEN, config.seen_cells, config.hidden_cells)
    target = targets(points, (heat.shape[-2], heat.shape[-1]), stride, sigma)
    cross = -(target * F.log_softmax(heat.flatten(2), -1).reshape(heat.shape)).sum((-2, -1))
    own = -(target * target.clamp(min=1e-12).log()).sum((-2, -1))
    decoded = soft_points(heat, stride)
    off = (decoded - points) / stride
    near = weight * (off.detach().norm(dim=-1) < _NEAR_CELLS)
    place = F.smooth_l1_loss(off, torch.zeros_like(off), reduction="none", beta=0.25).sum(-1)
    return Losses(
        heat=(weight * (cross - own)).sum() / total,
        place=(near * place).sum() / total,
        visibility=F.cross_entropy(
            info[..., :3].flatten(0, 1), state.flatten(), ignore_index=UNKNOWN
        ),
        spread=spread_loss(info[..., 3], (decoded - points).detach(), state),
    )


def spread_loss(
    log_sigma: Float[Tensor, "B 18"], off: Float[Tensor, "B 18 2"], state: Int64[Tensor, "B 18"]
) -> Tensor:
    """Mean negative log likelihood of errors [px] of labels in view under isotropic Gaussians."""
    squared = off.square().sum(-1).clamp(max=_FAR_PX**2)
    nll = 2.0 * log_sigma + 0.5 * squared * torch.exp(-2.0 * log_sigma)
    inside = (state < OUTSIDE).float()
    return (inside * nll).sum() / inside.sum().clamp(min=1.0)


def label_weights(state: Int64[Tensor, "B 18"], config: LossConfig) -> Float[Tensor, "B 18"]:
    """Weight of every label's position: 0 if outside the view or unknown, reduced if occluded."""
    by_label = torch.tensor(
        [config.extremities if n.split("_")[-1] in _EXTREMITIES else 1.0 for n in LABELS],
        device=state.device,
    )
    by_state = torch.tensor([1.0, config.hidden, 0.0, 0.0], device=state.device)
    return by_state[state] * by_label
