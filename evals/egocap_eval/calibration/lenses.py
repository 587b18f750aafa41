"""The lenses of the calibration study, 1280 x 1024: four of known kinds, and a measured one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import polar

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import load_camera
from egocap.cameras.rig import Mount, Rig
from egocap.cameras.rig_files import load_rig
from egocap.geometry import rigid
from egocap_sim.core.resources import rig_file

SIZE = (1280, 1024)
_FIELD = np.deg2rad(95.0)


def study_lenses(measured: Path | None) -> dict[str, Camera]:
    """The lenses by name; the measured one where its file exists."""
    kannala = ("kannala_brandt", *SIZE)
    lenses = {
        "equidistant": Camera("equidistant", *SIZE, (639.5, 511.5), ((407.4, 0), (0, 407.4)), (),
                              np.pi / 2),
        "stereographic": Camera(*kannala, (646.0, 505.0), ((330.0, 0.0), (0.0, 331.0)),
                                (0.083, 0.008, 0.001, 0.0001), _FIELD),
        "equisolid": Camera(*kannala, (630.0, 520.0), ((430.0, 0.0), (0.0, 429.0)),
                            (-0.0417, 0.00052, -3.1e-6, 0.0), _FIELD),
        "scaramuzza": Camera("ocam", *SIZE, (642.0, 517.0), ((1.0, 3e-4), (3e-4, 0.9992)),
                             (-380.0, 0.0, 8e-4, -6e-7, 9e-10), _FIELD),
    }  # fmt: skip
    if measured is not None and measured.exists():
        lenses["measured"] = load_camera(measured)
    return lenses


def stereo_rig(name: str, camera: Camera) -> Rig:
    """The helmet rig with this lens on both sides; the right one is assembled less exactly."""
    helmet = load_rig(rig_file("egorig1"))
    centre = (camera.centre[0] - 5.0, camera.centre[1] + 3.0)
    other = replace(camera, centre=centre)
    left, right = helmet.T_head_camera
    return Rig(name, (Mount("left", camera, left), Mount("right", other, right)))


def with_symmetric_affine(mount: Mount) -> Mount:
    """The same camera in the frame that a calibration uses.

    An affine matrix A = S Q turns the image by Q about the optical axis; so does a turn of the
    camera. The calibrated matrix is symmetric (`egocap.calibration.lens_shape`): Q is in the pose.
    """
    Q, S = polar(np.array(mount.camera.affine), side="left")
    turn = np.eye(3)
    turn[:2, :2] = Q.T
    camera = replace(mount.camera, affine=tuple(map(tuple, S.tolist())))
    return replace(
        mount, camera=camera, T_head_camera=mount.T_head_camera @ rigid(turn, np.zeros(3))
    )
