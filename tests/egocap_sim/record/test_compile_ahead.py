"""The kernel that is compiled ahead: once, with the types of a simulation."""

import subprocess
import sys
from pathlib import Path

import pytest

from egocap_sim.physics.contact_forces import contact_forces
from egocap_sim.record import compile_ahead


def test_the_types_are_those_of_a_simulation(tiny_sequence):
    before = list(contact_forces.signatures)
    compile_ahead.compile_contacts()
    assert len(contact_forces.signatures) == max(len(before), 1)


@pytest.mark.parametrize("files", [(), ("contact_forces.nonnegative-63.py311.nbi",)])
def test_a_process_compiles_what_the_cache_has_not_and_ends_with_the_run(
    tmp_path, monkeypatch, files
):
    for name in files:
        (tmp_path / name).touch()
    started = []

    def start(command, **options):
        quiet = [sys.executable, "-c", "import time; time.sleep(60)"]
        started.append((command, popen(quiet, **options)))
        return started[-1][1]

    popen = subprocess.Popen
    monkeypatch.setattr(type(contact_forces), "stats", Stats(str(tmp_path)))
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", start)
    with pytest.raises(KeyError), compile_ahead.compiling_ahead():
        raise KeyError
    ((command, process),) = started
    assert command[-1] == compile_ahead.__name__
    assert process.returncode is not None and process.returncode < 0


def test_no_process_is_started_where_the_cache_has_it(monkeypatch, tmp_path):
    compile_ahead.compile_contacts()
    assert any(Path(contact_forces.stats.cache_path).glob("*.contact_forces-*.nbi"))
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", None)
    with compile_ahead.compiling_ahead():
        pass


class Stats:
    def __init__(self, cache_path):
        self.cache_path = cache_path
