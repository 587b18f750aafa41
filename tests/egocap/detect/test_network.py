"""The networks' shapes, their head, and what makes a configuration impossible."""

from dataclasses import replace

import pytest
import torch

from egocap.detect.canonical_view import ViewSpec
from egocap.detect.network import (
    CONFIGS,
    NetworkConfig,
    build_network,
    config_from_dict,
    config_named,
)
from egocap.errors import InputError


@pytest.fixture(scope="module")
def tiny():
    torch.manual_seed(0)
    return build_network(CONFIGS["tiny"]).eval()


def images(count: int, config: NetworkConfig) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    size = (count, config.view.height, config.view.width, 3)
    return torch.randint(0, 256, size, dtype=torch.uint8, generator=generator)


@pytest.mark.parametrize("name", ["tiny", "default"])
def test_shapes(name):
    config = CONFIGS[name]
    with torch.no_grad():
        heat, info = build_network(config).eval()(images(2, config))
    assert heat.shape == (2, 18, config.view.height // 4, config.view.width // 4)
    assert info.shape == (2, 18, 4)


def test_default_costs_what_two_cores_can_pay():
    from torch.utils.flop_counter import FlopCounterMode

    config = CONFIGS["default"]
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        build_network(config).eval()(images(1, config))
    assert counter.get_total_flops() / 2 < 1.6e9  # multiply-adds a view, in 8-bit integers
    weights = sum(p.numel() for p in build_network(config).parameters())
    assert weights * 2 < 12e6  # bytes in half precision


def test_paper_has_stride_eight_and_eighteen_maps():
    config = CONFIGS["paper"]
    assert (config.view.width, config.view.height, config.stride) == (640, 512, 8)
    small = replace(config, view=replace(config.view, width=64, height=48, focal=20.0))
    network = build_network(small)
    heat, info = network(images(2, small))
    assert heat.shape == (2, 18, 6, 8) and info.shape == (2, 18, 4)
    (heat.square().mean() + info.square().mean()).backward()
    assert all(p.grad is not None for p in network.parameters())


def test_a_view_does_not_depend_on_its_batch(tiny):
    x = images(3, tiny.config)
    with torch.no_grad():
        together, alone = tiny(x), tiny(x[1:2])
    for a, b in zip(together, alone, strict=True):
        torch.testing.assert_close(a[1:2], b, atol=1e-4, rtol=1e-4)


def test_integer_and_float_images_are_the_same(tiny):
    x = images(1, tiny.config)
    with torch.no_grad():
        torch.testing.assert_close(tiny(x)[0], tiny(x.float())[0])


def test_sigma_bias_moves_log_sigma_alone(tiny):
    x = images(1, tiny.config)
    with torch.no_grad():
        before = tiny(x)[1]
        tiny.info.log_sigma_bias += 0.5
        after = tiny(x)[1]
        tiny.info.log_sigma_bias -= 0.5
    torch.testing.assert_close(after[..., 3], before[..., 3] + 0.5)
    torch.testing.assert_close(after[..., :3], before[..., :3])


@pytest.mark.parametrize("name", CONFIGS)
def test_configurations_return_from_json(name):
    import json

    config = config_named(name)
    assert config_from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_impossible_configurations_are_refused():
    with pytest.raises(InputError, match="default, paper, small, tiny"):
        config_named("huge")
    with pytest.raises(InputError, match="multiples of 32"):
        NetworkConfig("odd", ViewSpec(width=250))
    with pytest.raises(InputError, match="as many blocks"):
        NetworkConfig("odd", blocks=(1, 1))
    with pytest.raises(InputError, match="not a network's configuration"):
        config_from_dict({"name": "x"})
