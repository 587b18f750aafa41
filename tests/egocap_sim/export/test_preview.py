"""The contact sheet shows the images, and the joints where the truth has them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.data.truth import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.errors import FileError, InputError
from egocap_sim.export.preview import contact_sheet, overlay, save_contact_sheet


@pytest.fixture
def sequence(tiny_sequence: Path) -> Sequence:
    return Sequence(tiny_sequence)


def test_a_row_a_frame_and_four_pictures_a_row(sequence):
    sheet = contact_sheet(sequence, rows=3, tile_width=160)
    assert sheet.dtype == np.uint8 and sheet.shape[1] == 4 * 160
    height = sheet.shape[0] // 3
    for row, index in enumerate((0, 3, 6)):
        left = sheet[row * height + height - 128 : (row + 1) * height, :160]
        assert np.array_equal(left, sequence.frame(index).images[0])
    assert len(contact_sheet(sequence, rows=50, tile_width=160)) == 7 * height


def test_sequences_without_part_labels_have_three_pictures(sequence, monkeypatch):
    monkeypatch.setattr(Sequence, "mask", lambda *_: None)
    assert contact_sheet(sequence, rows=1, tile_width=160).shape[1] == 3 * 160


@pytest.mark.parametrize(
    ("cause", "colour"),
    [(VISIBLE, (255, 255, 255)), (SELF_OCCLUDED, (255, 60, 60)), (OCCLUDED, (200, 60, 255))],
)
def test_rings_are_where_the_joints_are_and_tell_why_one_is_hidden(cause, colour):
    black = np.zeros((128, 160, 3), np.uint8)
    joints = np.tile([40.0, 90.0], (18, 1))
    joints[0] = 100.25, 30.5
    drawn = np.zeros(18, bool)
    drawn[0] = True
    picture = overlay(black, joints, drawn, np.full(18, cause, np.uint8))
    rows, columns = np.nonzero(picture.any(-1))
    assert (columns.mean(), rows.mean()) == pytest.approx((100.25, 30.5), abs=0.3)
    brightest = picture.reshape(-1, 3)[picture.sum(-1).argmax()].astype(float)
    assert np.allclose(brightest / brightest.max(), np.array(colour) / max(colour), atol=0.1)
    assert not black.any()  # what was given is left alone


def test_joints_out_of_view_are_not_drawn(sequence):
    truth = sequence.truth
    image = sequence.frame(0).images[0]
    nothing = overlay(image, truth.joints_2d[0, 0], np.zeros(18, bool), truth.visibility[0, 0])
    assert np.array_equal(nothing, image)
    drawn = truth.visibility[0, 0] != OUT_OF_VIEW
    assert not np.array_equal(
        overlay(image, truth.joints_2d[0, 0], drawn, truth.visibility[0, 0]), image
    )


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".PNG"])
def test_a_sheet_is_written_by_its_suffix(sequence, tmp_path, suffix):
    path = tmp_path / "new" / f"sheet{suffix}"
    save_contact_sheet([sequence.folder], path, rows=1, tile_width=160)
    assert cv2.imread(str(path)).shape[1] == 4 * 160


@pytest.mark.parametrize(
    ("name", "rows", "width"),
    [("a.gif", 1, 160), ("a", 1, 160), ("a.png", 0, 160), ("a.png", 101, 160), ("a.png", 1, 10),
     ("a.png", 1, 10**6)],
)  # fmt: skip
def test_impossible_sheets_say_what_is_possible(sequence, tmp_path, name, rows, width):
    with pytest.raises(InputError, match="valid: "):
        save_contact_sheet([sequence.folder], tmp_path / name, rows=rows, tile_width=width)
    assert not list(tmp_path.iterdir())


def test_a_folder_in_the_way_is_named(sequence, tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(FileError, match=r"a\.png: is a folder"):
        save_contact_sheet([sequence.folder], tmp_path / "a.png", rows=1, tile_width=160)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="file: is not a folder"):
        save_contact_sheet([sequence.folder], tmp_path / "file" / "b.png", rows=1, tile_width=160)
