"""Stereo fisheye odometry: pictures of a rig in, frame by frame; head poses, or none, out.

Corners are followed from frame to frame (Lucas-Kanade) in every view; the pose minimises the robust
error of their rays against the map's points; keyframes add points by stereo and refine the last
poses and points by bundle adjustment. A frame whose pose too few points support has none. Causal:
a frame's result depends on earlier frames alone.

Source: Klein and Murray 2007 (keyframes); Mur-Artal and Tardos 2017 (stereo points, windows).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.geometry import rigid
from egocap.odometry import stereo
from egocap.odometry.adjustment import adjust
from egocap.odometry.config import OdometryConfig
from egocap.odometry.corners import find_corners
from egocap.odometry.ray_kernel import exponential, refine_pose, squared_residuals
from egocap.odometry.rejections import RejectionMap
from egocap.odometry.surface_patches import aligned, fitting, patches_at, warps
from egocap.odometry.track_map import Observations, Posed, TrackMap, twist_between
from egocap.odometry.views import Motion, Views

WIDTHS = np.array([30.0, 12.0, 5.0, 3.0])
"""Widths of the loss in a pose's successive rounds, standard deviations."""
LEAST_KEPT = 0.55  # of a keyframe's observations; with fewer left, the next keyframe follows
GATE = 4.0  # sigmas beyond which an observation is an outlier
QUARTILE = 0.7585  # of the residuals in two dimensions, standard deviations
NOISIEST, NOISE_FADING = 2.5, 0.8
"""Corners may be placed so many times worse than stated, if all are: in such surroundings. What a
frame tells of it fades so fast: a crowd that moves otherwise is no noise."""
LEAST_SHARE = 0.5  # of the followed points that agree with a pose
MOST_SIGMA = 0.05  # m; a pose less certain is none
_OLDER = 4  # fixed keyframes before the window

FLOW_NOISE_PX = 0.5
"""Standard deviation of a corner as the optical flow follows it, pixels at the reduced width: it
moves pictures without turning or stretching them, so that fast turns shift it."""
AGAIN_NOISE_PX = 0.25
"""Standard deviation of a point that is seen again from elsewhere, with that of its depth."""
LONGEST_S = 0.5
"""Time since the last frame up to which its velocity tells where the head is."""
FAST_TURN = np.deg2rad(3.0)
"""Turn from frame to frame above which the last picture is turned before corners are followed."""
GREY_NOISE = 1.0
"""Standard deviation of grey values, against which weak texture is weighed."""

Image = UInt8[Array, "H W"]


@dataclass(frozen=True, eq=False)
class HeadPose:
    """Pose of one frame; None where it is not known, with the reason."""

    T_world_head: Float[Array, "4 4"] | None
    covariance: Float[Array, "6 6"] | None  # of rotation (rad) and translation (m), in the map
    points: int  # that support it
    problem: str = ""
    segment: int = -1  # number of the map that it belongs to


