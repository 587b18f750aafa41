"""egocap doctor reports the installation and what is missing in it."""

import ctypes
import json
import sys

import pytest

from egocap import cli


@pytest.fixture
def report(monkeypatch, capsys):
    def run(*words):
        monkeypatch.setattr(sys, "argv", ["egocap", "doctor", *words])
        code = cli.main()
        return code, capsys.readouterr().out

    return run


def test_a_complete_installation_has_no_problem(report, monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: None)
    code, out = report("--json")
    findings = {row["what"]: row for row in json.loads(out)}
    assert code == 0 and not any(row["problem"] for row in findings.values())
    assert findings["python"]["found"] == sys.version.split()[0]
    assert findings["detector"]["found"].endswith("ms a view")
    assert "train" in findings["extras"]["found"]


def test_missing_libraries_and_unwritable_cache_are_named(report, monkeypatch, tmp_path):
    def absent(name):
        raise OSError(name)

    monkeypatch.setattr("egocap.cli.doctor._speed", lambda: cli.doctor.Finding("detector", "-"))
    monkeypatch.setattr(ctypes, "CDLL", absent)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("os.access", lambda path, mode: False)
    code, out = report()
    assert code == 1
    assert "libEGL.so.1 and libGL.so.1 missing" in out and "! on Debian: apt-get" in out
    assert "! cannot be written; set XDG_CACHE_HOME" in out
