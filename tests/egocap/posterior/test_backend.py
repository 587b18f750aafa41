"""Files of chains and posteriors: what they hold is checked before it is used."""

import numpy as np
import pytest

from egocap.errors import FileError
from egocap.posterior.backend import NpzBackend
from egocap.posterior.result import load_posterior
from egocap_eval.fuzz.result_targets import FINGERPRINT, samples


@pytest.fixture
def files(tmp_path):
    return {path.stem: path for _, path, _ in samples(tmp_path)}


def test_chain_goes_on_from_its_last_step_and_random_state(files):
    again = NpzBackend(files["chain"], FINGERPRINT)
    assert again.iteration == 5 and again.get_chain().shape == (5, 6, 3)
    state = again.get_last_sample().random_state
    np.testing.assert_array_equal(state[1], np.random.RandomState(0).get_state()[1])


@pytest.mark.parametrize("name, value, message", [
    ("position", np.array([1, 2]), "key 'position'"), ("position", 625, "not a random state"),
    ("keys", np.zeros(3, np.uint32), "key 'keys'"), ("accepted", np.zeros(2), "key 'accepted'"),
    ("chain", np.full((5, 6, 3), np.nan), "not finite"), ("kind", "x", "not a chain"),
    ("fingerprint", "1" * 64, "another frame"),
])  # fmt: skip
def test_chain_of_other_content_is_refused(files, name, value, message):
    np.savez(files["chain"], **dict(np.load(files["chain"])) | {name: value})
    with pytest.raises(FileError, match=message):
        NpzBackend(files["chain"], FINGERPRINT)


@pytest.mark.parametrize("name, value, message", [
    ("draws", np.zeros((6, 5)), "key 'draws'"), ("draws", np.full((6, 5, 3), np.nan), "not finite"),
    ("names", np.array(["a"]), "1 names"), ("config", np.array("{"), "key 'config'"),
    ("schema_version", np.array([2, 2]), "another version"), ("steps", np.array("x"), "'steps'"),
    ("effective", np.full(3, np.nan), "not finite"), ("rhat", np.zeros(4), "key 'rhat'"),
])  # fmt: skip
def test_posterior_of_other_content_is_refused(files, name, value, message):
    np.savez(files["posterior"], **dict(np.load(files["posterior"])) | {name: value})
    with pytest.raises(FileError, match=message):
        load_posterior(files["posterior"])