class Odometry:
    """Head poses of a stream of frames. The first pose is the identity."""

    def __init__(self, views: Views, config: OdometryConfig = OdometryConfig()) -> None:  # noqa: B008
        self.views, self.config, self.map = views, config, TrackMap()
        self.wearer = [RejectionMap(c.width, c.height) for c in views.cameras]
        self._images: tuple[Image | None, ...] = (None,) * len(views)
        self._followed = Observations.empty()  # in `_images`
        self._last: Posed | None = None
        self._before: Posed | None = None
        self._missed, self._segment = 0, -1
        self.noise = 1.0
        """Deviation of the last residuals as a multiple of the stated one, 1 to `NOISIEST`."""

    def add(
        self, index: int, time: float, images: tuple[Image | None, ...],
        excluded: tuple[Bool[Array, "H W"] | None, ...] = (),
        late: Float[Array, "V"] | None = None,
    ) -> HeadPose:  # fmt: skip
        """The head pose at the next frame from grey pictures of the working size.

        `excluded`: pixels that do not show the static surroundings, one array a view. `late`:
        seconds after `time` at which each picture was taken.
        """
        motion = Motion.none(len(self.views)) if late is None else Motion(np.zeros(6), late)
        masks = tuple(
            lens if k is None else np.where(k, 0, lens).astype(np.uint8)
            for lens, k in zip(
                self.views.lens_masks, excluded or (None,) * len(self.views), strict=True
            )
        )
        if self._last is None or self._segment < 0:
            return self._begin(index, time, motion, images, masks)
        R, t = self._predicted(time)
        seen = self._follow(images, masks, R, t, motion)
        motion = replace(motion, twist=self._last.motion.twist)
        guess = replace(self._last, index=index, time=time, R=R, t=t, motion=motion)
        pose = self._pose(seen, guess)
        if isinstance(pose, Posed):
            pose.motion = replace(motion, twist=self._twist(pose))
            pose = self._sharpened(pose, images)
        if isinstance(pose, str):
            return self._miss(pose, len(seen.point))
        self._missed = 0
        noise = NOISE_FADING * self.noise + (1.0 - NOISE_FADING) * pose.noise
        self.noise = float(np.clip(noise, 1.0, NOISIEST))
        self._images, self._followed = images, pose.seen
        self._before, self._last = self._last, pose
        self.map.frames.append(pose)
        if self._is_keyframe(pose):
            self._add_keyframe(pose, images, masks)
        return _result(pose)

    def _begin(
        self, index: int, time: float, motion: Motion, images: tuple[Image | None, ...],
        masks: tuple[Image, ...],
    ) -> HeadPose:  # fmt: skip
        """Start a segment where stereo finds enough points."""
        segment = 1 + max((f.segment for f in self.map.frames), default=-1)
        origin = Posed(index, time, np.eye(3), np.zeros(3), Observations.empty(), False,
                       segment, np.zeros((6, 6)), motion)  # fmt: skip
        before = len(self.map.points)
        seen = self._new_points(origin, images, masks)
        if len(np.unique(seen.point)) < self.config.fewest:
            self.map.keep_points(before)
            return HeadPose(None, None, len(np.unique(seen.point)), "too few points with depth")
        origin.seen, self._segment, self._missed = seen, origin.segment, 0
        origin.keyframe, origin.information = True, 1e8 * np.eye(6)
        self.map.frames.append(origin)
        self.map.keyframes.append(len(self.map.frames) - 1)
        self._images, self._followed = images, seen
        self._last, self._before = origin, None
        return _result(origin)

    def _miss(self, problem: str, points: int) -> HeadPose:
        self._missed += 1
        if self._missed > self.config.patience:
            self._segment = -1
        return HeadPose(None, None, points, problem)

    def _predicted(self, time: float) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
        """Pose at constant velocity in the head frame."""
        last, before = self._last, self._before
        assert last is not None
        elapsed = time - last.time
        if before is None or last.time <= before.time or elapsed > LONGEST_S:
            return last.R, last.t
        ahead = elapsed * twist_between(before, last, last.R)
        return last.R @ exponential(ahead[:3]), last.t + last.R @ ahead[3:]

    def _follow(
        self, images: tuple[Image | None, ...], masks: tuple[Image, ...],
        R: Float[Array, "3 3"], t: Float[Array, "3"], motion: Motion,
    ) -> Observations:  # fmt: skip
        """Followed points in the new pictures, from their places at the predicted pose."""
        found = Observations.empty()
        assert self._last is not None
        turn = self._last.R.T @ R
        fast = np.trace(turn) < 1.0 + 2.0 * np.cos(FAST_TURN)
        for v, image in enumerate(images):
            rows = np.flatnonzero(self._followed.view == v)
            last = self._images[v]
            if image is None or last is None or not len(rows):
                continue
            old = self._followed[rows]
            guess, ahead = self.views.project(v, (self.map.points[old.point] - t) @ R)
            start = old.pixel
            if fast:
                last = self.views.turned(v, last, turn)
                start, _ = self.views.project_directions(v, self.views.rays(v, start)[0] @ turn)
            pixels, good = _lucas_kanade(last, image, start, guess)
            last_pixel = np.array(image.shape)[::-1] - 1
            u, w = np.clip(pixels.round().astype(int), 0, last_pixel).T
            good &= ahead & (masks[v][w, u] > 0)
            noise_px = max(FLOW_NOISE_PX, self.config.noise_px)
            found = found.joined(self._observed(v, old.point[good], pixels[good], motion, noise_px))
        return found

    def _twist(self, pose: Posed) -> Float[Array, "6"]:
        """The head's velocity at a new pose, from the last ones' extrapolated."""
        last, before = self._last, self._before
        assert last is not None
        now = twist_between(last, pose, pose.R)
        if before is None or self._missed:
            return now
        step = (pose.time - last.time) / (pose.time - before.time)
        return now + step * (now - twist_between(before, last, pose.R))

    def _observed(
        self, view: int, points: Array, pixels: Float[Array, "n 2"], motion: Motion,
        noise_px: float | None = None,
    ) -> Observations:  # fmt: skip
        rays, _, density, valid = self.views.rays_and_derivative(view, pixels)
        points, pixels, rays, density = (x[valid] for x in (points, pixels, rays, density))
        blur = GREY_NOISE / np.maximum(self.map.patches.sharpness[points], 1e-3)
        sigma = np.hypot(noise_px or self.config.noise_px, blur)
        return Observations(points, np.full(len(points), view), pixels, rays,
                            self.views.delay(view, pixels, motion), density / sigma)  # fmt: skip

    def _pose(self, seen: Observations, guess: Posed, scale: float = 1.0) -> Posed | str:
        """The robust pose near a guess, or why there is none; `scale` is one on the deviations."""
        if len(seen.point) < self.config.fewest:
            return "too few points followed"
        data = (self.map.points[seen.point],
                *self.views.sights(seen.view, seen.ray, seen.delay, guess.motion.twist),
                seen.inv_sigma)  # fmt: skip
        R, t, H = refine_pose(guess.R, guess.t, *data, WIDTHS, 6)
        squared = squared_residuals(R, t, *data)
        inlier = squared < (GATE * scale) ** 2
        self._learn_wearer(seen, inlier)
        if len(np.unique(seen.point[inlier])) < self.config.fewest:
            return "too few points agree"
        if inlier.mean() < LEAST_SHARE:
            return "most points move otherwise"
        sigma = scale * np.sqrt(np.trace(np.linalg.inv(H)[3:, 3:]))
        if not sigma < MOST_SIGMA:
            return "the points do not determine the pose"
        return replace(guess, R=R, t=t, seen=seen[inlier], keyframe=False, segment=self._segment,
                       information=H / scale**2,
                       noise=float(np.sqrt(np.quantile(squared, 0.25)) / QUARTILE))  # fmt: skip

    def _sharpened(
        self, pose: Posed, images: tuple[Image | None, ...], noise_px: float | None = None
    ) -> Posed | str:
        """The pose from points aligned with their first pictures as they look from there."""
        found = Observations.empty()
        for v, image in enumerate(images):
            rows = np.flatnonzero(pose.seen.view == v)
            if image is None or not len(rows):
                continue
            old = pose.seen[rows]
            A = self._warps(old.point, v, pose)
            pixels, good = aligned(self.map.patches, old.point, image, old.pixel, A)
            found = found.joined(
                self._observed(v, old.point[good], pixels[good], pose.motion, noise_px)
            )
        return self._pose(found, pose, self.noise)

    def forget(self) -> None:
        """Drop frames and points that later poses do not need, so that memory does not grow.

        Poses stay the same; loops cannot be closed then, nor segments joined.
        """
        if not self.map.frames:
            return
        number = self.map.forget(self.config.window + _OLDER + 1, self._followed.point)
        self._followed = replace(self._followed, point=number[self._followed.point])

    def seen_again(
        self, pose: Posed, points: Int[Array, "n"], images: tuple[Image | None, ...]
    ) -> Posed | None:
        """A pose from points of the map alone that it may see; None where too few fit there.

        Twice: the first time from what lies within reach of the pose that is given.
        """
        if not len(points):
            return None
        for _ in range(2):
            found = Observations.empty()
            for v, lens in enumerate(self.views.lens_masks):
                pixels, ahead = self.views.project_moving(
                    v, (self.map.points[points] - pose.t) @ pose.R, pose.motion
                )
                u, w = np.clip(pixels.round(), 0, np.array(lens.shape)[::-1] - 1).astype(int).T
                seen = np.flatnonzero(ahead & (lens[w, u] > 0))
                seen = seen[fitting(self._warps(points[seen], v, pose))][: self.config.corners]
                found = found.joined(self._observed(v, points[seen], pixels[seen], pose.motion))
            again = self._sharpened(replace(pose, seen=found), images, AGAIN_NOISE_PX)
            if isinstance(again, str):
                return None
            pose = again
        return pose

    def _warps(self, points: Array, view: int, pose: Posed) -> Float[Array, "n 2 2"]:
        return warps(self.map.patches, points, self.map.points[points], *self.map.hosts(points),
                     self.views, view, (pose.R, pose.t))  # fmt: skip

    def _renew_patches(self, pose: Posed, images: tuple[Image | None, ...]) -> None:
        """Take new pictures of points that look much smaller, larger or thinner than at first."""
        for v, image in enumerate(images):
            rows = np.flatnonzero(pose.seen.view == v)
            if image is None or not len(rows):
                continue
            seen = pose.seen[rows]
            rows = np.flatnonzero(~fitting(self._warps(seen.point, v, pose)))
            points = seen.point[rows]
            new, inside = patches_at(self.views, v, len(self.map.frames) - 1, image,
                                     seen.pixel[rows], self.map.patches.normal[points])  # fmt: skip
            self.map.patches.replace(points[inside], new[inside])

    def _is_keyframe(self, pose: Posed) -> bool:
        key = self.map.frames[self.map.keyframes[-1]]
        fewer = len(pose.seen.point) < LEAST_KEPT * len(key.seen.point)
        return fewer or are_apart(key, pose, self.config)

    def _add_keyframe(
        self, pose: Posed, images: tuple[Image | None, ...], masks: tuple[Image, ...]
    ) -> None:
        pose.keyframe = True
        self._renew_patches(pose, images)
        pose.seen = pose.seen.joined(self._new_points(pose, images, masks))
        self.map.keyframes.append(len(self.map.frames) - 1)
        self._refine_window()
        self._followed = pose.seen

    def _new_points(
        self, pose: Posed, images: tuple[Image | None, ...], masks: tuple[Image, ...]
    ) -> Observations:
        """Corners of every view that stereo gives a depth; those of the wearer are left out."""
        added = Observations.empty()
        host = len(self.map.frames) - (0 if self._segment < 0 else 1)
        for a, image in enumerate(images):
            if image is None:
                continue
            taken = pose.seen.joined(added)
            taken = taken.pixel[taken.view == a]
            mask = np.where(self.wearer[a].rejected, 0, masks[a])
            corners = find_corners(image, mask, taken, max(self.config.corners - len(taken), 0))
            for b in self.views.partners[a]:
                if not len(corners) or images[b] is None:
                    continue
                pair = stereo.match(self.views, a, b, images, corners, self.config.noise_px,  # pyright: ignore
                                    pose.motion)  # fmt: skip
                own = is_wearer(pair.points_head)
                self.wearer[a].add(corners[pair.rows], own)
                rows, kept = pair.rows[~own], np.flatnonzero(~own)
                patches, _ = patches_at(self.views, a, host, image, corners[rows],
                                        pair.normal_head[kept] @ pose.R.T)  # fmt: skip
                points = pair.points_head[kept] @ pose.R.T + pose.t
                numbers = self.map.add_points(points, patches)
                added = added.joined(self._observed(a, numbers, corners[rows], pose.motion))
                added = added.joined(self._observed(b, numbers, pair.pixels[kept], pose.motion))
                corners = np.delete(corners, pair.rows, axis=0)
        return added

    def _learn_wearer(self, seen: Observations, inlier: Bool[Array, "n"]) -> None:
        for v, wearer in enumerate(self.wearer):
            rows = seen.view == v
            wearer.add(seen.pixel[rows], ~inlier[rows])

    def _refine_window(self) -> None:
        """Bundle adjustment of the last keyframes; some older ones are fixed."""
        keys = [k for k in self.map.keyframes if self.map.frames[k].segment == self._segment]
        free = keys[-self.config.window :]
        older = keys[-self.config.window - _OLDER : -self.config.window]
        fixed = np.arange(len(older) + len(free)) < max(len(older), 1)
        self.map.renew_twists([*older, *free][:-1])
        problem, numbers = self.map.problem([*older, *free], fixed, self.views)
        found = adjust(problem, 3.0, 3)
        for i, k in enumerate([*older, *free]):
            self.map.frames[k].R, self.map.frames[k].t = found.R[i], found.t[i]
        self.map.points[numbers] = found.points


