"""Tracking with a rig that slips: its pose on the head over time, and sudden jumps of it.

The mount is estimated in windows of some seconds, as in `fit_rig` with a known body. An estimate is
off by a constant, which the body and the pose prior cause, and by an error of its own, since
postures differ between windows. What is left moves as a random walk from the given rig; a jump is a
step that the walk explains badly. Each window is tracked with its own rig.

Source: Rauch, Tung and Striebel 1965 (here as one least-squares problem); Willsky and Jones 1976,
generalised likelihood ratio test for jumps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.fitting.body_prior import to_components
from egocap.fitting.bundle_adjustment import information, linearised, select_frames, solve
from egocap.fitting.config import FitConfig
from egocap.fitting.fit_body import choose_frames
from egocap.fitting.fit_rig import moved_rig
from egocap.fitting.mount import MountPrior, MountProblem
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe

if TYPE_CHECKING:
    from egocap.track.colour_refinement import Images

WINDOW_S = 5.0
_FRAMES = 20  # of a window that take part
_OVERLAP_S = 0.5  # before and after a window, for the smoothing of its track
_BODY_M = 0.001  # standard deviation of the known body's components
_PRIOR = np.repeat([np.deg2rad(10.0), 0.03], 3)  # of a window's mount, and of the constant
_POSTURE = np.repeat([np.deg2rad(5.0), 0.003], 3)  # of a window's own error
_WALK = np.repeat([np.deg2rad(0.1), 0.0005], 3)  # of the drift after a second
_START = np.repeat([np.deg2rad(0.1), 0.0005], 3)  # of the given rig at the start
_JUMP = np.repeat([np.deg2rad(20.0), 0.05], 3)  # of a jump
_SURE = 27.9  # decrease of chi^2 by a jump: chance of 1e-4 with 6 degrees of freedom
_LEAST_JUMP = np.repeat([np.deg2rad(2.0), 0.004], 3)


@dataclass(frozen=True, eq=False)
class MountDrift:
    """Movement of a rig on the head, against the rig as given: rotation vector [rad], shift [m]."""

    times: Float[Array, "K"]  # middle of each window, seconds
    shift: Float[Array, "K 6"]
    std: Float[Array, "K 6"]
    jumps: tuple[int, ...]  # windows before which the rig jumped

    def to_dict(self) -> dict[str, object]:
        """JSON-ready: degrees and millimetres."""
        scale = np.repeat([np.rad2deg(1.0), 1e3], 3)
        return {"times": self.times.round(3).tolist(),
                "shift_deg_mm": (self.shift * scale).round(3).tolist(),
                "std_deg_mm": (self.std * scale).round(3).tolist(),
                "jumps_s": [round(float(self.times[k - 1 : k + 1].mean()), 2)
                            for k in self.jumps]}  # fmt: skip

    def lines(self) -> list[str]:
        """What was seen, for a terminal."""
        most = 1e3 * float(np.linalg.norm(self.shift[:, 3:], axis=1).max())
        error = 1e3 * float(np.linalg.norm(self.std[:, 3:], axis=1).max())
        found = [f"mount: moved by up to {most:.1f} mm (+- {error:.1f}) against the rig file"]
        for k in self.jumps:
            step = self.shift[k] - self.shift[k - 1]
            found.append(
                f"mount: jumped by {1e3 * np.linalg.norm(step[3:]):.0f} mm between "
                f"{self.times[k - 1]:.0f} and {self.times[k]:.0f} s; its rotation is not seen: run "
                "fit-rig on footage after it"
            )
        return found


def track_with_drift(
    detections: Detections,
    rig: Rig,
    proportions: Proportions,
    config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
    images: Images | None = None,
    on_frames: Callable[[int], None] = lambda count: None,
) -> tuple[Track, MountDrift]:
    """Track with a rig that slips. `Track.config["mount_drift"]` holds the drift.

    `on_frames` is called with the frames tracked; all frames are tracked twice. Raises InputError
    for footage shorter than two windows, and as `tracker.track`.
    """
    from egocap.track.tracker import Tracker

    windows = split(detections.times)
    first = Tracker(rig, proportions, config).track(detections, on_frames=on_frames)
    drift = mount_drift(detections, first.angles, rig, proportions, config, windows)
    parts, times = [], np.asarray(detections.times, float)
    for window, shift in zip(windows, drift.shift, strict=True):
        start, end = np.searchsorted(
            times, [times[window[0]] - _OVERLAP_S, times[window[-1]] + _OVERLAP_S]
        )
        moved = Tracker(moved_rig(rig, shift), proportions, config)
        own = None if images is None else (lambda t, start=start: images(t + start))
        part = moved.track(detections[start:end], own)
        rows = {name: values[window - start] for name, values in part.by_frame.items()}
        parts.append(replace(part, **rows))
        on_frames(len(window))
    return _joined(parts, first.config | {"mount_drift": drift.to_dict()}), drift


def split(times: Float[Array, "T"]) -> list[Int[Array, "_"]]:
    """Frames of windows of equal length. Raises InputError for footage of less than two."""
    times = np.asarray(times, float)
    seconds = float(np.ptp(times)) if len(times) else 0.0
    count = int(seconds // WINDOW_S)
    if count < 2:
        raise InputError(f"the drift of a mount in {seconds:.1f} s of footage",
                         valid=f"{2 * WINDOW_S:.0f} s or more")  # fmt: skip
    place = np.minimum(((times - times[0]) / seconds * count).astype(int), count - 1)
    return [np.flatnonzero(place == k) for k in range(count) if (place == k).any()]


def mount_drift(
    detections: Detections,
    angles: Float[Array, "T 37"],
    rig: Rig,
    proportions: Proportions,
    config: TrackerConfig,
    windows: list[Int[Array, "_"]],
) -> MountDrift:
    """The drift from detections and the angles of a track with the rig as given."""
    observations = observe(detections, rig, proportions, config)
    used = np.count_nonzero(observations.weights, axis=(1, 2))
    body = to_components(proportions)
    spread = np.eye(len(body)) * _BODY_M**2
    prior = MountPrior.around(body, spread, float(_PRIOR[0]), float(_PRIOR[3]))
    found, covariances = [], []
    for window in windows:
        chosen = window[choose_frames(angles[window], used[window], _FRAMES)]
        if not len(chosen):  # nothing seen: the prior alone
            found.append(np.zeros(6))
            covariances.append(np.diag(_PRIOR**2))
            continue
        problem = MountProblem(select_frames(observations, chosen), prior, config,
                               np.zeros((len(chosen), 4)))  # fmt: skip
        poses, shared, _ = solve(problem, angles[chosen], prior.mean, FitConfig(iterations=15))
        H = information(linearised(problem, poses, shared))
        found.append(shared[-6:])
        covariances.append(np.linalg.inv(H)[-6:, -6:])
    times = np.asarray(detections.times, float)
    middles = np.array([times[w].mean() for w in windows])
    return smoothed(middles, np.array(found), np.array(covariances))


def smoothed(
    times: Float[Array, "K"], found: Float[Array, "K 6"], covariances: Float[Array, "K 6 6"]
) -> MountDrift:
    """The random walk, with jumps, behind the estimates of windows."""
    jumps: tuple[int, ...] = ()
    shift, std, cost = _walk(times, found, covariances, jumps)
    while True:
        tried = {k: _walk(times, found, covariances, (*jumps, k))
                 for k in range(1, len(times)) if k not in jumps}  # fmt: skip
        if not tried:
            break
        k = min(tried, key=lambda k: tried[k][2])
        step = np.abs(tried[k][0][k] - tried[k][0][k - 1])
        if cost - tried[k][2] < _SURE or not (step > _LEAST_JUMP).any():
            break
        jumps = tuple(sorted((*jumps, k)))
        shift, std, cost = tried[k]
    return MountDrift(times, shift, std, jumps)


def _walk(
    times: Float[Array, "K"], found: Float[Array, "K 6"], covariances: Float[Array, "K 6 6"],
    jumps: tuple[int, ...],
) -> tuple[Float[Array, "K 6"], Float[Array, "K 6"], float]:  # fmt: skip
    """Least squares over the shifts and the estimates' constant: shifts, deviations and chi^2."""
    K = len(times)
    rows, right = [], []

    def add(blocks: dict[int, float], value: Array, root: Float[Array, "6 6"]) -> None:
        row = np.zeros((6, 6 * (K + 1)))
        for block, sign in blocks.items():
            row[:, 6 * block : 6 * block + 6] = sign * root
        rows.append(row)
        right.append(root @ value)

    for k in range(K):
        own = covariances[k] + np.diag(_POSTURE**2)
        add({k: 1.0, K: 1.0}, found[k], np.linalg.inv(np.linalg.cholesky(own)))
    for k in range(1, K):
        spread = _JUMP if k in jumps else _WALK * np.sqrt(times[k] - times[k - 1])
        add({k: 1.0, k - 1: -1.0}, np.zeros(6), np.diag(1.0 / spread))
    add({0: 1.0}, np.zeros(6), np.diag(1.0 / _START))
    add({K: 1.0}, np.zeros(6), np.diag(1.0 / _PRIOR))
    A, b = np.concatenate(rows), np.concatenate(right)
    covariance = np.linalg.inv(A.T @ A)
    x = covariance @ (A.T @ b)
    std = np.sqrt(np.diag(covariance))[: 6 * K].reshape(K, 6)
    return x[: 6 * K].reshape(K, 6), std, float(((A @ x - b) ** 2).sum())


def _joined(parts: list[Track], config: dict[str, object]) -> Track:
    """Tracks one after another."""
    arrays = {name: np.concatenate([part.by_frame[name] for part in parts])
              for name in parts[0].by_frame}  # fmt: skip
    seconds = float(np.mean([part.seconds_per_frame for part in parts]))
    return replace(parts[0], **arrays, config=config, seconds_per_frame=seconds)
