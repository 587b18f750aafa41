"""Footage is made once: what is finished is taken as it is, what is another scene is refused."""

import json
import shutil

import pytest

from egocap.data.manifest import MANIFEST
from egocap.errors import InputError
from egocap_eval.harness.footage import prepare_sequence


def test_finished_footage_of_another_version_is_kept(tiny_scene, tiny_sequence, tmp_path):
    folder = shutil.copytree(tiny_sequence, tmp_path / "old")
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["code_version"] = "0.0.1+old"
    (folder / MANIFEST).write_text(json.dumps(manifest))
    for workers in (1, 2):
        found = prepare_sequence(tiny_scene, folder, workers)
        assert found.manifest.code_version == "0.0.1+old" and len(found) == tiny_scene.frames


def test_another_scene_in_the_folder_is_refused(tiny_scene, tiny_sequence):
    other = tiny_scene.model_copy(update={"seed": tiny_scene.seed + 1})
    with pytest.raises(InputError, match="seed"):
        prepare_sequence(other, tiny_sequence)


def test_missing_footage_is_made_in_this_process_as_by_workers(tiny_scene, tiny_sequence, tmp_path):
    short = tiny_scene.model_copy(update={"frames": 2})
    made = prepare_sequence(short, tmp_path / "new")
    assert len(made) == 2 and made.manifest.complete
    there = prepare_sequence(tiny_scene, tiny_sequence)
    for suffix in there.files(0):
        if suffix.startswith(("left.", "right.")):
            assert made.read(0, suffix) == there.read(0, suffix), suffix
