"""The picture of a rig: it is written, and the model lies where the camera projects it."""

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from egocap.body.labels import LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig_files import parse_rig
from egocap.errors import FileError, InputError
from egocap.view.rig_figure import SIDES, _side, _views, draw_rig, load_photo, pose_of

PERSON = Proportions.from_lengths(1.75)
LENS = {"model": "equidistant", "width": 320, "height": 256, "fov": 180.0}
STEREO = {"baseline": 0.35, "forward": 0.37, "up": 0.14, "pitch": 90}
RIG = parse_rig({"name": "r", "lens": LENS, "stereo": STEREO}, "r")


def test_the_model_is_where_the_camera_projects_it():
    """Left parts blue, right parts orange, at the elbows' pixels of both views."""
    joints = forward(PERSON, pose_of("sitting"))
    shown = dict(_views(RIG, PERSON))
    pixels, valid = RIG.project(joints)
    for v, view in enumerate(RIG.views):
        image = shown[f"{view}, sitting"]
        scale = image.shape[1] / RIG.cameras[v].width
        for side, channel in (("left", 2), ("right", 0)):
            j = LABEL_INDEX[f"{side}_elbow"]
            assert valid[v, j]
            column, row = np.rint((pixels[v, j] + 0.5) * scale - 0.5).astype(int)
            assert image[row, column].argmax() == channel


@pytest.mark.parametrize("title, right, up", SIDES)
def test_sides_are_seen_from_where_their_titles_say(title, right, up):
    looks = {"right": (0, 1, 0), "left": (0, -1, 0), "front": (-1, 0, 0), "above": (0, 0, -1)}[
        title.split()[-1]
    ]
    across = np.cross(looks, np.eye(3)[up])
    axes = Figure().subplots()
    _side(axes, RIG, PERSON, title, right, up)
    for mount in RIG.mounts:
        (mark,) = (line for line in axes.lines if line.get_label() == mount.name)
        place = mount.T_head_camera[:3, 3]
        np.testing.assert_allclose((mark.get_xdata()[0], mark.get_ydata()[0]),
                                   (place @ across, place[up]))  # fmt: skip


def test_a_picture_is_written_beside_a_photo(tmp_path):
    photo = np.full((256, 320, 3), 90, np.uint8)
    cv2.imwrite(str(tmp_path / "photo.png"), photo)
    out = tmp_path / "made" / "rig.png"
    found = draw_rig(RIG, out, PERSON, 5, beside=load_photo(tmp_path / "photo.png"), view="right")
    assert 0.0 < found.summary["all_views"] <= found.summary["any_view"] <= 1.0
    assert min(cv2.imread(str(out)).shape[:2]) > 800


def test_what_does_not_fit_is_refused(tmp_path):
    wide = np.zeros((100, 400, 3), np.uint8)
    with pytest.raises(InputError, match="400 x 100 in view 'left'"):
        draw_rig(RIG, tmp_path / "r.png", PERSON, 5, beside=wide)
    with pytest.raises(InputError, match="no view 'top'"):
        draw_rig(RIG, tmp_path / "r.png", PERSON, 5, view="top")
    with pytest.raises(InputError, match=r"\.png"):
        draw_rig(RIG, tmp_path / "r.jpg", PERSON, 5)
    with pytest.raises(FileError, match="no such file"):
        load_photo(tmp_path / "none.png")
