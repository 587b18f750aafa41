"""Generating: the same bytes whatever the workers, and nothing lost to a kill."""

import hashlib
import os
import random
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.errors import InputError
from egocap.geometry import GRAVITY
from egocap_sim.core.part_labels import RIG, WEARER_FIRST, WEARER_LAST
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene
from egocap_sim.verification.integrity import verify


def checksums(folder: Path) -> dict[str, str]:
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir() if p.is_file()
    }


@pytest.fixture(scope="module")
def folder(tiny_sequence: Path) -> Path:
    return tiny_sequence


def test_a_sequence_is_whole_and_verified(folder):
    result = verify(folder)
    assert result.clean, result.problems
    assert (result.frames, result.shards) == (7, 4)
    assert not list(folder.glob("*.tmp"))


def test_two_workers_write_the_same_bytes(folder, tmp_path, tiny_scene):
    generate(tiny_scene, tmp_path / "two", workers=2)
    assert checksums(tmp_path / "two") == checksums(folder)


def test_another_seed_is_another_person_and_motion(folder, tmp_path, tiny_scene):
    scene = tiny_scene.model_copy(update={"seed": 9})
    generate(scene, tmp_path / "other", workers=0)
    other, first = Sequence(tmp_path / "other"), Sequence(folder)
    assert not np.allclose(other.body.offsets, first.body.offsets)
    assert not np.allclose(other.truth.joints_head, first.truth.joints_head)


def test_a_finished_sequence_is_left_as_it_is(folder, tiny_scene):
    before = checksums(folder)
    summary = generate(tiny_scene, folder)
    assert summary.rendered == 0 and checksums(folder) == before


def test_another_scene_does_not_overwrite(folder, tiny_scene):
    with pytest.raises(InputError, match="holds another sequence"):
        generate(tiny_scene.model_copy(update={"seed": 10}), folder)


def test_a_killed_run_is_completed_by_the_same_command(folder, tmp_path, tiny_scene):
    """SIGKILL at random moments, of the parent alone or with its workers: no byte differs."""
    command = [
        sys.executable, "-m", "egocap_sim", "generate", str(tmp_path / "scene.toml"),
        "--workers", "2", "--out", str(tmp_path / "killed"),
    ]  # fmt: skip
    from egocap_sim.scene.config import to_toml

    (tmp_path / "scene.toml").write_text(to_toml(tiny_scene))
    moments = random.Random(4)
    for kill in (os.kill, os.killpg):
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
        time.sleep(moments.uniform(1.5, 5.0))
        kill(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run(command, check=True, capture_output=True)
    assert checksums(tmp_path / "killed") == checksums(folder)
    assert verify(tmp_path / "killed").clean


def test_links_in_the_folder_are_not_followed(tmp_path, tiny_scene):
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.write_text("kept")
    out.mkdir()
    for name in ("truth.draft.tmp", "rig.json", ".truth.npz.1.tmp"):
        (out / name).symlink_to(victim)
    scene = tiny_scene.model_copy(update={"frames": 2, "rig": tiny_scene.rig.model_copy(
        update={"size": (80, 64)})})  # fmt: skip
    generate(scene, out, workers=1)
    assert victim.read_text() == "kept" and verify(out).clean
    assert not any(path.is_symlink() for path in out.iterdir())


def test_truth_is_physically_and_geometrically_sane(folder):
    sequence = Sequence(folder)
    truth = sequence.truth
    knees = truth.joints_world[:, [LABEL_INDEX["left_knee"], LABEL_INDEX["right_knee"]], 2]
    head = truth.joints_world[:, LABEL_INDEX["head"], 2]
    feet = truth.joints_world[:, [LABEL_INDEX["left_foot"], LABEL_INDEX["right_foot"]], 2]
    assert ((knees > 0.2) & (knees < 0.8)).all() and (head > 1.2).all() and (feet < 0.35).all()
    assert (truth.ground_force[..., 2] >= -1e-9).all() and GRAVITY[2] < 0
    assert set(np.unique(truth.visibility)) <= {0, 1, 2, 3}
    assert (truth.visibility == VISIBLE).mean() > 0.3


def test_masks_and_depth_agree_with_the_joints_that_are_seen(folder):
    """Most seen joints lie just under the wearer's own surface, at the mask's and depth's pixel.

    Not all: at this image size a pixel is 2 cm, and of a limb seen along its length the skin around
    the joint shows while its middle is deeper.
    """
    sequence = Sequence(folder)
    truth = sequence.truth
    under_own_skin = []
    for t in range(len(sequence)):
        for v, view in enumerate(sequence.manifest.views):
            mask, depth = sequence.mask(t, view), sequence.depth(t, view)
            for j in np.flatnonzero(truth.visibility[t, v] == VISIBLE):
                x, y = np.rint(truth.joints_2d[t, v, j]).astype(int)
                wearer = WEARER_FIRST <= mask[y, x] <= WEARER_LAST or mask[y, x] == RIG
                inside = np.linalg.norm(truth.joints_camera[t, v, j]) - depth[y, x] / 1000
                under_own_skin.append(wearer and -0.01 < inside < 0.25)
    assert len(under_own_skin) > 50
    assert np.mean(under_own_skin) > 0.85
    assert (truth.visibility == OUT_OF_VIEW).mean() < 0.2


def test_images_show_something(folder):
    frame = Sequence(folder).frame(3)
    for image in frame.images:
        assert image.shape == (128, 160, 3)
        assert image[0, 0].max() < 16  # outside the lens
        assert image.std() > 10


def test_a_longer_sequence_does_not_continue_with_other_bystanders(tmp_path):
    def scene(frames: int) -> Scene:
        return Scene.model_validate({
            "name": "x", "frames": frames, "fps": 5, "rig": {"size": (80, 64)},
            "motion": {"name": "idle"}, "others": {"count": 1, "behaviours": ["walk_by"]},
        })  # fmt: skip

    generate(scene(5), tmp_path, workers=0)
    before = checksums(tmp_path)
    with pytest.raises(InputError, match="bystanders or things in its beginning would differ"):
        generate(scene(20), tmp_path, workers=0, append=True)
    assert checksums(tmp_path) == before


def test_annotations_are_read_one_at_a_time(tmp_path, tiny_scene, monkeypatch):
    """They are larger than all other data that is held of a long sequence."""

    class Annotation(dict):
        __hash__, __eq__ = object.__hash__, object.__eq__

    alive: weakref.WeakSet = weakref.WeakSet()
    most = 0

    def annotation(sequence: Sequence, index: int) -> dict:
        nonlocal most
        content = Annotation(read(sequence, index))
        alive.add(content)
        most = max(most, len(alive))
        return content

    read = Sequence.annotation
    monkeypatch.setattr(Sequence, "annotation", annotation)
    generate(tiny_scene, tmp_path, workers=0)
    assert 1 <= most <= 2
