"""A pool whose workers die: when it goes on, and when it gives up."""

import multiprocessing as mp
from concurrent.futures.process import BrokenProcessPool

import pytest

from egocap.errors import MachineError
from egocap_sim.record import workers


def run(monkeypatch, deaths, jobs=1) -> list[int]:
    """Do jobs; `deaths` says of each death how many frames and jobs were done before it."""
    left, entered, tidied, plan = dict.fromkeys(range(jobs)), [], [], iter(deaths)

    def pool(left, work, begin, count, enter, made):
        for frames, finished in plan:
            made.value += frames
            for _ in range(finished):
                enter(index := next(iter(left)))
                del left[index]
            raise BrokenProcessPool
        for index in list(left):
            enter(index)
            del left[index]

    monkeypatch.setattr(workers, "_work_in_pool", pool)
    workers.work_through(left, print, (print,), 2, entered.append, lambda: tidied.append(1))
    assert len(tidied) == len(list(deaths))
    return entered


def test_deaths_between_which_frames_were_made_do_not_end_it(monkeypatch):
    assert run(monkeypatch, [(5, 0)] * 10, jobs=3) == [0, 1, 2]
    assert run(monkeypatch, [(0, 0), (0, 0), (1, 0), (0, 0)], jobs=2) == [0, 1]
    assert run(monkeypatch, [(9, 1)] * 30, jobs=40) == list(range(40))


@pytest.mark.parametrize("deaths", [[(0, 0)] * 3, [(0, 1), (0, 0), (0, 0)], [(7, 0)] * 20])
def test_deaths_without_progress_end_it(monkeypatch, deaths):
    with pytest.raises(MachineError, match="keep dying"):
        run(monkeypatch, deaths, jobs=5)


def test_a_parent_sees_the_frames_that_are_made(monkeypatch):
    made = mp.get_context("spawn").RawValue("Q", 0)
    monkeypatch.setattr(workers, "_made", made)

    class Maker:
        def files(self, index):
            return {"json": str(index).encode()}

    found = workers.files_of(Maker(), range(3, 6))
    assert next(found) == {"json": b"3"} and made.value == 0
    assert len(list(found)) == 2 and made.value == 3