def are_apart(a: Posed, b: Posed, config: OdometryConfig) -> bool:
    """Whether the head moved or turned so far that both frames are keyframes."""
    turned = np.degrees(np.arccos(np.clip((np.trace(a.R.T @ b.R) - 1) / 2, -1, 1)))
    moved = np.linalg.norm(b.t - a.t)
    return bool(moved > config.keyframe_move or turned > config.keyframe_turn)


def is_wearer(points_head: Float[Array, "n 3"]) -> Bool[Array, "n"]:
    """Whether points lie where the wearer's own body may be: near the head or below it."""
    near = np.linalg.norm(points_head, axis=1) < 0.9
    below = (np.hypot(points_head[:, 0], points_head[:, 1]) < 0.45) & (points_head[:, 2] < 0.2)
    return near | below


def _result(pose: Posed) -> HeadPose:
    covariance = np.linalg.inv(pose.information)
    points = len(np.unique(pose.seen.point))
    return HeadPose(rigid(pose.R, pose.t), covariance, points, segment=pose.segment)


def _lucas_kanade(
    last: Image, image: Image, pixels: Float[Array, "n 2"], guess: Float[Array, "n 2"]
) -> tuple[Float[Array, "n 2"], Bool[Array, "n"]]:
    import cv2

    found, good, error = cv2.calcOpticalFlowPyrLK(
        last, image, _points(pixels), _points(guess),
        winSize=(15, 15), maxLevel=2, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 0.01),
    )  # fmt: skip
    return found[:, 0].astype(float), (good[:, 0] == 1) & (error[:, 0] < 20.0)


def _points(pixels: Float[Array, "n 2"]) -> Array:
    return np.ascontiguousarray(pixels[:, None], np.float32)
