"""Draw docs/images/head-frame.png: where the head frame sits in a simulated head, from two sides.

python docs/figures/head_frame.py docs/images/head-frame.png
"""

import sys

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from egocap.cameras.rig_files import load_rig
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.resources import rig_file
from egocap_sim.human.clothing.wardrobe import make_person

LIGHT = np.array([0.5, 0.4, 0.75])
AXES = (("x: forward", 0, "#d55e00"), ("y: left", 1, "#009e73"), ("z: up", 2, "#0072b2"))
BELOW, ABOVE = -0.22, 0.32  # metres of the picture below and above the head frame's origin


def triangles(person):
    """Triangles (F, 3, 3) of everything drawn, in the head frame, and their colours (F, 3)."""
    origin = person.joints[INDEX["head"]]
    corners, colours = [], []
    for mesh in person.actor.meshes:
        corners.append(mesh.vertices[mesh.faces] - origin)
        tone = mesh.texture.reshape(-1, 3).mean(0) / 255
        colours.append(np.broadcast_to(tone, (len(mesh.faces), 3)))
    corners, colours = np.concatenate(corners), np.concatenate(colours)
    near = (corners[..., 2].min(1) > BELOW) & (np.abs(corners[..., 1]).max(1) < 0.3)
    return corners[near], colours[near]


def draw(axes, corners, colours, across, title):
    """One orthographic view: `across` is the head-frame axis that runs along the page."""
    depth = 1 - across
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shade = np.clip(0.45 + 0.55 * np.abs(normals @ (LIGHT / np.linalg.norm(LIGHT))), 0, 1)
    toward = 1.0 if depth == 0 else -1.0  # from the front, or from the right side
    order = np.argsort(toward * corners[..., depth].mean(1))
    flat = np.stack([corners[..., across], corners[..., 2]], -1)[order]
    axes.add_collection(PolyCollection(flat, facecolors=(colours * shade[:, None])[order], lw=0))
    axes.plot(0, 0, "o", color="black", ms=7, zorder=5)
    axes.annotate(
        "origin: skull base, midway\nbetween the ear lobes",
        (0, 0),
        (-0.21, -0.16),
        zorder=6,
        bbox={"fc": "white", "ec": "0.6", "alpha": 0.9},
        arrowprops={"arrowstyle": "-", "color": "black"},
    )
    for name, axis, colour in AXES:
        end = {across: (0.13, 0.0), 2: (0.0, 0.16)}.get(axis)
        if end is not None:
            axes.annotate(
                "",
                end,
                (0, 0),
                zorder=5,
                arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.5},
            )
            axes.text(
                *(np.array(end) * 1.12),
                name,
                color=colour,
                weight="bold",
                zorder=6,
                ha="center",
                bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1},
            )
    axes.set_title(title)
    axes.set_aspect("equal")
    axes.set_ylim(BELOW, ABOVE)
    axes.set_ylabel("up of the skull base [m]")
    axes.grid(color="0.9")
    axes.set_axisbelow(True)


def main(path: str) -> None:
    """Draw the figure and save it."""
    person = make_person(3, sex="male", height_m=1.75, skin_tone=0.2, headgear="helmet")
    rig = load_rig(rig_file("egorig1"))
    left = rig.T_head_camera[0, :3, 3]
    corners, colours = triangles(person)
    figure = Figure(figsize=(12, 5), layout="constrained")
    side, front = figure.subplots(1, 2)
    draw(side, corners, colours, 0, "from the right")
    draw(front, corners, colours, 1, "from the front")
    side.set_xlabel("forward of the skull base [m]")
    front.set_xlabel("left of the skull base [m]")
    for axes, x in ((side, left[0]), (front, -left[1]), (front, left[1])):
        axes.plot(x, left[2], "s", color="#cc79a7", ms=10, zorder=5)
        axes.text(x, left[2] + 0.02, "camera of egorig1", ha="center", color="#8a3d6b", zorder=6)
    side.set_xlim(-0.25, 0.45)
    front.set_xlim(-0.35, 0.35)
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    main(sys.argv[1])
