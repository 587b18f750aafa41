"""Independent checks of a sequence's truth by recorded pixels, cast rays and Newton's law.

Each check returns figures; `integrity` has the thresholds. The recorder does not use this code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.sequence import Sequence
from egocap.data.truth import VISIBLE
from egocap.errors import FileError, InputError
from egocap.geometry import GRAVITY
from egocap_sim.core.bodies import BODIES, PARENTS
from egocap_sim.truth.person_file import read_person
from egocap_sim.truth.visibility import parts_around

BEFORE_M = 0.30  # largest depth of a joint behind the surface at its pixel: half a clothed chest
BEHIND_M = 0.06  # largest depth of the surface behind the joint, at the edge of a slim wrist
AROUND_M = 0.06  # radius around a joint searched for its body, as in `truth.visibility`
MOST_FRAMES = 100  # whose part labels and depth are read


@dataclass(frozen=True)
class PixelCheck:
    """Visible joints, and how many have their own body at their pixel.

    A joint is visible when a quarter of the skin around it is; its own pixel may show another body.
    """

    joints: int
    labelled: int  # of them: a part label within AROUND_M is the joint's body or a neighbour's
    measured: int  # with their body at their pixel and recorded depth
    in_depth: int  # of the measured: the surface is at most BEFORE_M before, BEHIND_M behind

    @property
    def labelled_share(self) -> float:
        """Share of the joints with their own body around their pixel; 1 without joints."""
        return self.labelled / self.joints if self.joints else 1.0

    @property
    def depth_share(self) -> float:
        """Share of the measured joints whose depth agrees; 1 without joints."""
        return self.in_depth / self.measured if self.measured else 1.0


def check_pixels(sequence: Sequence) -> PixelCheck:
    """Compare part label and depth at the pixel of every visible joint, in up to 100 frames."""
    truth, counts = sequence.truth, np.zeros(4, int)
    for index in _spread(len(sequence), MOST_FRAMES):
        for v, view in enumerate(sequence.manifest.views):
            mask = sequence.mask(index, view)
            if mask is None:
                continue
            j = np.flatnonzero(truth.visibility[index, v] == VISIBLE)
            column, row = np.rint(truth.joints_2d[index, v, j]).astype(int).T
            column, row = column.clip(0, mask.shape[1] - 1), row.clip(0, mask.shape[0] - 1)
            away = np.linalg.norm(truth.joints_camera[index, v, j], axis=-1)
            scale = np.sqrt(abs(np.linalg.det(sequence.rig.cameras[v].affine)))  # pixels a radian
            reach = np.rint(scale * AROUND_M / away).astype(int)
            counts[0] += len(j)
            counts[1] += sum(
                parts_around()[label, _window(mask, *at)].any()
                for label, *at in zip(j, column, row, reach, strict=True)
            )
            depth = sequence.depth(index, view)
            if depth is None:
                continue
            own = parts_around()[j, mask[row, column]]
            before = (away - depth[row, column] / 1000.0)[own]
            counts[2:] += own.sum(), ((before > -BEHIND_M) & (before < BEFORE_M)).sum()
    return PixelCheck(*map(int, counts))


def _window(mask: Array, column: int, row: int, reach: int) -> Array:
    """The part labels at most `reach` pixels to each side."""
    return mask[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]


@dataclass(frozen=True)
class ForceCheck:
    """The momentum balance of a whole recording, in body weights (vertical)."""

    seconds: float
    applied: float  # mean force of ground and root
    required: float  # weight plus the rate of change of momentum
    ground: float  # mean force of the ground alone
    error: float  # standard error of `applied`, which is sampled at the frames


def check_forces(sequence: Sequence) -> ForceCheck | None:
    """Compare mean vertical force with weight and momentum; None for less than two seconds.

    The velocity of the centre of mass comes from differences of the bodies' positions, with each
    body's mass at the middle of its bone. The simulation's mass model is not used.
    """
    truth, fps = sequence.truth, sequence.manifest.fps
    seconds = (len(truth.time) - 1) / fps
    if seconds < 2.0:
        return None
    mass = _mass_kg(sequence)
    weight = mass * float(np.linalg.norm(GRAVITY))
    speed = np.diff(_mass_centre(truth.T_world_body)[:, 2]) * fps
    # Each force but the first and the last represents a whole frame interval.
    gained = mass * (speed[-1] - speed[0]) / (seconds - 1.0 / fps)
    ground = truth.ground_force[1:-1, :, 2].sum(1) / weight
    push = ground + truth.root_wrench[1:-1, 2] / weight
    error = float(push.std() / np.sqrt(len(push)))
    return ForceCheck(
        seconds, float(push.mean()), float(1.0 + gained / weight), float(ground.mean()), error
    )


@dataclass(frozen=True)
class RayCheck:
    """Agreement of the recorded visibility with rays cast in MuJoCo."""

    joints: int  # in view, over the tested frames and views
    agree: int  # visible in both, or in neither
    borderline: int  # others with a visible share within BORDER of the threshold
    disagreements: dict[str, int]  # by label: the remaining ones

    @property
    def share(self) -> float:
        """Share of joints that agree; 1 without joints."""
        return self.agree / self.joints if self.joints else 1.0

    def text(self) -> str:
        """The result in one line."""
        left = ", ".join(f"{label} {n}" for label, n in self.disagreements.items()) or "none"
        return (
            f"rays agree on {100 * self.share:.1f} % of {self.joints} joints in view; "
            f"of the others {self.borderline} are half hidden, the rest: {left}"
        )


def check_rays(
    sequence: Sequence, frames: int = 10, on_frames: Callable[[int], None] = lambda count: None
) -> RayCheck:
    """Recompute visibility by rays, in frames spread over the sequence.

    `on_frames` is called with 1 after each. Rebuilds the world from scene.toml. Raises InputError
    for a sensor whose images are not of one instant, since the poses between frames are not stored.
    """
    from egocap_sim.scene.config import load_scene
    from egocap_sim.truth.raycast import BORDER, RayVisibility, Surfaces
    from egocap_sim.truth.visibility import SHARE
    from egocap_sim.world.take import Take
    from egocap_sim.world.world import World

    truth, scene = sequence.truth, load_scene(sequence.folder / "scene.toml")
    if scene.sensor is not None and scene.sensor.timed:
        raise InputError(
            f"{sequence.folder}: the ray check requires images of one instant",
            valid="a sequence without shutter_s, readout_s and time_offset_s",
        )
    world = World(scene, Take(truth, None))
    actors = [world.person.actor, *(a.actor for a in world.actors)]
    by_rays = RayVisibility(world.person, world.rig, Surfaces(actors, world.place.meshes))
    joints = agree = borderline = 0
    left: dict[str, int] = {}
    for index in _spread(len(sequence), frames):
        in_view, recorded = truth.in_view[index], truth.visibility[index]
        found, share = by_rays.at(truth.T_world_body[index], world.skinning(index), in_view)
        alike = (found == VISIBLE) == (recorded == VISIBLE)
        joints, agree = joints + int(in_view.sum()), agree + int((alike & in_view).sum())
        near = np.abs(share - SHARE) < BORDER
        borderline += int((in_view & ~alike & near).sum())
        for j in np.nonzero(in_view & ~alike & ~near)[1]:
            left[LABELS[j]] = left.get(LABELS[j], 0) + 1
        on_frames(1)
    return RayCheck(joints, agree, borderline, left)


def _spread(count: int, most: int) -> Iterable[int]:
    """Up to `most` of `count` frames, evenly spread."""
    return map(int, np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)))


def _mass_kg(sequence: Sequence) -> float:
    person = read_person(sequence.folder)
    if "mass_kg" not in person:
        raise FileError(sequence.folder / "person.json", "missing", key="mass_kg")
    return person["mass_kg"]


_SHARE = {
    "pelvis": 0.142, "spine": 0.139, "chest": 0.216, "neck": 0.016, "head": 0.065,
    "clavicle": 0.0, "upperarm": 0.028, "forearm": 0.016, "hand": 0.006,
    "thigh": 0.100, "calf": 0.0465, "foot": 0.0115, "toe": 0.003,
}  # fmt: skip
"""Share of the body mass. Source: D. Winter, Biomechanics and Motor Control of Human Movement,
table 4.1, which the simulated person does not use."""


def _mass_centre(T_world_body: Float[Array, "T 21 4 4"]) -> Float[Array, "T 3"]:
    """Centre of mass, metres, with each body's mass half way to its first child."""
    p = T_world_body[..., :3, 3]
    total, mass = np.zeros((len(p), 3)), 0.0
    for b, body in enumerate(BODIES):
        after = [k for k, parent in enumerate(PARENTS) if parent == b]
        end = p[:, after[0]] if after else p[:, b]
        share = _SHARE[body.split("_")[-1]]
        total, mass = total + share * (p[:, b] + end) / 2, mass + share
    return total / mass
