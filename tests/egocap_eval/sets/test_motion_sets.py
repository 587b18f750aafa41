"""Every clip is of one set, and what must not be learned from is refused."""

import pytest

from egocap.errors import FileError, InputError
from egocap_eval.sets.motion_sets import FILE, MotionSets, motion_sets, split_clips
from egocap_eval.sets.test_log import log_look

SEEDS = {"validation": (10, 19), "test": (20, 29)}


def folder_of(tmp_path, *names):
    for name in names:
        path = tmp_path / "clips" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    return tmp_path / "clips"


def test_clips_are_split_by_subject(tmp_path):
    names = ("bvh/007_05.bvh", "more/cmu_13_01.bvh", "more/cmu_08_01.bvh", "npz/walking_42.npz")
    split = split_clips(folder_of(tmp_path, *names, "npz/walking_2.npz", "npz/jumping_1.npz"))
    assert {name: [p.name for p in paths] for name, paths in split.items()} == {
        "training": ["cmu_08_01.bvh", "walking_2.npz"],
        "validation": ["007_05.bvh", "walking_42.npz"],
        "test": ["cmu_13_01.bvh"],
    }


def test_takes_of_the_test_subject_are_not_learned_from():
    sets = motion_sets()
    assert not sets.may_train("npz/jumping_4.npz")  # the same take as cmu_13_32
    assert not sets.may_train("cmu_13_01.bvh") and not sets.may_train("007_01.bvh")
    assert sets.may_train("more/cmu_14_04.bvh") and sets.may_train("my_own.bvh")


def test_a_clip_of_several_sets_or_of_none_is_refused(tmp_path):
    both = MotionSets(training=("a*",), validation=(), test=("*b.bvh",), seeds=SEEDS)
    with pytest.raises(FileError, match=r"ab.bvh is in the sets training, test"):
        split_clips(folder_of(tmp_path, "ab.bvh"), both)
    with pytest.raises(FileError, match=f"of no set.*{FILE.name}"):
        split_clips(folder_of(tmp_path, "stranger.bvh"))
    with pytest.raises(FileError, match="no such folder"):
        split_clips(tmp_path / "absent")


def test_seeds_of_the_sets_do_not_overlap():
    with pytest.raises(ValueError, match="overlap"):
        MotionSets(training=(), validation=(), test=(), seeds=SEEDS | {"test": (19, 29)})
    sets = motion_sets()
    assert sets.seed("test", 3) - sets.seed("test", 0) == 3
    with pytest.raises(AssertionError):
        sets.seed("test", 10_000)


def test_a_look_at_the_test_set_needs_a_reason_and_a_clean_checkout(tmp_path, monkeypatch):
    from egocap_eval.sets import test_log

    log = tmp_path / "log.jsonl"
    for commit, reason, message in (
        ("a" * 40, None, "--reason"), ("a" * 40, " ", "--reason"),
        ("a" * 40 + "+changes", "release", "uncommitted"), (None, "release", "outside a checkout"),
    ):  # fmt: skip
        monkeypatch.setattr(test_log, "git_commit", lambda commit=commit: commit)
        with pytest.raises(InputError, match=message):
            log_look(reason, "w", log)
    assert not log.exists()
    monkeypatch.setattr(test_log, "git_commit", lambda: "a" * 40)
    log_look("release", "w", log)
    log_look("release", "w", log)
    assert len(log.read_text().splitlines()) == 2
