"""The average of two networks, against the numbers themselves."""

import pytest
import torch

from egocap.detect.network import CONFIGS, build_network
from egocap.detect.weights import open_weights, save_weights
from egocap.errors import InputError
from egocap_eval.detection.average import average


def test_parameters_are_averaged_and_the_record_names_both(tmp_path):
    torch.manual_seed(0)
    a, b, out = (tmp_path / f"{n}.safetensors" for n in "abo")
    for path, epochs in ((a, 7), (b, 1)):
        save_weights(path, build_network(CONFIGS["tiny"]), {"epochs": epochs})
    average(a, b, 0.25, out)
    made, mine, theirs = (open_weights(p).network().state_dict() for p in (out, a, b))
    for key, value in made.items():
        if value.is_floating_point():
            expected = 0.25 * mine[key] + 0.75 * theirs[key]
            torch.testing.assert_close(value, expected, rtol=2e-3, atol=1e-5)  # stored as float16
    training = open_weights(out).training
    assert training["epochs"] == 7
    assert training["averaged_with"]["sha256"] == open_weights(b).sha256
    with pytest.raises(InputError, match="share"):
        average(a, b, 1.5, out)
