import json
import platform
import subprocess

import pytest

from egocap.errors import FileError, MachineError
from egocap_eval.harness.result_file import git_commit, load_result, save_result


def test_record_says_how_when_and_where(tmp_path):
    path = tmp_path / "deep" / "result.json"
    save_result(path, {"mpjpe_mm": 7.0}, "egocap-eval pose out/walk")
    record = json.loads(path.read_text())
    assert record["result"] == {"mpjpe_mm": 7.0}
    assert record["command"] == "egocap-eval pose out/walk"
    assert record["date"].endswith("+00:00")
    assert record["versions"]["python"] == platform.python_version()
    assert {"numpy", "egocap"} <= record["versions"].keys()
    assert record["machine"]["cpu"] and record["machine"]["cores"] >= 1
    assert isinstance(record["machine"]["vectors"], list)
    assert load_result(path) == record
    assert [p.name for p in path.parent.iterdir()] == ["result.json"]


def test_commit_is_the_checkouts(tmp_path):
    head = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True).stdout
    commit = git_commit()
    if commit is None:
        pytest.skip("not a checkout")
    assert commit.removesuffix("+changes") == head.strip() or len(commit) >= 40


def test_nan_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(ValueError):
        save_result(tmp_path / "result.json", {"mpjpe_mm": float("nan")}, "x")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises((FileError, MachineError), match="file"):
        save_result(tmp_path / "file" / "result.json", {}, "x")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "not JSON"),
        ("[1]", "JSON object"),
        ("{}", "not a result"),
        ('{"schema": 99, "command": "", "result": {}}', "schema"),
        ('{"schema": "1", "command": "", "result": {}}', "schema"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_other_files_are_refused(tmp_path, content, message):
    path = tmp_path / "result.json"
    path.write_text(content)
    with pytest.raises(FileError, match=message):
        load_result(path)
    with pytest.raises(FileError, match="no such file"):
        load_result(tmp_path / "absent.json")
