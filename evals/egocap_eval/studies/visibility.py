"""Measure the field of view that each joint requires: the paper's Figure 6 in simulation.

Five minutes of walking, gestures, head turns, squats and sitting are rendered through the rig's
left camera with a lens of 220 degrees; a narrower lens covers the angles up to half its field of
view off axis. A joint inside is `in_view`, and `seen` where the wearer does not occlude it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from tyro.conf import arg

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap_eval.harness.study import Outcome

WIDEST, NARROWEST, STEP = 220, 120, 5  # degrees
ENOUGH = 0.95
PAPER_RIGHT_WRIST = 160.0  # degrees of field of view for 95 % in the paper
TILTS = (0, 15, 30, 45, 60)  # degrees forward from the rig's own direction
PARTS = ("walk", "gestures", "look_around", "squat", "gestures", "walk", "sit", "gestures", "walk",
         "gestures")  # fmt: skip
_PIXELS = 320  # width of the rendered image
_SHOWN = ("right_wrist", "left_wrist", "right_elbow", "right_shoulder", "right_hip", "right_knee",
          "right_ankle", "head")  # fmt: skip


def study(
    rig: str = "egorig1",
    minutes: float = 5.0,
    rate: float = 10.0,
    seed: int = 400160,
    plot: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Measure how often each joint is visible, by the lens's field of view (Figure 6).

    Args:
        rig: Built-in rig, of which the left camera is used.
        minutes: Length of the recording.
        rate: Frames per second.
        seed: Seed of person and motion.
        plot: Figure of the curves to write, PNG or SVG.
    """
    if not 0.1 <= minutes <= 60.0 or not 1.0 <= rate <= 60.0:
        raise InputError(f"{minutes:g} minutes at {rate:g} frames a second",
                         valid="0.1 to 60 minutes, 1 to 60 a second")  # fmt: skip
    if plot is not None and plot.suffix not in (".png", ".svg"):
        raise InputError(f"--plot {plot}: no format for '{plot.suffix}'", valid=".png, .svg")
    joints, hidden = simulate_view(rig, max(round(60 * minutes * rate), 2), rate, seed)
    result = curves(off_axis(joints), hidden)
    result["tilted"] = tilted(joints)
    if plot is not None:
        draw(result, plot)
    return Outcome(
        result, [_table(result), _tilt_table(result)], config={"parts": PARTS, "pixels": _PIXELS}
    )


def simulate_view(
    rig: str, frames: int, rate: float, seed: int
) -> tuple[Float[Array, "T 18 3"], Bool[Array, "T 18"]]:
    """Every joint in the left camera's frame, and whether the wearer occludes it."""
    from dataclasses import replace

    from egocap.cameras.camera import Camera
    from egocap.data.truth import SELF_OCCLUDED
    from egocap.geometry import rigid
    from egocap_sim.core.bodies import INDEX
    from egocap_sim.environment.place import Light, Place
    from egocap_sim.render.renderer import FisheyeRenderer
    from egocap_sim.scene.config import MotionTable, RigTable, Scene
    from egocap_sim.truth.truth import truth_before_rendering
    from egocap_sim.truth.visibility import JointVisibility
    from egocap_sim.world.world import World

    scene = Scene(
        name="visibility", frames=frames, fps=rate, seed=seed, rig=RigTable(name=rig),
        motion=MotionTable(name="sequence", parameters={"parts": list(PARTS)}),
    )  # fmt: skip
    half = np.deg2rad(WIDEST / 2)
    focal, middle = 0.5 * _PIXELS / half, (_PIXELS - 1) / 2
    lens = Camera(
        "equidistant", _PIXELS, _PIXELS, (middle, middle), ((focal, 0.0), (0.0, focal)),
        max_angle=half,
    )  # fmt: skip
    world = World(scene)
    given, person = world.rig, world.person
    wide = replace(given, mounts=(replace(given.mounts[0], camera=lens),))
    truth = truth_before_rendering(person, world.trajectory, wide)
    grey = np.full(3, 0.5)
    light = Light(np.array([0.0, 0.0, -1.0]), grey, grey, grey, np.array([0.0, 0.0, 1.0]))
    rest = rigid(np.eye(3), -person.joints)
    judge = JointVisibility(person, wide)
    hidden = np.zeros(truth.in_view.shape[::2], bool)
    with FisheyeRenderer(wide, [person.actor], Place("nowhere", (), light, grey)) as renderer:
        for i, bodies in enumerate(truth.T_world_body):
            views = renderer.render(bodies[INDEX["head"]], {person.actor.name: bodies @ rest})
            hidden[i] = judge(views, bodies, truth.in_view[i])[0] == SELF_OCCLUDED
    return truth.joints_camera[:, 0], hidden


