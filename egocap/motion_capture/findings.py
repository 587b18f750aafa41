"""What a run found: how much was seen, how sure the motion is, where it is worst, what would help.

All numbers are measured on the run's own footage; nothing here knows the truth.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS, without_side
from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.footage import Footage
from egocap.data.track import Track
from egocap.fitting.wearer import average_body
from egocap.geometry import axis_angle, rigid
from egocap.track.consistency import warning_of
from egocap.track.view_agreement import Agreement

SEEN = 0.5
"""Visibility probability from which a joint counts as seen."""
PLACED = 0.95
"""Share of frames with a head pose below which the page says so."""
UNSURE_DEG, UNSURE_MM = 1.0, 30.0
"""Standard deviations of up and of the floor's height from which the page says so."""
SELDOM = 0.2
"""Share of frames with a joint in the picture below which it is named."""
TILTS = range(-30, 35, 5)
"""Degrees by which the cameras are tilted down to see more, in the search for a better tilt."""
WORTH = 0.04
"""Share of joints that a tilt must bring into the pictures to be advised."""
MISFIT = 3.0
"""Median residual, in standard deviations, from which rig file or body do not fit."""
ODD_SIZE = 0.12
"""Relative deviation of the body's size from which the rig's distances are doubted."""
_LONG = ("lower_spine", "left_elbow", "left_wrist", "left_knee", "left_ankle")
_SPREAD = 400  # frames looked at
_WORST, _APART_S = 6, 1.0


@dataclass(frozen=True)
class Tilt:
    """The tilt at which most joints are in the pictures."""

    degrees: int  # down
    in_view: float  # share of joints in any picture as the cameras are
    in_view_tilted: float


