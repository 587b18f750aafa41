"""A person and a rig at which posteriors are quick."""

from pathlib import Path

import pytest

from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def person():
    return Proportions.from_lengths(1.75)


@pytest.fixture(scope="session")
def rig():
    return load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(640, 512)
