"""Do detections, rig and body fit each other? Measured on a track, without the truth.

In: detections, rig, proportions and the tracked joints. Out: the residuals over time, agreement of
the views, size of the limbs, attitude of the head, the likeliest cause of a misfit, and confidences
that allow for it. The covariance of a track holds if its inputs are right; the confidence does not
presume that.

Source: residuals against the stated noise, as the reduced chi-square of Bevington & Robinson 2003,
chapter 4, with medians. The relation between residual and error is measured by `egocap-eval doubt`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.consistency.attitude import attitudes, load_attitudes
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import angular_residual
from egocap.pose.observations import observe
from egocap.track.uncertainty import confidences
from egocap.track.view_agreement import CONFIDENT, Agreement, check_agreement, spread, triangulate

GAUSSIAN = 1.18
"""Median residual, in stated standard deviations, of Gaussian errors."""
MISFIT = 2.5
"""Median residual from which a frame does not fit."""
NOTHING = 12.0
"""Median residual from which the detections are of no body at all."""
FEW = 4.0
"""Expected number of visible joints a frame, in all views, below which the priors decide."""
ODD_SIZE = 0.10
"""Relative deviation of the triangulated limbs from the body's that is named."""
ODD_ATTITUDE = 0.5
"""Probability of a rig that is right on the head, below which its rotation is named."""
_SHARE, _ALL = 0.1, 0.9  # of the frames that do not fit, from which this is named
_RESIDUALS = (2.0, 3.0, 5.0, 8.0, 12.0, 30.0)
_SPREADS = (0.0, 0.05, 0.055, 0.11, 0.35, 0.5)
"""Standard deviation of the joints, relative to their distance from the neck, by median residual:
what makes confidences right on rotated and exchanged views (`egocap-eval doubt`)."""
_LEAST_SPREAD, _UNSEEN_SPREAD, _UNKNOWN_SPREAD = 0.01, 0.05, 0.5
"""The same of sound footage (hidden limbs and biases of the shipped detector on validation clips),
without detections, and of a pose that nothing is known of."""
_SIZE_NOISE, _SIZE_SPREAD, _MOST_SIZE_SPREAD = 0.07, 1.8, 0.15
"""Of the logarithm of the limbs' size: error, spread relative to the rest, and its maximum."""
_MOST_MISS = 1.6  # of rays, relative to that of the stated errors, with which limbs are measured
_TURNS = (0.0, 5.5, 8.0, 20.0, 40.0)
_TURN_SPREADS = (0.0, 0.034, 0.085, 0.085, 0.3)
"""The same by the rotation of the views against each other, degrees, that explains the residuals.
Of a large one each camera may have its share: the rig is then rotated as a whole, too, unseen."""
_BLOCK_S = 0.5
_FRAMES = 300  # looked at for the limbs' size
_LIMBS = np.array([
    [LABEL_INDEX[side + joint] for joint in joints]
    for side in ("left_", "right_")
    for joints in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
])  # fmt: skip
_ENOUGH = 10  # frames in which a bone is seen, without which its limb is not measured
_NECK = LABEL_INDEX["neck"]


