"""A BVH writer for tests: poses the standard figure under any rig, naming and unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap_sim.core.bodies import BODIES, INDEX, PARENTS
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip

SHARED = Path(__file__).parents[4] / "shared" / "motions"


@dataclass
class Rig:
    """How a tool writes: joint names of the bodies it has, bone frames, order, unit, up axis."""

    names: Mapping[str, str] = field(default_factory=lambda: {b: b for b in BODIES})
    frames: np.ndarray = field(default_factory=lambda: np.broadcast_to(np.eye(3), (21, 3, 3)))
    order: str = "ZXY"
    unit: float = 0.01  # metres
    up: str = "y"
    six: bool = False  # position channels on every joint


def write_bvh(path: Path, clip: Clip, rig: Rig) -> Path:
    """Write a canonical clip on the standard figure with scipy's Euler angles."""
    turn = np.eye(3) if rig.up == "z" else np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    W = turn @ clip.rotations @ rig.frames
    p = clip.positions @ turn.T / rig.unit
    rest = figure.REST / rig.unit
    parent = {}
    for b, body in enumerate(BODIES):
        up = PARENTS[b]
        while up >= 0 and BODIES[up] not in rig.names:
            up = PARENTS[up]
        parent[body] = BODIES[up] if up >= 0 else None
    lines, values = ["HIERARCHY"], []
    rotation = " ".join(f"{a}rotation" for a in rig.order)

    def write(body: str, depth: int) -> None:
        b, above = INDEX[body], parent[body]
        indent = "\t" * depth
        offset, t = np.zeros(3), p[:, b]
        R = W[:, b]
        if above is not None:
            a = INDEX[above]
            offset = rig.frames[a].T @ (rest[b] - rest[a])
            R = np.swapaxes(W[:, a], 1, 2) @ R
            t = np.broadcast_to(offset, t.shape)
        lines.append(f"{indent}{'JOINT' if above else 'ROOT'} {rig.names[body]}")
        lines.append(indent + "{")
        lines.append(f"{indent}\tOFFSET " + " ".join(f"{v:.6f}" for v in offset))
        moves = above is None or rig.six
        channels = "Xposition Yposition Zposition " if moves else ""
        lines.append(f"{indent}\tCHANNELS {6 if moves else 3} {channels}{rotation}")
        if moves:
            values.append(t)
        values.append(Rotation.from_matrix(R).as_euler(rig.order.upper(), degrees=True))
        children = [c for c in BODIES if c in rig.names and parent[c] == body]
        for child in children:
            write(child, depth + 1)
        if not children:
            lines.append(f"{indent}\tEnd Site {{ OFFSET 0 0 0 }}")
        lines.append(indent + "}")

    write("pelvis", 0)
    lines += ["MOTION", f"Frames: {len(W)}", f"Frame Time: {1 / clip.fps:.8f}"]
    lines += [" ".join(f"{v:.5f}" for v in row) for row in np.concatenate(values, 1)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def rig() -> type[Rig]:
    return Rig


@pytest.fixture
def bvh_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a clip under a rig; returns the file."""
    return lambda clip, rig=None, name="clip": write_bvh(
        tmp_path / f"{name}.bvh", clip, rig or Rig()
    )


@pytest.fixture(scope="session")
def active() -> Clip:
    """A walk with a stop and some gestures: every joint moves."""
    from egocap_sim.motion.generators.registry import make_motion

    rng = np.random.default_rng(11)
    return make_motion("sequence", 14.0, rng, 30.0, parts=("walk", "explain", "squat"))


@pytest.fixture
def shared_motions() -> Path:
    if not SHARED.is_dir():
        pytest.skip("needs the recorded motions")
    return SHARED
