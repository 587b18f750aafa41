"""Commands answer at once: nothing heavy is imported before it is used."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEAVY = {
    "torch",
    "mujoco",
    "OpenGL",
    "numba",
    "matplotlib",
    "cv2",
    "scipy",
    "anny",
    "onnxruntime",
    "safetensors",
}
COMMANDS = {
    "egocap.cli": (
        "calibrate",
        "calibrate-detector",
        "detect",
        "doctor",
        "export",
        "live",
        "fit-body",
        "correct-rig",
        "fit-rig",
        "head-pose",
        "posterior",
        "rig",
        "track",
        "train",
        "view",
    ),
    "egocap_sim.cli": ("generate", "preview", "verify"),
    "egocap_eval.cli": (
        "pose",
        "augmentation",
        "training-set",
        "run",
        "runtime",
        "ablation",
        "compare",
        "personalised",
        "check",
        "stress",
        "crash-recovery",
        "dataset",
    ),
}


def loaded_after(code: str) -> set[str]:
    """Heavy modules in a fresh interpreter after some code has run."""
    script = f"{code}\nimport json, sys; print('\\n' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return HEAVY & set(json.loads(done.stdout.splitlines()[-1]))


def test_measure_sees_heavy_modules():
    assert "scipy" in loaded_after("import scipy.spatial")


def test_import_egocap():
    assert not loaded_after("import egocap, egocap_sim; dir(egocap); dir(egocap_sim)")


@pytest.mark.parametrize("module", COMMANDS)
def test_help(module):
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not there yet")
    calls = [["--help"], *([command, "--help"] for command in COMMANDS[module])]
    lines = (
        "import sys",
        f"from {module} import main",
        f"for words in {calls}:",
        "    sys.argv[1:] = words",
        "    assert main() == 0, words",
    )
    assert not loaded_after("\n".join(lines))


@pytest.mark.parametrize("module", COMMANDS)
def test_version(module):
    from egocap import __version__

    command = [sys.executable, "-m", module.split(".")[0], "--version"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == f"{module.split('.')[0].replace('_', '-')} {__version__}\n"