def off_axis(joints: Float[Array, "*n 3"], tilt_deg: float = 0.0) -> Float[Array, "*n"]:
    """Angle between joints and the optical axis [rad], with the camera tilted forward.

    The cameras of built-in rigs face down with the image's top ahead: forward is -y.
    """
    tilt = np.deg2rad(tilt_deg)
    axis = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    across = np.linalg.norm(np.cross(joints, axis), axis=-1)
    return np.arctan2(across, joints @ axis)


def tilted(joints: Float[Array, "T 18 3"]) -> dict[str, Any]:
    """Field of view that has a joint in view 95 % of the time, with the camera tilted forward."""
    found = {
        label: [round(_needed(off_axis(joints[:, LABELS.index(label)], tilt)), 1) for tilt in TILTS]
        for label in _SHOWN
    }
    return {"tilt_deg": list(TILTS), "fov_for_95_in_view": found}


def _needed(angle: Float[Array, "T"]) -> float:
    """Field of view, degrees, that contains 95 % of the angles [rad]; may be inf."""
    return float(2 * np.rad2deg(np.sort(angle)[int(np.ceil(ENOUGH * len(angle))) - 1]))


def curves(angle: Float[Array, "T 18"], hidden: Bool[Array, "T 18"]) -> dict[str, Any]:
    """Share of the frames by field of view, and the field of view for 95 %."""
    fov = np.arange(NARROWEST, WIDEST + 1, STEP)
    within = angle[None] <= np.deg2rad(fov / 2)[:, None, None]  # (F, T, J)
    in_view, seen = within.mean(1), (within & ~hidden).mean(1)
    joints = {}
    for j, label in enumerate(LABELS):
        seen_at = _needed(np.where(hidden[:, j], np.inf, angle[:, j]))
        joints[label] = {
            "in_view": in_view[:, j].round(4).tolist(),
            "seen": seen[:, j].round(4).tolist(),
            "hidden_by_wearer": round(float(hidden[:, j].mean()), 4),
            "median_angle_deg": round(float(np.rad2deg(np.median(angle[:, j]))), 1),
            "fov_for_95_in_view": round(_needed(angle[:, j]), 1),
            "fov_for_95_seen": round(seen_at, 1) if np.isfinite(seen_at) else None,
        }
    return {"frames": len(angle), "fov_deg": fov.tolist(), "joints": joints,
            "paper": {"right_wrist_fov_for_95": PAPER_RIGHT_WRIST}}  # fmt: skip


def draw(result: dict[str, Any], path: Path) -> None:
    """Draw Figure 6: left by angle alone, right less what the wearer hides."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.4), layout="constrained")
    titles = {"in_view": "within the field of view", "seen": "and not hidden by the wearer"}
    for axes, (kind, title) in zip(figure.subplots(1, 2, sharey=True), titles.items(), strict=True):
        for label in _SHOWN:
            share = 100 * np.array(result["joints"][label][kind])
            axes.plot(result["fov_deg"], share, label=label.replace("_", " "))
        axes.axhline(100 * ENOUGH, color="0.6", linewidth=0.8)
        axes.axvline(PAPER_RIGHT_WRIST, color="0.6", linewidth=0.8, linestyle=":")
        axes.set(xlabel="field of view, degrees", title=title, ylim=(0, 102))
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("share of the frames, %")
    figure.axes[0].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _table(result: dict[str, Any]) -> Table:
    fov, widths = result["fov_deg"], (120, 160, 180, 220)
    rows = []
    for label, joint in result["joints"].items():
        shares = [number(100 * joint["seen"][fov.index(w)]) for w in widths]
        needed = [number(joint[f"fov_for_95_{kind}"]) for kind in ("in_view", "seen")]
        rows.append((label, *shares, *needed, number(100 * joint["hidden_by_wearer"])))
    header = ("joint", *(f"seen at {w}, %" for w in widths), "95 % in view at", "95 % seen at",
              "hidden by wearer, %")  # fmt: skip
    title = "Visibility by field of view (degrees), left camera"
    return Table(title, header, tuple(rows))


def _tilt_table(result: dict[str, Any]) -> Table:
    tilts = result["tilted"]["tilt_deg"]
    rows = tuple(
        (label, *map(number, found))
        for label, found in result["tilted"]["fov_for_95_in_view"].items()
    )
    header = ("joint", *(f"tilted {tilt}" for tilt in tilts))
    return Table(
        "Field of view for 95 % in view, the camera tilted forward (degrees)", header, rows
    )
