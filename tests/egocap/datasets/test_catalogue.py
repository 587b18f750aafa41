"""Data sets by name, one sequence or many."""

import pickle

import numpy as np
import pytest

from egocap.datasets.catalogue import DATASETS, find_recording, open_dataset
from egocap.errors import FileError, InputError
from egocap.evaluation.protocol import find_protocol


@pytest.fixture
def root(tmp_path, shoot, ocam):
    shot = shoot([ocam("egowholemocap_fisheye")], [np.eye(4)], T=2)
    rows = {name: [{"img_path": f"{name}/{t}.png", "mo2cap2_local_joints": np.zeros((15, 3)) + t}
                   for t in range(2)] for name in ("dance", "walk")}  # fmt: skip
    for name in rows:
        for t in range(2):
            shot.write(tmp_path / f"{name}/{t}.png", t, 0)
    (tmp_path / "labels.pkl").write_bytes(pickle.dumps({"data_list": {"adanna": rows}}))
    return tmp_path


def test_sequences_are_found_by_name(root):
    source = f"egowholemocap:{root}"
    assert [r.name for r in open_dataset(source)] == ["adanna/dance", "adanna/walk"]
    assert find_recording(source, "adanna/walk").name == "adanna/walk"
    with pytest.raises(InputError, match=r"several sequences.*--sequence adanna/dance"):
        find_recording(source)
    with pytest.raises(InputError, match=r"no sequence 'x'.*adanna/dance, adanna/walk"):
        find_recording(source, "x")


def test_unknown_names_and_empty_folders_are_refused(tmp_path):
    for source in ("coco:/data", "unrealego", "unrealego:"):
        with pytest.raises(InputError, match="NAME:PATH with a name of egocap, unrealego"):
            open_dataset(source)
    with pytest.raises(FileError, match="holds no sequence"):
        find_recording(f"unrealego:{tmp_path}")


@pytest.mark.parametrize("name", DATASETS)
def test_every_protocol_is_one(name):
    assert find_protocol(DATASETS[name].protocol)
