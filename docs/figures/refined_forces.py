"""Draw docs/images/refined-forces.png: forces on the feet of a walk, refined and simulated.

python docs/figures/refined_forces.py docs/images/refined-forces.png
"""

import sys

import numpy as np
from matplotlib.figure import Figure

from egocap.body.side_colours import side_hex
from egocap.data.head_pose import HeadPoses
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.pose.config import TrackerConfig
from egocap.track.tracker import Tracker
from egocap_eval.harness.motion_truth import draw_detections, simulate_motion
from egocap_eval.world.study import foot_forces
from egocap_sim.refinement.refine import refine

SEED, FRAMES, SHOWN = 460, 300, slice(60, 200)


def forces():
    """Times, and upward forces (T, 2) on both feet in body weights: refined and simulated."""
    walk = simulate_motion("walk", frames=FRAMES, seed=SEED,
                           parameters={"radius": 4.0, "speed": 1.2})  # fmt: skip
    heads = HeadPoses(walk.truth.T_world_head, np.ones(FRAMES, bool), 0.003)
    tracker = Tracker(walk.rig, walk.proportions, TrackerConfig(contacts=True))
    found = refine(tracker.track(draw_detections(walk, LEARNED_LIKE, SEED), None, heads))
    return walk.truth.time, *foot_forces(found, walk.truth)


def main(out):
    """Draw the figure into a file."""
    time, feet, true = forces()
    figure = Figure(figsize=(9, 3), dpi=100, layout="constrained")
    axes = figure.subplots()
    for k, side in enumerate(("left", "right")):
        colour = side_hex(side)
        axes.plot(time[SHOWN], feet[SHOWN, k], color=colour, label=f"{side} foot, refined")
        axes.plot(time[SHOWN], true[SHOWN, k], ":", color=colour, label=f"{side} foot, simulated")
    axes.set(xlabel="time [s]", ylabel="upward force [body weights]", ylim=(0, None))
    axes.legend(ncols=4, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes.margins(x=0)
    figure.savefig(out)


if __name__ == "__main__":
    main(sys.argv[1])