@dataclass(frozen=True, eq=False)
class Consistency:
    """How well the inputs of a track fit each other."""

    residual: Float[Array, "T"]  # median around a frame, in stated standard deviations, or nan
    visible: float  # expected number of visible joints a frame, in all views
    spread: Float[Array, "T"]  # standard deviation of joints by their distance from the neck
    agreement: Agreement
    size: float  # of the triangulated limbs relative to the body's, nan where not measured
    attitude: Float[Array, "3"]  # median roll, pitch, yaw of the trunk in the head frame, rad
    right_attitude: float  # probability of a rig that is not rotated on the head

    @property
    def in_doubt(self) -> float:
        """Fraction of the frames whose detections do not fit, or are too few."""
        return float(np.mean(~(self.residual < MISFIT)))

    @property
    def warning(self) -> str | None:
        """The likeliest cause of a misfit in one line; None where all fits."""
        return self._of_nothing() or self.geometry or self._of_frames()

    @property
    def geometry(self) -> str | None:
        """The likeliest cause in the rig, the order of the views or the body; None where all fit.

        The whole track is then biased, which no covariance states.
        """
        return self._of_the_views() or self._of_the_body() or self._of_the_rig()

    def confidences(
        self, joints_head: Float[Array, "T 18 3"], covariance: Float[Array, "T 18 3 3"]
    ) -> Float[Array, "T 18"]:
        """Probability that each joint is within 5 cm, given that the inputs may be wrong."""
        distance = np.linalg.norm(joints_head - joints_head[:, _NECK, None], axis=-1)

        def within(relative: Float[Array, "*T 1"]) -> Float[Array, "T 18"]:
            extra = np.square(relative * distance)[..., None, None]
            return confidences(covariance + extra * np.eye(3))

        right = self.right_attitude
        known = within(self.spread[:, None])
        return right * known + (1.0 - right) * np.minimum(
            known, within(np.full((1, 1), _UNKNOWN_SPREAD))
        )

    def to_dict(self) -> dict[str, object]:
        """JSON-ready summary, without the time course."""
        roll, pitch, yaw = np.rad2deg(self.attitude)
        views = {name: _plain(value) for name, value in asdict(self.agreement).items()}
        return {
            "warning": self.warning, "geometry": self.geometry,
            "frames_in_doubt": round(self.in_doubt, 4),
            "residual": _plain(self._residual), "visible_joints": _plain(self.visible),
            "views": views, "size": _plain(self.size),
            "attitude_deg": {"roll": _plain(roll), "pitch": _plain(pitch), "yaw": _plain(yaw)},
            "right_attitude": _plain(self.right_attitude),
        }  # fmt: skip

    @property
    def _residual(self) -> float:
        return _median(self.residual)

    @property
    def _in_part(self) -> bool:
        """Whether some frames fit and some do not."""
        return _SHARE < self.in_doubt < _ALL

    def _of_nothing(self) -> str | None:
        if self.visible < 0.5 * FEW:
            return (f"hardly any detections ({self.visible:.1f} visible joints a frame): the pose "
                    "is that of the priors")  # fmt: skip
        explained = self.agreement.looks_exchanged or self.agreement.turned > 0.0
        if self._residual > NOTHING and self.in_doubt > _ALL and not explained:
            return (f"detections of nothing: they lie {self._residual:.0f} standard deviations "
                    "from any pose of the body")  # fmt: skip
        return None

    def _of_the_views(self) -> str | None:
        seen = self.agreement
        miss = f"rays to the same joint miss each other by {seen.as_given:.1f} degrees"
        if seen.looks_exchanged:
            return f"the views look exchanged: {miss}, {seen.exchanged:.1f} in the other order"
        if seen.turned > 0.0:
            return (f"the views are rotated by about {seen.turned:.0f} degrees against the rig "
                    f"file: {miss}")  # fmt: skip
        if seen.looks_like_another_rig and not self._in_part:
            return f"the rig file does not describe these cameras: {miss}"
        return None

    def _of_the_body(self) -> str | None:
        if abs(np.log(self.size)) > np.log1p(ODD_SIZE):
            return (f"the limbs measure {100 * self.size:.0f} % of the body's: another person's "
                    "body, or cameras farther apart or closer together than in the rig file"
                    )  # fmt: skip
        return None

    def _of_the_rig(self) -> str | None:
        if abs(self.attitude[2]) > np.pi / 2:
            return "the body faces backwards: left and right of the detections look exchanged"
        if self.right_attitude < ODD_ATTITUDE:
            axis, off = load_attitudes().oddest(self.attitude)
            return (f"the rig is probably rotated on the head, in {axis} by about "
                    f"{np.rad2deg(off):.0f} degrees: heads are seldom held so")  # fmt: skip
        return None

    def _of_frames(self) -> str | None:
        if self.in_doubt > _SHARE:
            return (f"detections do not fit the body in {100 * self.in_doubt:.0f} % of the frames "
                    f"(median residual {np.nanmax(self.residual):.1f} standard deviations at "
                    "worst)")  # fmt: skip
        return None


def with_consistency(
    track: Track, found: Detections, rig: Rig, proportions: Proportions,
    config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
) -> Track:  # fmt: skip
    """The track with `config["consistency"]`, and with confidences that allow for wrong inputs."""
    checked = check_consistency(track.joints_head, found, rig, proportions, config)
    confidence = None
    if track.covariance is not None:
        confidence = checked.confidences(track.joints_head, track.covariance)
    config_of = track.config | {"consistency": checked.to_dict()}
    return replace(track, confidence=confidence, config=config_of)


def warning_of(track: Track, of: Literal["warning", "geometry"] = "warning") -> str | None:
    """The likeliest cause why a track cannot be right, in one line; None where all fits.

    Of its "geometry": a cause in the rig, the order of the views or the body alone.
    """
    found = track.config.get("consistency")
    return found.get(of) if isinstance(found, dict) else None


