"""Plain arrays of a track, in the frame they say."""

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.data.track import write_arrays
from egocap.errors import MachineError
from tests.egocap.data.test_bvh import made


@pytest.mark.parametrize("world", [False, True])
def test_arrays_are_those_of_the_track(tmp_path, world):
    track = made(world=world)
    write_arrays(tmp_path / "a.npz", track)
    with np.load(tmp_path / "a.npz") as found:
        assert str(found["frame"]) == ("world" if world else "head")
        assert np.array_equal(found["joints"], track.joints_world if world else track.joints_head)
        assert tuple(found["joint_names"]) == LABELS
        assert found["angles"].shape == (12, 37) == (12, len(found["angle_names"]))


def test_nowhere_to_write(tmp_path):
    with pytest.raises(MachineError):
        write_arrays(tmp_path / "no" / "a.npz", made())
