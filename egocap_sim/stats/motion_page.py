"""Draw checked motion files as stick figures on one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.side_colours import side_hex
from egocap_sim.core.bodies import BODIES, INDEX, PARENTS
from egocap_sim.motion.clips.load import LoadedMotion
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import turn

MOMENTS = 8
_WIDTH, _HEIGHT, _SCALE = 110, 190, 80.0  # pixels of a figure; pixels a metre
_VIEW = turn(yaw=np.deg2rad(-50.0))  # from the person's front left
_TIPS = {"head": (0.0, 0.0, 0.16), "l_hand": (0.0, 0.0, -0.16), "r_hand": (0.0, 0.0, -0.16)}


def render_motions(
    motions: Sequence[tuple[str, LoadedMotion]], unreadable: Sequence[tuple[str, str]]
) -> str:
    """HTML of checked files by path, the suspect first, and of files with their errors."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    template = (files("egocap_sim.stats") / "motion_page.html").read_text(encoding="utf-8")
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(template)
    order = ("suspect", "repaired", "good")
    ranked = sorted(motions, key=lambda motion: order.index(motion[1].report.verdict))
    rows = [(path, motion.report, Markup(draw_strip(motion))) for path, motion in ranked]
    counts = {v: sum(m.report.verdict == v for _, m in motions) for v in order}
    return page.render(rows=rows, counts=counts, unreadable=unreadable)


def draw_strip(motion: LoadedMotion) -> str:
    """SVG of moments of a clip: as recorded (grey), and as used (left blue, right vermilion).

    The moments are evenly spaced; the last is the one that cleaning moved most.
    """
    last = len(motion.clip.positions) - 1
    moments = list(np.linspace(0, last, MOMENTS).round().astype(int))
    clean, raw = _points(motion.clip), _points(motion.raw)
    moved = np.linalg.norm(clean - raw, axis=-1).max(1)
    if moved.max() > 0.02:
        moments.append(int(moved.argmax()))
    figures = [
        _figure(i, t / motion.clip.fps, clean[t], raw[t], motion.clip.rotations[t])
        for i, t in enumerate(moments)
    ]
    width = _WIDTH * len(moments)
    return (
        f'<svg viewBox="0 0 {width} {_HEIGHT}" width="{width}" height="{_HEIGHT}" role="img">'
        f"{''.join(figures)}</svg>"
    )


def _points(clip: Clip) -> Float[Array, "T 24 3"]:
    tips = [
        clip.positions[:, INDEX[body]] + clip.rotations[:, INDEX[body]] @ np.array(tip)
        for body, tip in _TIPS.items()
    ]
    return np.concatenate([clip.positions, np.stack(tips, 1)], 1)


def _figure(
    place: int,
    seconds: float,
    clean: Float[Array, "24 3"],
    raw: Float[Array, "24 3"],
    rotations: Float[Array, "21 3 3"],
) -> str:
    """Both figures of a moment, seen from the person's front left."""
    ahead = rotations[INDEX["pelvis"], :, 0]
    view = _VIEW @ turn(yaw=-np.arctan2(ahead[1], ahead[0]))
    centre = clean[0] - [0, 0, min(clean[0, 2], 1.0)]  # the pelvis at most 1 m up
    x = _WIDTH * (place + 0.5)
    parts = [f'<text x="{x:.0f}" y="{_HEIGHT - 3}" text-anchor="middle">{seconds:.2f} s</text>']
    for points, recorded in ((raw, True), (clean, False)):
        seen = (points - centre) @ view.T
        u, v = x + _SCALE * seen[:, 1], _HEIGHT - 18 - _SCALE * seen[:, 2]
        for a, b in _bones():
            colour = "#b9bfc6" if recorded else side_hex(_body(b))
            parts.append(
                f'<line x1="{u[a]:.1f}" y1="{v[a]:.1f}" x2="{u[b]:.1f}" y2="{v[b]:.1f}" '
                f'stroke="{colour}"/>'
            )
    return "".join(parts)


def _bones() -> list[tuple[int, int]]:
    """Point indices of both ends of every bone."""
    joints = [(parent, b) for b, parent in enumerate(PARENTS) if parent >= 0]
    return joints + [(INDEX[body], len(PARENTS) + i) for i, body in enumerate(_TIPS)]


def _body(point: int) -> str:
    return (*BODIES, *_TIPS)[point]