def check_consistency(
    joints_head: Float[Array, "T 18 3"], found: Detections, rig: Rig, proportions: Proportions,
    config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
) -> Consistency:  # fmt: skip
    """Compare detections with a track of them, the views with each other, limbs with the body."""
    finite = np.isfinite(found.points).all(-1) & np.isfinite(found.sigma)
    found = replace(found, valid=found.valid & finite & np.isfinite(found.confidence))
    sure = found.valid & (found.confidence > CONFIDENT)
    visible = np.sum(np.where(found.valid, found.confidence, 0.0), (1, 2))
    residual, seen = _over_time(_residuals(joints_head, found, rig, proportions, config), sure,
                                visible, found.times)  # fmt: skip
    agreement = check_agreement(found, rig)
    fits = not (agreement.turned > 0.0 or agreement.as_given > _MOST_MISS * agreement.expected)
    size = limb_size(found, rig, proportions) if fits else float("nan")
    attitude = np.median(attitudes(joints_head), axis=0)
    unseen = _UNSEEN_SPREAD * np.clip(1.0 - seen / FEW, 0.0, 1.0)
    turned = 0.0 if np.isnan(agreement.turned) else agreement.turned
    explained = np.fmax(_median(residual) / GAUSSIAN, 1.0) if turned > 0.0 else 1.0
    fit = np.interp(np.nan_to_num(residual) / explained, _RESIDUALS, _SPREADS)
    fit = np.maximum(fit, np.interp(turned, _TURNS, _TURN_SPREADS))
    odd = 0.0 if np.isnan(size) else max(abs(np.log(size)) - _SIZE_NOISE, 0.0)
    scale = min(_SIZE_SPREAD * odd, _MOST_SIZE_SPREAD)
    return Consistency(
        residual, float(visible.mean()), np.sqrt(_LEAST_SPREAD**2 + unseen**2 + fit**2 + scale**2),
        agreement, size, attitude, load_attitudes().probability(attitude),
    )  # fmt: skip


def limb_size(found: Detections, rig: Rig, proportions: Proportions) -> float:
    """Length of triangulated limbs relative to the body's: the median over limbs; nan without.

    Of whole limbs: what a detector misplaces an elbow or a knee by along the limb, in both views
    alike, lengthens one of its bones and shortens the other.
    """
    joints, known = triangulate(spread(found, _FRAMES), rig)
    bones, own = _lengths(joints), _lengths(proportions.rest_joints)
    known = known[:, _LIMBS[:, 1:]] & known[:, _LIMBS[:, :-1]]
    ratios = [
        sum(np.median(bones[known[:, i, b], i, b]) for b in (0, 1)) / own[i].sum()
        for i in np.flatnonzero((known.sum(0) >= _ENOUGH).all(1))
    ]
    return float(np.median(ratios)) if ratios else float("nan")


def _lengths(joints: Float[Array, "*T 18 3"]) -> Float[Array, "*T 4 2"]:
    """Lengths [m] of the bones of the limbs."""
    return np.linalg.norm(np.diff(joints[..., _LIMBS, :], axis=-2), axis=-1)


def _residuals(
    joints_head: Float[Array, "T 18 3"], found: Detections, rig: Rig, proportions: Proportions,
    config: TrackerConfig,
) -> Float[Array, "T V 18"]:  # fmt: skip
    """Distance of detections from the tracked joints, in the stated standard deviations."""
    seen = observe(found, rig, proportions, config)
    off = angular_residual(joints_head[:, None], seen.centres[:, None], seen.rays, seen.whiten)
    return np.linalg.norm(off, axis=-1)


def _over_time(
    residual: Float[Array, "T V 18"], sure: Array, visible: Float[Array, "T"],
    times: Float[Array, "T"],
) -> tuple[Float[Array, "T"], Float[Array, "T"]]:  # fmt: skip
    """Median residual around every frame, and mean number of visible joints there."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    block = max(round(_BLOCK_S / step), 1)
    medians, seen = np.full(len(times), np.nan), np.zeros(len(times))
    for first in range(0, len(times), block):
        here = slice(first, first + block)
        values = residual[here][sure[here]]
        seen[here] = visible[here].mean()
        if len(values) >= FEW:
            medians[here] = np.median(values)
    return medians, seen


def _median(residual: Float[Array, "T"]) -> float:
    """Median over the frames where the residual is known; nan without."""
    known = residual[np.isfinite(residual)]
    return float(np.median(known)) if len(known) else float("nan")


def _plain(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None
