"""A function over several recordings: failures, what is done again, and executors."""

import os
from pathlib import Path

import pytest

from egocap.errors import FileError, InputError
from egocap.execution.cluster import DaskCluster
from egocap.execution.jobs import InProcess
from egocap.execution.recording_run import INDEX, run_recordings
from egocap.execution.recording_task import Report
from egocap.execution.recordings import find_recordings, list_recordings
from egocap.schema import read_json


def double(sources: tuple[str, ...], out: Path, times: int) -> Report:
    text = Path(sources[0]).read_text()
    if text == "bad":
        raise FileError(sources[0], "holds bad words")
    if text == "bug":
        raise KeyError(text)
    out.write_text(text * times)
    return Report({"letters": len(text)}, (text,), missed=text == "b")


def run(folder: Path, executor=None, command="double", times=2):
    named = [(f"{path.stem}.out", (str(path),)) for path in sorted(folder.glob("*.txt"))]
    return run_recordings(command, double, {"times": times}, list_recordings(named),
                          folder / "out", executor or InProcess())  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    for name, text in {"a": "a", "b": "bad", "c": "bug", "d": "dd"}.items():
        (tmp_path / f"{name}.txt").write_text(text)
    return tmp_path


@pytest.fixture
def executor(cluster):
    return DaskCluster(cluster)


def results(folder: Path) -> dict[str, str]:
    return {path.stem: path.read_text() for path in (folder / "out").glob("*.out")}


def test_a_failure_does_not_end_the_others(folder):
    found = run(folder)
    assert results(folder) == {"a": "aa", "d": "dddd"}
    assert found.reports["d.out"] == Report({"letters": 2}, ("dd",))
    assert found.errors == {"b.out": f"{folder / 'b.txt'}: holds bad words",
                            "c.out": "KeyError: 'bug'"}  # fmt: skip
    assert sorted(p.name for p in (folder / "out").iterdir()) == ["a.out", "d.out", INDEX]


def test_only_what_is_missing_changed_or_damaged_is_done_again(folder):
    run(folder)
    (folder / "b.txt").write_text("b")
    (folder / "c.txt").unlink()
    old = (folder / "out" / "a.out").stat().st_mtime_ns
    found = run(folder)
    assert (found.before, found.errors, found.reports["b.out"].missed) == (2, {}, True)
    assert (folder / "out" / "a.out").stat().st_mtime_ns == old
    (folder / "out" / "d.out").write_text("torn")
    (folder / "a.txt").write_text("longer")
    assert run(folder).before == 1
    assert results(folder) == {"a": "longerlonger", "b": "bb", "d": "dddd"}
    assert run(folder).before == 3


def test_results_of_other_settings_are_not_mixed(folder):
    run(folder)
    before = (folder / "out" / INDEX).read_bytes()
    with pytest.raises(FileError, match=r"recordings.json: .* with other settings"):
        run(folder, times=3)
    with pytest.raises(FileError, match="by 'double'"):
        run(folder, command="triple")
    assert (folder / "out" / INDEX).read_bytes() == before


@pytest.mark.parametrize("text", ["[1", "[]", '{"kind": "other"}', '{"command": 1}', ""])
def test_a_damaged_index_is_named(folder, text):
    run(folder)
    (folder / "out" / INDEX).write_text(text)
    with pytest.raises(FileError, match=r"recordings\.json"):
        run(folder)
    assert results(folder) == {"a": "aa", "d": "dddd"}


def test_a_file_among_the_settings_counts_by_its_content(folder):
    weights = folder / "weights"
    recordings = list_recordings([("a", (str(folder / "a.txt"),))])

    def asked(text: str) -> int:
        weights.write_text(text)
        return run_recordings("copy", copy, {"weights": weights}, recordings, folder / "out",
                              InProcess()).before  # fmt: skip

    def copy(sources, out, weights):
        out.write_bytes(weights.read_bytes())
        return Report({}, ())

    assert (asked("1"), asked("1")) == (0, 1)
    with pytest.raises(FileError, match="other settings"):
        asked("2")


def test_a_folder_among_the_settings_counts_by_its_content(folder, monkeypatch):
    monkeypatch.chdir(folder)
    recordings = list_recordings([("a", ("a.txt",))])
    (folder / "detections").mkdir()

    def note(sources, out, detections, note):
        out.write_text(note)
        return Report({}, ())

    def asked(text: str) -> int:
        (folder / "detections" / "walk.npz").write_text(text)
        settings = {"detections": folder / "detections", "note": ""}
        return run_recordings("note", note, settings, recordings, folder / "out",
                              InProcess()).before  # fmt: skip

    assert (asked("1"), asked("1")) == (0, 1)
    (folder / "d.txt").write_text("of no setting: '' is no folder")
    assert asked("1") == 1
    with pytest.raises(FileError, match="other settings"):
        asked("2")


def test_a_cluster_gives_the_same_results(folder, executor):
    found = run(folder, executor)
    assert results(folder) == {"a": "aa", "d": "dddd"} and len(found.errors) == 2
    index = read_json(folder / "out" / INDEX)
    (folder / "out" / INDEX).unlink()
    assert run(folder).reports == found.reports
    assert read_json(folder / "out" / INDEX) == index


def test_a_folder_that_a_worker_makes_is_brought_whole(folder, executor):
    def tree(sources, out):
        (out / "inner").mkdir(parents=True)
        (out / "inner" / "file").write_text("deep")
        return Report({}, ())

    recordings = list_recordings([("tree", (str(folder / "a.txt"),))])
    assert not run_recordings("tree", tree, {}, recordings, folder / "out", executor).errors
    assert (folder / "out" / "tree" / "inner" / "file").read_text() == "deep"
    assert run_recordings("tree", tree, {}, recordings, folder / "out", executor).before == 1


def test_results_are_called_like_the_sequences(tmp_path, monkeypatch):
    for name in ("walk", "data/episode-00000", "data/episode-00001", "data/.episode-00002.7.tmp"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "manifest.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    found = find_recordings(["walk", "data"], ".npz")
    assert [r.name for r in found] == ["walk.npz", "data-episode-00000.npz",
                                       "data-episode-00001.npz"]  # fmt: skip
    assert found[1].sources == (os.path.join("data", "episode-00000"),)  # noqa: PTH118
    monkeypatch.chdir("walk")
    assert find_recordings(["."], ".npz")[0].name == "walk.npz"
    with pytest.raises(InputError, match=r"two results would be called 'walk.npz'"):
        find_recordings([".", "../walk"], ".npz")
    with pytest.raises(FileError, match="no such folder"):
        find_recordings(["none"], ".npz")
    with pytest.raises(InputError, match="no recording given"):
        find_recordings([], ".npz")
