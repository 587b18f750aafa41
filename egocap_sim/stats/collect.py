"""Collect statistics of sequences, with the truth of one at a time in memory."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.data.manifest import Manifest
from egocap.data.sequence import Sequence
from egocap.data.truth import VISIBLE, Truth
from egocap.geometry import GRAVITY, unit
from egocap_sim.truth.person_file import read_person

CAUSES = ("visible", "out of view", "hidden by the wearer", "hidden by others")  # by code
HEAT = (40, 50)  # rows, columns of the image position maps
REACH_M = 1.1  # half the width of the hand maps, centred on the head
HAND_BINS = 44
ANGLE_BINS = 36  # over 180 degrees
FORCE_BINS = 40
FORCE_MOST = 4.0  # body weights

_ANGLES = {  # name: three labels; the angle is at the second
    f"{side} {joint}": (f"{side}_{a}", f"{side}_{b}", f"{side}_{c}")
    for joint, (a, b, c) in {
        "elbow": ("shoulder", "elbow", "wrist"),
        "knee": ("hip", "knee", "ankle"),
        "hip": ("shoulder", "hip", "knee"),
        "arm raised": ("hip", "shoulder", "elbow"),
    }.items()
    for side in ("left", "right")
}
ANGLES = tuple(_ANGLES)


@dataclass(frozen=True)
class Row:
    """The table row of one sequence."""

    folder: str
    name: str
    frames: int
    seconds: float
    bytes: int
    seed: int
    rig: str
    place: str
    motion: str
    sensor: str


@dataclass(eq=False)
class Statistics:
    """Counts over all sequences added so far. J follows LABELS, causes follow CAUSES."""

    rows: list[Row] = field(default_factory=list)
    persons: dict[str, dict[str, Any]] = field(default_factory=dict)
    causes: dict[str, Array] = field(default_factory=dict)  # view: (J, 4)
    heat: dict[str, Array] = field(default_factory=dict)  # view: (J, *HEAT), of joints in view
    seen_by_any: Array = field(default_factory=lambda: np.zeros(len(LABELS), int))
    hands: Array = field(default_factory=lambda: np.zeros((2, 2, HAND_BINS, HAND_BINS), int))
    angles: Array = field(default_factory=lambda: np.zeros((len(ANGLES), ANGLE_BINS), int))
    moments: Array = field(default_factory=lambda: np.zeros((2, len(LABELS), 3)))  # in the head
    contact: Array = field(default_factory=lambda: np.zeros(4, int))
    stance: Array = field(default_factory=lambda: np.zeros(4, int))  # none, left, right, both
    force: Array = field(default_factory=lambda: np.zeros(FORCE_BINS, int))
    dropped: int = 0  # images

    @property
    def frames(self) -> int:
        """Stereo frames."""
        return sum(row.frames for row in self.rows)

    @property
    def total(self) -> Int[Array, "J 4"]:
        """Counts of each cause for each joint, over all views."""
        return np.sum(list(self.causes.values()), axis=0)

    @property
    def visible(self) -> Float[Array, "J"]:
        """Share of frames and views in which each joint is visible."""
        return self.total[:, VISIBLE] / self.total.sum(1)

    @property
    def spread_m(self) -> Float[Array, "J"]:
        """Standard deviation of each joint's position in the head frame, metres."""
        mean, square = self.moments / self.frames
        return np.sqrt(np.maximum(square - mean**2, 0.0).sum(1))

    def add(self, folder: Path) -> None:
        """Add the sequence in a folder. Raises FileError for a broken one."""
        recording = Sequence(folder)
        truth, manifest = recording.truth, recording.manifest
        person = read_person(recording.folder)
        self.rows.append(_row(recording, manifest))
        self.persons.setdefault(json.dumps(person, sort_keys=True), person)
        for v, mount in enumerate(recording.true_rig.mounts):
            seen = np.stack([(truth.visibility[:, v] == c).sum(0) for c in range(4)], 1)
            self.causes[mount.name] = self.causes.get(mount.name, 0) + seen
            size = mount.camera.width, mount.camera.height
            heat = _heat(truth.joints_2d[:, v], truth.in_view[:, v], size)
            self.heat[mount.name] = self.heat.get(mount.name, 0) + heat
        self.seen_by_any += (truth.visibility == VISIBLE).any(1).sum(0)
        self._add_pose(truth)
        self.contact += truth.contact.sum(0)
        left, right = truth.contact[:, :2].any(1), truth.contact[:, 2:].any(1)
        self.stance += np.bincount(left + 2 * right, minlength=4)
        if mass := person.get("mass_kg"):
            weights = truth.ground_force[..., 2].sum(1) / (mass * -GRAVITY[2])
            self.force += np.histogram(
                np.clip(weights, 0, FORCE_MOST - 1e-9), FORCE_BINS, (0, FORCE_MOST)
            )[0]
        if recording.sensor is not None:
            self.dropped += int(recording.sensor.dropped.sum())

    def _add_pose(self, truth: Truth) -> None:
        joints = truth.joints_head
        self.moments += np.stack([joints.sum(0), (joints**2).sum(0)])
        for h, hand in enumerate(("left_hand", "right_hand")):
            x, y, z = joints[:, LABEL_INDEX[hand]].T
            limits = [(-REACH_M, REACH_M)] * 2
            self.hands[h, 0] += np.histogram2d(x, y, HAND_BINS, limits)[0].astype(int)
            below = [limits[0], (-2 * REACH_M + 0.4, 0.4)]
            self.hands[h, 1] += np.histogram2d(x, z, HAND_BINS, below)[0].astype(int)
        for a, points in enumerate(_ANGLES.values()):
            bend = joint_bend(*(joints[:, LABEL_INDEX[p]] for p in points))
            if ANGLES[a].endswith("raised"):  # measured from the trunk: 0 for a hanging arm
                bend = np.pi - bend
            self.angles[a] += np.histogram(np.degrees(bend), ANGLE_BINS, (0, 180))[0]


