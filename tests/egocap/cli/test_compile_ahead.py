"""The kernels that `egocap track` compiles ahead: once, with the types of a track."""

import subprocess
import sys

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import forward
from egocap.cli import compile_ahead
from egocap.data.sequence import open_sequence
from egocap.image_model import occlusion
from egocap.image_model.image_kernel import image_visibility
from egocap.image_model.image_rays import image_rays
from egocap.image_model.model import ImageModel


def test_the_types_are_those_of_a_track(tiny_sequence):
    compile_ahead.compile_images()
    kernels = image_visibility, occlusion._depths
    before = [list(kernel.signatures) for kernel in kernels]
    sequence = open_sequence(tiny_sequence)
    body, angles = GaussianBody.from_proportions(sequence.body), np.zeros((2, 37))
    ImageModel(body, image_rays(sequence.rig, 24, 24)).visibility(angles[0])
    occlusion.optical_depths(angles, forward(sequence.body, angles), body, sequence.rig)
    assert [list(kernel.signatures) for kernel in kernels] == before


def test_a_process_compiles_what_the_cache_has_not_and_ends_with_the_run(tmp_path, monkeypatch):
    started = []

    def start(command, **options):
        quiet = [sys.executable, "-c", "import time; time.sleep(60)"]
        started.append((command, popen(quiet, **options)))
        return started[-1][1]

    popen = subprocess.Popen
    monkeypatch.setattr(type(image_visibility), "stats", Stats(str(tmp_path)))
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", start)
    with pytest.raises(KeyError), compile_ahead.compiling_ahead():
        raise KeyError
    ((command, process),) = started
    assert command[-1] == compile_ahead.__name__
    assert process.returncode is not None and process.returncode < 0


def test_no_process_is_started_where_the_cache_has_it(monkeypatch):
    compile_ahead.compile_images()
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", None)
    with compile_ahead.compiling_ahead():
        pass


class Stats:
    def __init__(self, cache_path):
        self.cache_path = cache_path
