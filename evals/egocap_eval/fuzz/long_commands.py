"""The long commands whose faults are studied, and the tiny inputs that they are run on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from egocap.errors import MachineError
from egocap_eval.harness.footage import builtin_scene, prepare_sequence

COMMANDS = {
    "detect": "egocap detect {in}/sequence --out o/d.npz",
    "track": "egocap track {in}/sequence --detections simulated:2 --out o/t.npz "
    "--save-detections o/d.npz",
    "fit-body": "egocap fit-body {in}/sequence --detections simulated:2 --out o/body.json",
    "fit-rig": "egocap fit-rig {in}/sequence --detections simulated:1 --out o/rig.toml "
    "--iterations 2",
    "head-pose": "egocap head-pose {in}/sequence --out o/h.npz",
    "import": "egocap import {films} --rig {in}/films/rig.json --out o/clip --copy",
    "mocap": "egocap mocap {films} --rig {in}/films/rig.json --out o/capture --height 1.75",
    "calibrate": "egocap calibrate {in}/boards/left {in}/boards/right --out o/rig.toml "
    "--board charuco:4x4:0.15:0.11 --model equidistant --page o/page.html",
    "posterior": "egocap posterior {in}/sequence --frame 2 --detections simulated:2 --walkers 4 "
    "--most-steps 500 --out o/p.npz --checkpoint o/c.npz",
    "train": "egocap train {in}/sequence --out o/run --config tiny --steps 3 --batch 2 "
    "--held-out 0 --resume",
    "adapt": "egocap adapt {in}/long --out o/adapted --height 1.75 --steps 3 --views 20",
    "export": "egocap export {in}/t.npz --out o/motion.glb",
    "suite": "egocap_eval run {in}/suite.toml --work o/suite",
}
"""Each writes into o; run again, it continues or begins anew."""

_SUITE = """name = "tiny"
[[sequences]]
name = "walk"
folder = "{folder}/sequence"
[[methods]]
name = "noisy"
detections = "simulated:2.0"
"""


def make_inputs(folder: Path, commands: tuple[str, ...]) -> Path:
    """The inputs of these commands, where they are missing."""
    scene = builtin_scene("validation-walk", (160, 128), frames=12)
    prepare_sequence(scene, folder / "sequence")
    if "adapt" in commands:  # needs 10 s
        scene = builtin_scene("validation-walk", (160, 128), frames=55, fps=5.0)
        prepare_sequence(scene, folder / "long")
    (folder / "suite.toml").write_text(_SUITE.replace("{folder}", str(folder)))
    makers = {
        "films": f"egocap_sim export {folder}/sequence --format videos --out {folder}/films",
        "boards": f"egocap_sim calibration-board --out {folder}/boards --count 12 --size 400 320 "
        "--board charuco:4x4:0.15:0.11",
        "t.npz": f"egocap track {folder}/sequence --detections simulated:2 --out {folder}/t.npz",
    }
    needed = {"films": {"import", "mocap"}, "boards": {"calibrate"}, "t.npz": {"export"}}
    for name, command in makers.items():
        if needed[name] & set(commands) and not (folder / name).exists():
            made = subprocess.run([sys.executable, "-m", *command.split()], check=False,
                                  capture_output=True, text=True)  # fmt: skip
            if made.returncode:
                raise MachineError(f"{command}: {made.stderr.strip()[-200:]}")
    return folder