def joint_bend(
    a: Float[Array, "T 3"], b: Float[Array, "T 3"], c: Float[Array, "T 3"]
) -> Float[Array, "T"]:
    """Angle in radians by which the path a-b-c bends at b; 0 for a straight path."""
    cosine = (unit(b - a) * unit(c - b)).sum(-1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def _heat(pixels: Array, in_view: Array, size: tuple[int, int]) -> Array:
    """Counts of each joint in each cell of the image (J, *HEAT)."""
    rows, columns = HEAT
    cell = (pixels + 0.5) / size * (columns, rows)
    heat = np.zeros((pixels.shape[1], rows * columns), int)
    for j in range(pixels.shape[1]):
        x, y = np.floor(cell[in_view[:, j], j]).astype(int).T
        at = np.clip(y, 0, rows - 1) * columns + np.clip(x, 0, columns - 1)
        heat[j] = np.bincount(at, minlength=rows * columns)
    return heat.reshape(-1, rows, columns)


def _row(recording: Sequence, manifest: Manifest) -> Row:
    config = manifest.config
    motion, clip = _table(config, "motion"), _table(_table(config, "motion"), "file")
    return Row(
        folder=str(recording.folder),
        name=manifest.name,
        frames=manifest.frames,
        seconds=manifest.frames / manifest.fps,
        bytes=sum(shard.bytes for shard in manifest.shards),
        seed=manifest.seed,
        rig=recording.rig.name,
        place=str(_table(config, "place").get("name", "")),
        motion=str(clip.get("name") or motion.get("name", "")),
        sensor=str(_table(config, "sensor").get("preset", "none")),
    )


def _table(config: dict[str, Any], key: str) -> dict[str, Any]:
    """A table of a recorded configuration; empty where it is missing or something else."""
    return found if isinstance(found := config.get(key), dict) else {}
