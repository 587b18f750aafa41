"""Footage of two cameras as folders of pictures."""

import cv2
import pytest

from egocap.data.sequence import Sequence


@pytest.fixture(scope="module")
def footage(tiny_sequence, tmp_path_factory):
    """Pictures of a simulated sequence in two folders, and its rig file."""
    folder = tmp_path_factory.mktemp("footage")
    sequence = Sequence(tiny_sequence)
    for frame in sequence:
        for name, image in zip(sequence.rig.views, frame.images, strict=True):
            (folder / name).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / name / f"{frame.index:03d}.png"), image[..., ::-1])
    sequence.rig.to_json(folder / "rig.json")
    return folder
