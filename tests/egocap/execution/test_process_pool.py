"""A pool whose workers die: when it goes on, and when it gives up."""

import multiprocessing as mp
from concurrent.futures.process import BrokenProcessPool

import pytest

from egocap.errors import MachineError
from egocap.execution import process_pool
from egocap_sim.record.jobs import Job


def run(monkeypatch, tmp_path, deaths, jobs=1) -> list[int]:
    """Do jobs; `deaths` says of each death how many frames and jobs were done before it."""
    entered, plan = [], iter(deaths)

    def pool(self, task, left, out, enter, made):
        assert not list(out.iterdir())  # what the dead worker left is gone
        for frames, finished in plan:
            made.value += frames
            for _ in range(finished):
                enter(index := next(iter(left)))
                del left[index]
            (out / ".shard-00000.tar.7.tmp").touch()
            (out / ".episode-00000.7.tmp").mkdir()
            raise BrokenProcessPool
        for index in list(left):
            enter(index)
            del left[index]

    monkeypatch.setattr(process_pool.ProcessPool, "_run_pool", pool)
    todo = [Job(i, range(3), 0) for i in range(jobs)]
    process_pool.ProcessPool(2).run(None, todo, tmp_path, entered.append)
    return entered


def test_deaths_between_which_frames_were_made_do_not_end_it(monkeypatch, tmp_path):
    assert run(monkeypatch, tmp_path, [(5, 0)] * 10, jobs=3) == [0, 1, 2]
    assert run(monkeypatch, tmp_path, [(0, 0), (0, 0), (1, 0), (0, 0)], jobs=2) == [0, 1]
    assert run(monkeypatch, tmp_path, [(9, 1)] * 30, jobs=40) == list(range(40))


@pytest.mark.parametrize("deaths", [[(0, 0)] * 3, [(0, 1), (0, 0), (0, 0)], [(7, 0)] * 20])
def test_deaths_without_progress_end_it(monkeypatch, tmp_path, deaths):
    with pytest.raises(MachineError, match="keep dying"):
        run(monkeypatch, tmp_path, deaths, jobs=5)


def test_a_parent_sees_the_frames_that_are_made(monkeypatch):
    made = mp.get_context("spawn").RawValue("Q", 0)
    monkeypatch.setattr(process_pool, "_frames", made)
    found = process_pool.count_frames(range(3, 6))
    assert next(found) == 3 and made.value == 0
    assert len(list(found)) == 2 and made.value == 3
