"""xR-EgoPose: its lens is found in its labels; poses, pixels and world come back."""

import json

import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap.datasets.xr_egopose import recordings
from egocap.errors import FileError
from tests.egocap.datasets.miniature import MIXAMO

LENS = Camera(
    "kannala_brandt", 640, 400, (327.0, 200.5), ((176.3, 0.0), (0.0, 176.4)),
    (-0.056, -0.0038, -0.00025, -0.00012), 1.5,
)  # fmt: skip
EXTRA = ("Hips", "Spine", "Spine1", "Spine2", "LeftShoulder", "RightShoulder")
FOLDER = "ValSet/male_008_a_a/env_002/cam_down"


def write(shot, folder):
    """json/NAME_000008.json and rgba/NAME.rgba.000008.png; centimetres; Maya's y is up."""
    names = [*EXTRA[:3], *MIXAMO, *EXTRA[3:]]
    labels = [MIXAMO.get(name, "neck") for name in names]
    for t in range(len(shot)):
        points = np.array([shot.joint(label, 100 * shot.camera[t, 0]) for label in labels])
        pixels = np.array([shot.joint(label, shot.pixels[t, 0]) for label in labels])
        world = np.array([shot.joint(label, 100 * shot.world[t]) for label in labels])
        world = np.stack([world[:, 0], world[:, 2], -world[:, 1]], 1)
        content = {
            "pts3d_fisheye": points.T.tolist(), "pts2d_fisheye": pixels.T.tolist(),
            "camera": {"cam_fov": 120.0, "trans": [0, 0, 0], "rot": [0, 0, 0]},
            "joints": [{"name": f"mixamorig:{n}", "trans": w.tolist(), "rot": [0, 0, 0]}
                       for n, w in zip(names, world, strict=True)],
            "action": "Gaming",
        }  # fmt: skip
        (folder / "json").mkdir(parents=True, exist_ok=True)
        (folder / f"json/male_008_a_a_{t + 8:06d}.json").write_text(json.dumps(content))
        shot.write(folder / f"rgba/male_008_a_a.rgba.{t + 8:06d}.png", t, 0)


@pytest.fixture
def shot(shoot):
    return shoot([LENS], [np.eye(4)], T=20)


def test_round_trip(shot, tmp_path, check):
    write(shot, tmp_path / FOLDER)
    (recording,) = recordings("xr-egopose", tmp_path)
    check(recording, shot, MIXAMO.values())
    assert recording.name == FOLDER and recording.category == "Gaming"
    camera = recording.rig.cameras[0]
    assert np.allclose(camera.affine, LENS.affine, atol=0.01)
    assert np.allclose(camera.centre, LENS.centre, atol=0.01)


def test_missing_and_foreign_parts_are_named(shot, tmp_path):
    folder = tmp_path / FOLDER
    write(shot, folder)
    frame = folder / "json/male_008_a_a_000010.json"
    content = json.loads(frame.read_text())
    for match, changed in [
        ("key 'pts3d_fisheye'.*another version", {"pts3d_fisheye": None}),
        (r"shape \(2, 2\)", {"pts2d_fisheye": [[1, 2], [3, 4]]}),
        ("other joints than the first", {
            "joints": [*content["joints"][1:], content["joints"][0]]}),
    ]:  # fmt: skip
        kept = {k: v for k, v in (content | changed).items() if v is not None}
        frame.write_text(json.dumps(kept))
        with pytest.raises(FileError, match=match):
            list(recordings("xr-egopose", tmp_path))
    frame.unlink()
    with pytest.raises(FileError, match="20 images in rgba, 19 files in json"):
        list(recordings("xr-egopose", tmp_path))
