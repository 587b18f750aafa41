"""Recordings in episodes: whole whatever kills them, the same for any number of workers."""

import json
import logging
import shutil
from pathlib import Path

import numpy as np
import pytest

from egocap.data.dataset import find_sequences, load_dataset
from egocap.data.sequence import Sequence
from egocap.errors import FileError, InputError
from egocap.geometry import matrix_to_quaternion
from egocap_sim.core.bodies import BODIES
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.props.registry import check_prop
from egocap_sim.record.episode_plan import draw_episode, find_clips, plan_episodes
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene
from egocap_sim.verification.integrity import verify


def scene(frames: int = 7, **changes) -> Scene:
    return Scene.model_validate({
        "name": "short", "frames": frames, "seed": 400200,
        "rig": {"name": "sampled", "size": (96, 80)},
        "motion": {"name": "sequence"}, "place": {"name": "chroma"},
        "sensor": {"preset": "webcam"},
        "episodes": {"frames": (2, 2), "motions": ("gestures", "poses")},
    } | changes)  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("recording") / "r"
    generate(scene(), out, workers=2)
    return out


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_plan_has_all_frames_and_grows_without_changing():
    many = scene(50, episodes={"frames": (2, 4)})
    once, longer = plan_episodes(many, [50]), plan_episodes(many, [50, 30])
    assert sum(len(e.frames) for e in once) == 50 and sum(len(e.frames) for e in longer) == 80
    assert longer[: len(once)] == once
    assert all(2 <= len(e.frames) <= 4 for e in once[:-1])
    assert len({e.seed for e in longer}) == len(longer)


def test_every_episode_is_a_sequence_of_another_person_and_rig(recording):
    about = load_dataset(recording)
    assert about.complete and verify(recording).clean
    sequences = [Sequence(folder) for folder in find_sequences([recording])]
    assert sum(map(len, sequences)) == 7 and len(sequences) == len(about.episodes)
    assert len({json.dumps(s.true_rig.to_dict()) for s in sequences}) == len(sequences)
    people = {(s.folder / "person.json").read_bytes() for s in sequences}
    assert len(people) == len(sequences)
    assert not list(recording.glob(".*"))
    with pytest.raises(FileError, match="episode-00000"):
        Sequence(recording)


@pytest.mark.parametrize("workers", [1, 4])
def test_any_number_of_workers_makes_the_same_bytes(recording, tmp_path, workers):
    assert len(plan_episodes(scene(), [7])) == 4
    generate(scene(), tmp_path / "r", workers=workers)
    assert files(tmp_path / "r") == files(recording)


def test_what_is_lost_or_damaged_is_made_again(recording, tmp_path):
    out = tmp_path / "r"
    shutil.copytree(recording, out)
    (out / "episode-00000" / "rig.json").write_bytes(b"")  # damaged
    about = json.loads((out / "episodes.json").read_text())
    del about["episodes"][1]  # in place, but killed before it was entered
    (out / "episodes.json").write_text(json.dumps(about))
    (out / ".episode-00002.1.tmp").mkdir()
    assert any("episode-00000" in p for p in verify(out).problems)
    added: list[int] = []
    summary = generate(scene(), out, workers=0, on_frames=added.append)
    first = len(plan_episodes(scene(), [7])[0].frames)
    assert summary.rendered == first and added == [7 - first, first]
    assert files(out) == files(recording)


def test_flipped_bytes_and_foreign_names_are_found(recording, tmp_path, caplog):
    out = tmp_path / "r"
    shutil.copytree(recording, out)
    shard = out / "episode-00000" / "shard-00000.tar"
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    manifest = out / "episode-00001" / "manifest.json"
    manifest.write_bytes(manifest.read_bytes()[:-9])
    (out / "episode-00000.zip").touch()
    for name in ("episode-00000 (copy)", "episode-", "episode-one", "episode-1"):
        (out / name).mkdir()
    summary = generate(scene(), out, workers=0)
    assert summary.rendered == sum(len(job.frames) for job in plan_episodes(scene(), [7])[:2])
    assert sum("made again" in r.getMessage() for r in caplog.records) == 2
    assert {k: v for k, v in files(out).items() if k != "episode-00000.zip"} == files(recording)


def test_more_frames_need_append_and_leave_the_others(recording, tmp_path):
    out = tmp_path / "r"
    shutil.copytree(recording, out)
    with pytest.raises(InputError, match=r"7 frames, not 9.*--append"):
        generate(scene(9), out)
    before = files(out)
    assert generate(scene(9), out, append=True).rendered == 2
    after = files(out)
    assert verify(out).clean and load_dataset(out).parts == [7, 2]
    assert {k: v for k, v in after.items() if k in before and k != "episodes.json"} == {
        k: v for k, v in before.items() if k != "episodes.json"
    }
    assert generate(scene(9), out, append=True).rendered == 0
    with pytest.raises(InputError, match="differs in seed"):
        generate(scene(9, seed=1), out, append=True)


def test_clips_are_mixed_in_and_a_bad_one_is_left_out(tmp_path, caplog):
    clip = make_motion("gestures", 8.0, np.random.default_rng(0))
    np.savez(tmp_path / "good.npz", joints=np.array(BODIES), pos=clip.positions,
             quat=matrix_to_quaternion(clip.rotations), fps=clip.fps)  # fmt: skip
    (tmp_path / "bad.bvh").write_text("HIERARCHY\nnothing\n")
    with pytest.raises(FileError, match=r"bad\.bvh"):
        find_clips(tmp_path, strict=True)
    with caplog.at_level(logging.WARNING):
        clips = find_clips(tmp_path, strict=False)
    assert "bad.bvh" in caplog.text and len(clips) == 1
    mixed = scene(60, episodes={"frames": (2, 4), "clips": str(tmp_path)})
    motions = [draw_episode(mixed, e, clips).motion for e in plan_episodes(mixed, [60])]
    share = sum(m.file is not None for m in motions) / len(motions)
    assert 0.2 < share < 0.8
    assert any(m.mirrored for m in motions) and any(m.then for m in motions)


def test_props_suit_the_motion_and_leave_the_other_draws_alone():
    table = {"frames": (2, 2), "motions": ("hold", "sit", "walk", "cycle")}
    with_props, without = (
        scene(120, episodes=table | {"props": share}, others={"count": 2}) for share in (0.7, 0.0)
    )
    held = 0
    for job in plan_episodes(with_props, [120]):
        drawn, plain = draw_episode(with_props, job, ()), draw_episode(without, job, ())
        assert not plain.things
        assert drawn.model_copy(update={"things": ()}) == plain
        kinds = [thing.kind for thing in drawn.things]
        held += bool(kinds)
        for thing in drawn.things:
            check_prop(thing, drawn.motion.name)
        assert not {"bicycle"} & set(kinds) or drawn.motion.name == "cycle"
    assert 0.5 < held / 60 < 0.9


def test_a_cluster_makes_the_same_bytes(recording, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        generate(scene(), tmp_path / "r", cluster=cluster.scheduler_address)
    assert files(tmp_path / "r") == files(recording)


def test_a_sequence_is_made_longer_as_if_it_had_been_from_the_start(tmp_path):
    def plain(frames: int) -> Scene:
        data = scene(frames).model_dump(exclude_none=True, exclude={"episodes"})
        return Scene.model_validate(data | {"record": {"shard_frames": 2}})

    generate(plain(3), tmp_path / "grown")
    generate(plain(5), tmp_path / "grown", append=True)
    generate(plain(5), tmp_path / "whole")
    assert verify(tmp_path / "grown").clean
    assert files(tmp_path / "grown") == files(tmp_path / "whole")
