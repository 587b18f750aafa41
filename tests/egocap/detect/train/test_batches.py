"""A batch depends on seed, process and step alone, not on what makes it or where a run began."""

import subprocess
import sys
from itertools import islice
from pathlib import Path

import torch

from egocap.detect.train.batches import Batches, workers_for
from egocap.detect.train.config import AugmentationConfig
from tests.egocap.detect.synthetic_store import store

ROOT = Path(__file__).parents[4]
VIEWS = store(8, 0, parts=True)


def batches(seed=3, process=0):
    return Batches(VIEWS, VIEWS, AugmentationConfig(), 4, seed, process)


def assert_in_order(workers):
    made = list(islice(batches().from_step(5, workers), 4))
    for step, batch in enumerate(made, 5):
        assert all(torch.equal(a, b) for a, b in zip(batch, batches()[step], strict=True))


def test_a_thread_makes_the_batches_of_the_steps_in_order():
    assert_in_order(0)


def test_processes_make_the_batches_of_the_steps_in_order():
    """In a process of their own: a fork after OpenGL has started, by another test, can crash."""
    code = f"from {__name__} import assert_in_order; assert_in_order(1); assert_in_order(2)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=300)


def test_other_steps_seeds_and_processes_have_other_batches():
    images = [batches()[0], batches()[1], batches(seed=4)[0], batches(process=1)[0]]
    for i, (image, _, _) in enumerate(images):
        assert not any(torch.equal(image, other) for other, _, _ in images[:i])


def test_processes_make_batches_for_a_gpu_alone(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: range(16))
    assert workers_for(torch.device("cpu"), 1) == 0
    assert workers_for(torch.device("cuda"), 1) == 15
    assert workers_for(torch.device("cuda", 3), 4) == 3
    assert workers_for(torch.device("cuda"), 16) == 1
