"""What the Rerun viewer is given: a motion in space, over its images and as curves.

Everything lies in the world if all of it has a known head pose, else in the head frame. Left is
blue, right vermilion, the truth of a simulated sequence light grey; ellipsoids are two standard
deviations. Cameras are drawn as the cone of their field of view, up to 80 degrees off the axis.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence as Items
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS, LIMBS
from egocap.body.proportions import Proportions
from egocap.body.side_colours import side_colour
from egocap.body.skeleton import DOFS, forward
from egocap.cameras.rig import Rig
from egocap.commandline import progress
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.geometry import matrix_to_quaternion, transform
from egocap.pose.initial_poses import start_poses
from egocap.posterior.result import Posterior
from egocap.view.skeleton import FEET, STANDS, SURROUNDINGS

IMAGE_HEIGHT = 480
"""Of the images in a recording at most, pixels."""
TRUTH = (190, 190, 190)
DRAWS = 60
"""Draws of a posterior that are shown, spread over the chain."""
_CONE_M, _MOST_CONE = 0.08, np.deg2rad(80.0)
_TRAIL = 2000  # places of the head in a live run
_CURVES = ("elbow_flexion", "knee_flexion")
_JPEG = (1, 80)  # cv2.IMWRITE_JPEG_QUALITY


@dataclass(frozen=True, eq=False)
class HeadPath:
    """Head poses of a file, and the points of the surroundings that it has."""

    times: Float[Array, "N"]  # s
    T_world_head: Float[Array, "N 4 4"]
    points: Float[Array, "P 3"]  # world, m


@dataclass
class Shown:
    """What is shown together: at most one of sequence, rig and head path, any number of tracks and
    posteriors."""

    sequence: Sequence | None = None
    rig: Rig | None = None
    tracks: dict[str, Track] = field(default_factory=dict)
    posteriors: dict[str, Posterior] = field(default_factory=dict)
    head: HeadPath | None = None
    placed: bool = False
    """Whether a live run is in the world."""

    @property
    def in_world(self) -> bool:
        """Whether all of it has a head pose."""
        if self.placed:
            return True
        known = [track.T_world_head is not None for track in self.tracks.values()]
        return not self.posteriors and all(known) and bool(known or self.head or self._truth)

    @property
    def floor(self) -> float:
        """Height of the drawn grid: the ground of the world, or the lowest joint."""
        if self.in_world:
            return 0.0
        joints = [track.joints_head for track in self.tracks.values()]
        joints += [posterior.joint_mean for posterior in self.posteriors.values()]
        if self._truth:
            joints.append(self.sequence.truth.joints_head)  # pyright: ignore
        return float(min(np.min(found[..., 2]) for found in joints or [_standing()]))

    @property
    def _truth(self) -> bool:
        return self.sequence is not None and bool(self.sequence.manifest.truth)


class Scene:
    """One recording. Entities: space/, views/NAME/, curves/KIND/."""

    def __init__(self, rr: Any, recording: Any, shown: Shown) -> None:
        self.rr, self.out, self.shown = rr, recording, shown
        self._known: set[tuple[str, type]] = set()  # what does not change with time
        self._trail: deque[Float[Array, "3"]] = deque(maxlen=_TRAIL)  # places of a live run's head

    def log(self, images: bool) -> None:
        shown = self.shown
        self._static("space", self.rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        if shown.sequence is not None:
            if images:
                self._images(shown.sequence)
            if shown.sequence.manifest.truth:
                self._truth(shown.sequence)
        for name, track in shown.tracks.items():
            self._track(name, track)
        for name, posterior in shown.posteriors.items():
            self._posterior(name, posterior)
        if shown.head is not None:
            self._surroundings(shown.head)
        if shown.rig is not None:
            self._rig(shown.rig)
            if not (shown.sequence or shown.tracks or shown.posteriors or shown.head):
                self._wearer()

    def start(self, rig: Rig) -> None:
        """Begin a live run: what does not change with time."""
        self._static("space", self.rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._rig(rig)

    def show(self, name: str, track: Track, images: Items[UInt8[Array, "H W 3"] | None]) -> None:
        """One frame of a live run: a track of one frame, and the pictures of the views."""
        rig = self.shown.rig
        assert rig is not None and len(track.times) == 1
        for view, camera, image in zip(rig.views, rig.cameras, images, strict=True):
            if image is not None:
                self._pictures(view, track.times, [_jpeg(image, camera.height)])
        self._track(name, track)
        if track.T_world_head is not None:
            self._trail.append(track.T_world_head[0, :3, 3])
            self._path(np.array(self._trail))

    def _static(self, path: str, what: Any) -> None:
        if (path, type(what)) not in self._known:
            self._known.add((path, type(what)))
            self.out.log(path, what, static=True)

    def _columns(self, path: str, times: Float[Array, "T"], columns: Any) -> None:
        self.rr.send_columns(path, [self.rr.TimeColumn("time", duration=times)], columns,
                             recording=self.out)  # fmt: skip

    def _pose(
        self, path: str, times: Float[Array, "T"], joints: Float[Array, "T 18 3"],
        colour: tuple[int, int, int] | None = None,
    ) -> None:  # fmt: skip
        """Limbs and joints over time, by side or all in one colour."""
        rr, frames = self.rr, len(times)
        limbs = joints[:, np.array(LIMBS)].reshape(-1, 2, joints.shape[-1])
        flat = joints.reshape(-1, joints.shape[-1])
        by_limb = [colour or side_colour(LABELS[b]) for _, b in LIMBS]
        by_joint = [colour or side_colour(label) for label in LABELS]
        lines, points = ((rr.LineStrips3D, rr.Points3D) if joints.shape[-1] == 3
                         else (rr.LineStrips2D, rr.Points2D))  # fmt: skip
        thick, wide = (0.006, 0.014) if joints.shape[-1] == 3 else (1.5, 3.0)
        self._static(f"{path}/limbs", lines.from_fields(colors=by_limb, radii=thick))
        self._columns(f"{path}/limbs", times,
                      lines.columns(strips=limbs).partition([len(LIMBS)] * frames))  # fmt: skip
        self._static(f"{path}/joints", points.from_fields(
            colors=by_joint, radii=wide, labels=[label.replace("_", " ") for label in LABELS],
            show_labels=False))  # fmt: skip
        self._columns(f"{path}/joints", times,
                      points.columns(positions=flat).partition([len(LABELS)] * frames))  # fmt: skip

    def _over_images(
        self, name: str, times: Float[Array, "T"], joints_head: Float[Array, "T 18 3"],
        colour: tuple[int, int, int] | None = None,
    ) -> None:  # fmt: skip
        """The pose projected into all views."""
        rig = self.shown.rig
        if rig is None:
            return
        pixels, inside = rig.project(joints_head)
        for view, camera, at, valid in zip(rig.views, rig.cameras, pixels, inside, strict=True):
            scale = _image_scale(camera.height)
            shown = np.where(valid[..., None], (at + 0.5) * scale, np.nan)
            self._pose(f"views/{view}/{name}", times, shown, colour)

    def _images(self, sequence: Sequence) -> None:
        cameras = sequence.rig.cameras
        with progress("images", len(sequence) * len(cameras), unit="images") as advance:
            for v, camera in enumerate(cameras):
                found, at = [], []
                for i, time in enumerate(sequence.times):
                    if (image := sequence.picture(i, v)) is not None:
                        found.append(_jpeg(image, camera.height))
                        at.append(time)
                    advance(1)
                self._pictures(sequence.rig.views[v], np.array(at), found)

    def _pictures(self, view: str, times: Float[Array, "T"], jpegs: list[bytes]) -> None:
        self._static(f"views/{view}", self.rr.EncodedImage.from_fields(media_type="image/jpeg"))
        self._columns(f"views/{view}", times, self.rr.EncodedImage.columns(blob=jpegs))

    def _truth(self, sequence: Sequence) -> None:
        truth = sequence.truth
        world = self.shown.in_world
        self._pose("space/truth", truth.time, truth.joints_world if world else truth.joints_head,
                   TRUTH)  # fmt: skip
        self._over_images("truth", truth.time, truth.joints_head, TRUTH)
        if world and not self.shown.tracks:
            self._head(truth.time, truth.T_world_head)

    def _track(self, name: str, track: Track) -> None:
        world = self.shown.in_world
        joints = (
            track.joints_world if world and track.joints_world is not None else track.joints_head
        )
        self._pose(f"space/{name}", track.times, joints)
        self._over_images(name, track.times, track.joints_head)
        if track.covariance is not None:
            turned = track.T_world_head[:, None, :3, :3] if world else None  # pyright: ignore
            self._ellipsoids(
                f"space/{name}/uncertainty", track.times, joints, track.covariance, turned
            )
        if world:
            self._head(track.times, np.asarray(track.T_world_head))
            self._contacts(f"space/{name}/contacts", track, joints)
        self._curves(name, track)

    def _head(self, times: Float[Array, "T"], T_world_head: Float[Array, "T 4 4"]) -> None:
        """The head's frame over time, and its path."""
        place = T_world_head[:, :3, 3]
        self._columns("space/head", times, self.rr.Transform3D.columns(
            translation=place, mat3x3=T_world_head[:, :3, :3]))  # fmt: skip
        self._path(place)

    def _path(self, places: Float[Array, "T 3"]) -> None:
        """The way of the head, and below it on the floor."""
        ways = [places, places * [1.0, 1.0, 0.0]]
        path = self.rr.LineStrips3D(ways, colors=[TRUTH], radii=0.003)
        self.out.log("space/path", path, static=True)

    def _surroundings(self, head: HeadPath) -> None:
        """Points of the surroundings, and the head where no track has it."""
        points = self.rr.Points3D(head.points, colors=[SURROUNDINGS], radii=0.008)
        self._static("space/surroundings", points)
        if not self.shown.tracks:
            self._head(head.times, head.T_world_head)

    def _contacts(self, path: str, track: Track, joints: Float[Array, "T 18 3"]) -> None:
        """A mark on each foot that stands."""
        if track.standing is None:
            return
        marks = joints[:, FEET][track.standing]
        self._static(path, self.rr.Points3D.from_fields(colors=[STANDS], radii=0.03))
        self._columns(path, track.times, self.rr.Points3D.columns(
            positions=marks).partition(track.standing.sum(1).tolist()))  # fmt: skip

    def _ellipsoids(
        self, path: str, times: Float[Array, "T"], centres: Float[Array, "T 18 3"],
        covariance: Float[Array, "T 18 3 3"], turned: Float[Array, "T 1 3 3"] | None,
    ) -> None:  # fmt: skip
        if turned is not None:
            covariance = turned @ covariance @ np.swapaxes(turned, -1, -2)
        variance, axes = np.linalg.eigh(covariance)
        axes[..., 0] *= np.sign(np.linalg.det(axes))[..., None]
        quaternion = matrix_to_quaternion(axes)[..., [1, 2, 3, 0]]
        colours = [(*side_colour(label), 60) for label in LABELS]
        self._static(path, self.rr.Ellipsoids3D.from_fields(
            colors=colours, fill_mode=self.rr.components.FillMode.Solid))  # fmt: skip
        half = 2.0 * np.sqrt(np.maximum(variance, 0.0))
        self._columns(path, times, self.rr.Ellipsoids3D.columns(
            half_sizes=half.reshape(-1, 3), centers=centres.reshape(-1, 3),
            quaternions=quaternion.reshape(-1, 4),
        ).partition([len(LABELS)] * len(times)))  # fmt: skip

    def _curves(self, name: str, track: Track) -> None:
        """Angles of elbows and knees, least confidence, and the error where the truth is known."""
        for dof, angle in zip(DOFS, track.angles.T, strict=True):
            if dof.endswith(_CURVES):
                self._curve(f"angles/{name}/{dof}", track.times, np.rad2deg(angle),
                            side_colour(dof))  # fmt: skip
        if track.confidence is not None:
            self._curve(f"confidence/{name}", track.times, track.confidence.min(1))
        sequence = self.shown.sequence
        if sequence is None or not sequence.manifest.truth:
            return
        truth = sequence.truth
        if len(truth.time) == len(track.times) and np.allclose(truth.time, track.times, atol=1e-3):
            off = np.linalg.norm(track.joints_head - truth.joints_head, axis=-1)
            self._curve(f"error/{name}", track.times, 1e3 * off.mean(1))

    def _curve(
        self, path: str, times: Float[Array, "T"], values: Float[Array, "T"],
        colour: tuple[int, int, int] | None = None,
    ) -> None:  # fmt: skip
        if colour is not None:
            self._static(f"curves/{path}", self.rr.SeriesLines(colors=[colour]))
        self._columns(f"curves/{path}", times, self.rr.Scalars.columns(scalars=values))

    def _posterior(self, name: str, posterior: Posterior) -> None:
        """Draws of the pose as thin lines, and the mean."""
        draws = posterior.flat_joints
        step = max(len(draws) // DRAWS, 1)
        lines = draws[::step][:, np.array(LIMBS)].reshape(-1, 2, 3)
        colours = [(*side_colour(LABELS[b]), 50) for _, b in LIMBS] * len(draws[::step])
        self._static(
            f"space/{name}/draws", self.rr.LineStrips3D(lines, colors=colours, radii=0.001)
        )
        self._pose(f"space/{name}", np.array([posterior.time]), posterior.joint_mean[None])

    def _rig(self, rig: Rig) -> None:
        """A cone a camera, under the head."""
        for view, camera, T in zip(rig.views, rig.cameras, rig.T_head_camera, strict=True):
            angle = min(camera.max_angle, _MOST_CONE)
            turn = np.linspace(0.0, 2.0 * np.pi, 33)
            rim = _CONE_M * np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn),
                                      np.full(33, np.cos(angle))], -1)  # fmt: skip
            strips = [rim, *([[0.0, 0.0, 0.0], rim[k]] for k in range(0, 32, 8))]
            placed = [transform(T, np.asarray(strip)) for strip in strips]
            self._static(f"space/head/{view}", self.rr.LineStrips3D(
                placed, colors=[side_colour(view.rpartition("_")[2])], radii=0.001))  # fmt: skip

    def _wearer(self) -> None:
        """A standing person of 1.75 m under a rig that nothing else is shown with."""
        self._pose("space/wearer", np.zeros(1), _standing()[None], TRUTH)


def _standing() -> Float[Array, "18 3"]:
    return forward(Proportions.from_lengths(1.75), start_poses()[0])


def _jpeg(image: UInt8[Array, "H W 3"], height: int) -> bytes:
    """A picture of a camera of that height, reduced."""
    import cv2

    scale = _image_scale(height) * height / image.shape[0]
    if scale != 1.0:
        how = cv2.INTER_AREA if scale < 0.5 else cv2.INTER_LINEAR  # which is ten times as fast
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=how)
    return cv2.imencode(".jpg", image[..., ::-1], _JPEG)[1].tobytes()


def _image_scale(height: int) -> float:
    return min(1.0, IMAGE_HEIGHT / height)
