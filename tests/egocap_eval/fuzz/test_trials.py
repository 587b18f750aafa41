"""Fuzzing: mutations are reproducible, failures are noticed, and no reader of ours fails."""

import time

import numpy as np
import pytest

from egocap.errors import FileError
from egocap_eval.fuzz import trials
from egocap_eval.fuzz.mutations import mutated
from egocap_eval.fuzz.targets import Target, make_targets
from egocap_eval.fuzz.trials import fuzz

pytestmark = pytest.mark.long
CASES, DOOR_CASES = 40, 1000
DOORS = {
    "detections.npz", "sequence/shard-00000.tar", "rig.json", "rig.toml", "picture.jpg",
    "weights.safetensors", "checkpoint.pt", "clip.bvh", "tum.txt",
}  # fmt: skip
"""A format for each way in which files are parsed."""


@pytest.fixture(scope="module")
def targets(tiny_sequence, tmp_path_factory):
    return make_targets(tiny_sequence, tmp_path_factory.mktemp("fuzz"))


def test_every_reader_reads_or_refuses(targets, tmp_path):
    assert {target.name for target in targets} >= DOORS
    for target in targets:
        target.load(target.folder or target.file)
        cases = DOOR_CASES if target.name in DOORS else CASES
        counts = fuzz(target, tmp_path / target.name, range(cases))
        assert not counts.failures
        assert counts.read + counts.refused == cases


def test_mutations_are_reproducible_and_differ(targets):
    for target in targets:
        content, suffix = target.file.read_bytes(), target.file.suffix
        one, other = ([mutated(content, suffix, np.random.default_rng([seed, case]))
                       for case in range(8)] for seed in (0, 0))  # fmt: skip
        assert one == other
        assert len(set(one)) > 4


def test_failures_are_noticed_and_their_files_kept(tmp_path, monkeypatch):
    valid = tmp_path / "a.txt"
    valid.write_text("1 2 3")
    monkeypatch.setattr(trials, "LIMIT_S", 0.05)

    def load(path):
        content = path.read_bytes()
        if len(content) % 3 == 0:
            raise KeyError(len(content))
        if len(content) % 3 == 1:
            time.sleep(1.0)
        raise FileError(path, "refused")

    counts = fuzz(Target("a", valid, load), tmp_path / "work", range(20))
    found = {failure.what.split(":")[0] for failure in counts.failures}
    assert found == {"KeyError", "TimeoutError"}
    assert counts.read == 0 and 0 < counts.refused == 20 - len(counts.failures)
    assert len(list((tmp_path / "work").glob("failed-*.txt"))) == len(counts.failures)
