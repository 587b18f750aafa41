"""EgoCap: full-body motion capture from head-worn fisheye cameras.

Images of a calibrated rig in; poses with their uncertainty out. The simulator is `egocap_sim`.

The public names load when they are first used; `__init__.pyi` declares them to type checkers.
"""

import os
from importlib import import_module
from typing import Any

# Idle threads must sleep, not spin: spinning threads take the core from the thread they wait for,
# and one image then took three to eight times longer. OpenMP reads this once, when torch or numba
# load it; a value set outside stays.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

__version__ = "0.1.0"

_MODULES = {
    "Camera": "cameras.camera",
    "Detections": "data.detections",
    "Detector": "detect.detector",
    "EgocapError": "errors",
    "Proportions": "body.proportions",
    "Rig": "cameras.rig",
    "OnlineTracker": "track.online",
    "PaperTracker": "paper.tracker",
    "Track": "data.track",
    "Tracker": "track.tracker",
    "TrackerConfig": "pose.config",
    "adapt": "adaptation.adapt",
    "calibrate": "calibration.rig_calibration",
    "evaluate": "evaluation.scoring",
    "evaluate_recording": "datasets.scoring",
    "fit_body": "fitting.fit_body",
    "fit_rig": "fitting.fit_rig",
    "import_footage": "footage.importing",
    "load_camera": "cameras.camera_files",
    "load_rig": "cameras.rig_files",
    "mocap": "motion_capture.capture",
    "open_dataset": "datasets.catalogue",
    "open_sequence": "data.sequence",
    "sample_posterior": "posterior.frame_posterior",
    "synthetic_detections": "detect.sources",
}
__all__ = list(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'egocap' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(f"egocap.{_MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