@dataclass(frozen=True, eq=False)
class Findings:
    """What is told on the page and by --json."""

    frames: int
    seconds: float
    views: dict[str, dict[str, Any]]
    agreement: Agreement
    seen: dict[str, float]  # share of frames in which any view sees the joint
    in_view: dict[str, float]  # share of frames in which the tracked joint is in any picture
    spread_mm: dict[str, float]  # median standard deviation of the joint along an axis
    sure: Float[Array, "T"]  # mean probability over the joints that the error is below 5 cm
    residual: dict[str, float]  # median distance of detections from the track, in their sigmas
    size: float  # of the body relative to an average adult's, of the given height if there is one
    worst: list[int]  # frames
    tilt: Tilt
    advice: list[str]
    in_world: float | None = None  # share of frames whose head pose is known; None: without a path
    vertical: dict[str, Any] | None = None  # how sure up and the floor are, by the path's file

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready form without the time course."""
        plain = {name: value for name, value in vars(self).items() if name != "sure"}
        plain["agreement"], plain["tilt"] = asdict(self.agreement), asdict(self.tilt)
        return _without_nan(plain | {"sure": round(float(self.sure.mean()), 4)})


def find(
    track: Track, found: Detections, rig: Rig, footage: Footage, agreement: Agreement,
    height: float | None = None, vertical: dict[str, Any] | None = None,
) -> Findings:  # fmt: skip
    """Findings of a track with covariances, and of the detections that it was made from.

    `height` of the wearer in metres, and `vertical` facts of the head's path, where they are known.
    """
    assert track.covariance is not None and track.confidence is not None
    spread = np.sqrt(np.trace(track.covariance, axis1=2, axis2=3) / 3.0)
    inside = in_pictures(rig, track.joints_head)
    sees = (found.valid & (found.confidence > SEEN)).any(1)
    sure = track.confidence.mean(1)
    views = {view.name: footage.report.get(view.name, {}) | {
        "offset_ms": 1e3 * view.timing.offset_s, "drift_ppm": view.timing.drift_ppm,
        "clock": "shared" if view.part.of > 1 else view.timing.origin, "gain": view.colour.gain,
    } for view in footage.views}  # fmt: skip
    result = Findings(
        frames=len(sure), seconds=round(float(np.ptp(track.times)), 3), views=views,
        agreement=agreement, seen=_by_label(sees.mean(0)), in_view=_by_label(inside.mean(0)),
        residual=residuals(track, found, rig), size=relative_size(track, height),
        spread_mm=_by_label(1e3 * np.median(spread, 0), 1), sure=sure,
        worst=worst_frames(sure, track.times), tilt=best_tilt(rig, track.joints_head), advice=[],
        in_world=None if track.in_world is None else round(float(track.in_world.mean()), 4),
        vertical=vertical,
    )  # fmt: skip
    return replace(result, advice=advise(result, warning_of(track)))


def in_pictures(rig: Rig, joints_head: Float[Array, "T 18 3"]) -> Array:
    """Whether a joint lies in any picture (T, 18), hidden or not."""
    pixels, valid = rig.project(joints_head)
    size = np.array([(c.width, c.height) for c in rig.cameras])[:, None, None]
    return np.any(valid & ((pixels > -0.5) & (pixels < size - 0.5)).all(-1), axis=0)


def residuals(track: Track, found: Detections, rig: Rig) -> dict[str, float]:
    """Median distance of detections from the tracked joints, in standard deviations, by view.

    About 1.2 where the detector's uncertainty is right: the median of a Rayleigh distribution.
    """
    pixels, inside = rig.project(track.joints_head)
    medians = {}
    for v, name in enumerate(rig.views):
        seen = found.valid[:, v] & (found.confidence[:, v] > SEEN) & inside[v]
        off = np.linalg.norm(pixels[v] - found.points[:, v], axis=-1)[seen]
        sigma = found.sigma[:, v][seen]
        medians[name] = round(float(np.median(off / sigma)), 3) if len(off) else float("nan")
    return medians


def relative_size(track: Track, height: float | None) -> float:
    """Length of the tracked limbs and spine relative to an average adult's of a height [m].

    Cameras that are closer together than the rig file says make everything look farther and larger.
    """
    assert track.offsets is not None
    mine, average = Proportions(track.offsets).bone_lengths, average_body(height).bone_lengths
    return round(sum(mine[b] for b in _LONG) / sum(average[b] for b in _LONG), 4)


def best_tilt(rig: Rig, joints_head: Float[Array, "T 18 3"]) -> Tilt:
    """The smallest tilt of all cameras about the left-right axis that shows most joints.

    The head, which carries the cameras, does not count.
    """
    some = joints_head[:: max(len(joints_head) // _SPREAD, 1)]
    shares = {t: float(in_pictures(_tilted(rig, t), some)[:, 1:].mean()) for t in TILTS}
    good = [tilt for tilt in TILTS if shares[tilt] > max(shares.values()) - 0.005]
    best = min(good, key=abs)
    return Tilt(best, round(shares[0], 4), round(shares[best], 4))


def _tilted(rig: Rig, degrees: float) -> Rig:
    turn = rigid(axis_angle(np.array([0.0, 1.0, 0.0]), np.deg2rad(degrees)), np.zeros(3))
    mounts = []
    for mount in rig.mounts:
        T = mount.T_head_camera.copy()
        T[:3, :3] = turn[:3, :3] @ T[:3, :3]
        mounts.append(replace(mount, T_head_camera=T))
    return replace(rig, mounts=tuple(mounts))


def worst_frames(sure: Float[Array, "T"], times: Float[Array, "T"]) -> list[int]:
    """The least certain frames, a second apart at least."""
    found: list[int] = []
    for frame in np.argsort(sure, kind="stable"):
        if all(abs(times[frame] - times[other]) >= _APART_S for other in found):
            found.append(int(frame))
        if len(found) == _WORST:
            break
    return sorted(found)


def advise(found: Findings, warning: str | None = None) -> list[str]:
    """What the numbers say should be improved, most important first.

    `warning` is the track's own, named where the findings name no cause.
    """
    geometry = _about_geometry(found) or ([] if warning is None else [f"Warning: {warning}."])
    if np.isnan(found.agreement.as_given) and len(found.residual) > 1:
        geometry.append("The views share too few detections to compare them with the rig file.")
    return [*geometry, *_about_place(found), *_about_sight(found), *_about_pictures(found)] or [
        "Nothing stands out: all joints are seen and the views agree."
    ]


def _about_geometry(found: Findings) -> list[str]:
    seen = found.agreement
    miss = (f"Rays to the same joint miss each other by {seen.as_given:.1f} degrees (the "
            f"detector's own error: {seen.expected:.1f})")  # fmt: skip
    if seen.looks_exchanged:
        return [f"{miss}, and by {seen.exchanged:.1f} with the views exchanged: the files are "
                "probably given in the wrong order."]  # fmt: skip
    if seen.looks_like_another_rig:
        return [f"{miss}: the rig file does not describe these cameras. Calibrate them, or check "
                "that the file is the right one."]  # fmt: skip
    if abs(found.size - 1.0) > ODD_SIZE:
        off = 100 * (1.0 / found.size - 1.0)
        return [f"The body comes out {100 * found.size:.0f} % of the expected size. Either the "
                f"cameras are {abs(off):.0f} % {'farther apart' if off > 0 else 'closer together'} "
                "than the rig file says, or the height is wrong."]  # fmt: skip
    off = [f"{name} {value:.1f}" for name, value in found.residual.items() if value > MISFIT]
    if off:
        return [f"Detections lie far from the tracked body, in standard deviations: "
                f"{', '.join(off)} (expected 1.2). The rig file's distances, its lenses or the "
                "given body are not those of the footage."]  # fmt: skip
    return []


def _about_place(found: Findings) -> list[str]:
    lines = []
    if found.in_world is not None and found.in_world < PLACED:
        lines.append(f"The head's path is known in {100 * found.in_world:.0f} % of the frames; in "
                     "the rest the person stays at the nearest known place. More light, "
                     "surroundings with texture, and cameras whose lag is known help.")  # fmt: skip
    vertical = found.vertical or {}
    up, floor = vertical.get("up_std_deg") or 0.0, vertical.get("floor_std_mm") or 0.0
    if vertical and vertical.get("floor_std_mm") is None:
        lines.append(f"The floor was not found, so heights are relative to the first head, and up "
                     f"is uncertain by {up:.1f} degrees. A floor with texture in both views "
                     "helps.")  # fmt: skip
    elif up > UNSURE_DEG or floor > UNSURE_MM:
        lines.append(f"Up is uncertain by {up:.1f} degrees and the floor's height by {floor:.0f} "
                     "mm. Begin with some seconds of walking or looking around, which tell errors "
                     "of the rig file.")  # fmt: skip
    return lines


def _about_sight(found: Findings) -> list[str]:
    hidden = sorted({_plain(name) for name, share in found.in_view.items()
                     if share < SELDOM and name != "head"})  # fmt: skip
    lines = []
    if found.tilt.in_view_tilted - found.tilt.in_view >= WORTH:
        way = "down" if found.tilt.degrees > 0 else "up"
        which = f"; hardly ever in a picture: {', '.join(hidden)}" if hidden else ""
        lines.append(
            f"Tilt the cameras {way} by {abs(found.tilt.degrees)} degrees: "
            f"{100 * found.tilt.in_view_tilted:.0f} % instead of {100 * found.tilt.in_view:.0f} % "
            f"of the joints would be in a picture{which}."
        )
    elif hidden:
        lines.append(f"Hardly ever in a picture: {', '.join(hidden)}. No tilt of the cameras "
                     "shows more; lenses with a wider field of view would.")  # fmt: skip
    unseen = sorted({_plain(name) for name, share in found.seen.items()
                     if share < SELDOM <= found.in_view[name] and name != "head"})  # fmt: skip
    if unseen:
        lines.append(f"In the pictures but seldom recognised: {', '.join(unseen)}. Where they are "
                     "not hidden, more light, a shorter exposure or clothes unlike the background "
                     "help.")  # fmt: skip
    return lines


def _about_pictures(found: Findings) -> list[str]:
    lines = []
    for name, view in found.views.items():
        pictures = max(view.get("pictures", 0), 1)
        lost = sum(view.get(kind, 0) for kind in ("dropped", "repeated", "damaged", "black"))
        if lost > 0.01 * pictures:
            lines.append(f"The {name} camera lost {lost:.0f} of {pictures + view['dropped']:.0f} "
                         "pictures: a faster card or a lower bit rate keeps them.")  # fmt: skip
        if abs(view["offset_ms"]) > 5.0 and view["clock"] == "estimated":
            late = "late" if view["offset_ms"] > 0 else "early"
            lines.append(f"The {name} camera was started {abs(view['offset_ms']):.0f} ms {late}; "
                         "this was corrected.")  # fmt: skip
        if view["clock"] == "assumed" and name != next(iter(found.views)):
            lines.append(f"The clock of the {name} camera is assumed to be that of the first; give "
                         "--lag if it is not.")  # fmt: skip
    return lines


def _without_nan(value: Any) -> Any:
    """The same with null for numbers that are not known, as JSON has it."""
    if isinstance(value, dict):
        return {key: _without_nan(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _by_label(values: Float[Array, "18"], digits: int = 4) -> dict[str, float]:
    return {name: round(float(value), digits) for name, value in zip(LABELS, values, strict=True)}


def _plain(label: str) -> str:
    """The kind of joint in words, of both sides."""
    kind = without_side(label)
    return kind if kind == label else {"foot": "feet"}.get(kind, kind + "s")
