"""Weights survive the disk, and no damaged or foreign file is taken for them."""

import contextlib
import json
import resource
import shutil
import struct
import subprocess

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file

from egocap.detect.calibration import Calibration
from egocap.detect.canonical_view import ViewSpec
from egocap.detect.engine import eight_bit_file
from egocap.detect.network import CONFIGS, build_network
from egocap.detect.onnx_graph import filled_graph
from egocap.detect.weights import (
    SUMS,
    load_weights,
    open_weights,
    save_weights,
    shipped_file,
    with_calibration,
)
from egocap.errors import FileError, MachineError


def header(path):
    content = path.read_bytes()
    (size,) = struct.unpack("<Q", content[:8])
    return json.loads(content[8 : 8 + size])["__metadata__"]


def rewritten(source, path, tensors=None, **metadata):
    """The file with metadata replaced, or removed where None, and tensors changed by a function."""
    kept = {k: v for k, v in (header(source) | metadata).items() if v is not None}
    state = load_file(source)
    save_file(tensors(state) if tensors else state, path, kept)
    return path


def test_weights_survive_in_half_precision(tmp_path):
    torch.manual_seed(0)
    network = build_network(CONFIGS["tiny"]).eval()
    path = tmp_path / "w.safetensors"
    calibration = Calibration(1.5, -0.25, log_sigma_seen=0.1)
    save_weights(path, network, {"steps": 7}, calibration)
    assert [p.name for p in tmp_path.iterdir()] == ["w.safetensors"]
    opened = open_weights(path)
    assert opened.calibration == calibration
    assert opened.training == {"steps": 7}
    assert opened.view == CONFIGS["tiny"].view and opened.stride == CONFIGS["tiny"].stride
    for name, tensor in load_weights(path).state_dict().items():
        wanted = network.state_dict()[name]
        assert tensor.dtype == wanted.dtype
        assert torch.allclose(tensor, wanted, rtol=1e-3, atol=1e-6), name
        if wanted.ndim <= 1:
            assert torch.equal(tensor, wanted), name


def test_loaded_networks_say_nearly_the_same(tiny_file):
    torch.manual_seed(3)
    network = build_network(CONFIGS["tiny"]).eval()
    images = torch.randint(0, 256, (2, 64, 64, 3), dtype=torch.uint8)
    with torch.no_grad():
        pairs = zip(network(images), load_weights(tiny_file)(images), strict=True)
        for before, after in pairs:
            assert torch.allclose(before, after, atol=0.02)


def test_names_follow_the_content(tiny_file, tmp_path):
    first = open_weights(tiny_file)
    with_calibration(first, Calibration(2.0), {"again": True}, tmp_path / "b.safetensors")
    second = open_weights(tmp_path / "b.safetensors")
    assert first.name != second.name and second.name.startswith("tiny-")
    assert second.calibration.scale == 2.0 and second.training == {"again": True}
    a, b = first.network().state_dict(), second.network().state_dict()
    assert all(torch.equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "llama"}, "another program"),
        ({"kind": None}, "another program"),
        ({"schema_version": "2"}, "schema 2.*up to 1"),
        ({"schema_version": "x"}, "schema x"),
        ({"labels": '["nose"]'}, "other labels.*left_wrist"),
        ({"labels": None}, "missing.*labels|labels.*missing"),
        ({"config": "{"}, "config.*not JSON"),
        ({"config": "{}"}, "config"),
        ({"config": json.dumps(CONFIGS["tiny"].to_dict() | {"view": {"width": 1}})}, "view"),
        ({"calibration": '{"scale": 99.0}'}, "calibration with scale 99"),
        ({"calibration": '{"what": 1}'}, "what"),
        ({"calibration": "[]"}, "key 'calibration': holds a list"),
        ({"training": "[1]"}, "key 'training': holds a list"),
        ({"training": '"text"'}, "key 'training': holds a str"),
        ({"training": "[" * 100_000}, "key 'training': JSON nested too deeply"),
        ({"training": '{"a":' * 300 + "1" + "}" * 300}, "deeper than 200 levels"),
        ({"config": json.dumps(CONFIGS["tiny"].to_dict() | {"name": 3})}, "name 3"),
        ({"config": json.dumps(CONFIGS["tiny"].to_dict() | {"name": "\x1b[31m"})}, "name"),
    ],
)
def test_foreign_metadata_is_refused(tiny_file, tmp_path, change, says):
    with pytest.raises(FileError, match=says):
        open_weights(rewritten(tiny_file, tmp_path / "w.safetensors", **change))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"blocks": [0, 10**9, 1, 1]}, "'blocks' .*1 to 8 numbers, 0 to 64"),
        ({"blocks": [0, -1, 1, 1]}, "'blocks' .*0 to 64"),
        ({"blocks": [0, 1.5, 1, 1]}, "'blocks' .*0 to 64"),
        ({"widths": [8, 16, 10**9, 24]}, "'widths' .*1 to 1024"),
        ({"widths": [1024] * 4, "blocks": [64] * 4}, "valid: .* in a 'tiny' network"),
        ({"widths": [8] * 100_000}, "'widths' .*1 to 8 numbers"),
        ({"widths": "8"}, "'widths' '?8"),
        ({"decoder": [16, 0]}, "'decoder' .*1 to 1024"),
        ({"stride": 8}, "'stride' 8 .*pyramid of 4"),
        ({"stride": float("inf")}, "config"),
        ({"kind": "vit"}, "'kind' 'vit'.*resnet101 of 8"),
        ({"name": "x" * 10_000}, "'name' .*80 characters"),
        ({"view": {"width": 10**9}}, "8 to 2048"),
        ({"view": {"width": 64.0}}, "8 to 2048"),
        ({"view": {"pitch_deg": float("nan")}}, "not finite"),
    ],
)
def test_configurations_beyond_the_limits_are_refused(tiny_file, tmp_path, change, says):
    config = json.dumps(CONFIGS["tiny"].to_dict() | change)
    path = rewritten(tiny_file, tmp_path / "w.safetensors", config=config)
    open_weights(tiny_file).network()  # imports what a network needs
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileError, match=says) as raised:
        open_weights(path).network()
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 500
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


@pytest.mark.parametrize("version", [2, [1], None, {"a": 1}, "9" * 5000, ""])
def test_schema_versions_of_any_type_are_refused(tiny_file, tmp_path, version):
    """safetensors writes strings only; a damaged header may hold anything."""
    content = tiny_file.read_bytes()
    (size,) = struct.unpack("<Q", content[:8])
    head = json.loads(content[8 : 8 + size])
    head["__metadata__"]["schema_version"] = version
    text = json.dumps(head).encode()
    path = tmp_path / "w.safetensors"
    path.write_bytes(struct.pack("<Q", len(text)) + text + content[8 + size :])
    with pytest.raises(FileError, match="schema_version") as raised:
        open_weights(path)
    assert len(str(raised.value).replace(str(path), "")) < 300


def test_tensors_must_fit_the_network(tiny_file, tmp_path):
    def without(state):
        return {k: v for k, v in state.items() if k != "heat.weight"}

    def narrow(state):
        return state | {"heat.weight": state["heat.weight"][:5].clone()}

    def infinite(state):
        return state | {"heat.bias": torch.full((18,), float("inf"))}

    def more(state):
        return state | {"extra": torch.zeros(1)}

    for change, says in (
        (without, "'heat.weight'.*missing"), (narrow, r"'heat.weight'.*has \[5.*valid: \[18"),
        (infinite, "'heat.bias'.*finite"), (more, "'extra'.*unknown"),
    ):  # fmt: skip
        path = rewritten(tiny_file, tmp_path / "w.safetensors", tensors=change)
        with pytest.raises(FileError, match=says):
            open_weights(path).network()


def test_other_files_are_refused(tiny_file, tmp_path):
    path = tmp_path / "w.safetensors"
    save_file({"a": torch.zeros(3)}, path)
    with pytest.raises(FileError, match="another program"):
        open_weights(path)
    path.write_bytes(tiny_file.read_bytes()[:-10])
    with pytest.raises(FileError, match=r"truncated: .* bytes"):
        open_weights(path)
    for content in (b"", b"hello", np.zeros(100, np.uint8).tobytes()):
        path.write_bytes(content)
        with pytest.raises(FileError, match="safetensors"):
            open_weights(path)
    with pytest.raises(FileError, match="no such file"):
        open_weights(tmp_path / "none.safetensors")
    with pytest.raises(FileError, match="folder"):
        open_weights(tmp_path)


@settings(deadline=None, max_examples=40)
@given(cut=st.floats(0, 1), place=st.floats(0, 0.999), bits=st.integers(0, 255))
def test_any_damage_is_a_file_error_or_harmless(tmp_path_factory, tiny_file, cut, place, bits):
    data = bytearray(tiny_file.read_bytes())
    data[int(place * 3000)] ^= bits  # the header, mostly
    path = tmp_path_factory.mktemp("damage") / "w.safetensors"
    path.write_bytes(bytes(data[: int(cut * len(data))] if cut < 0.9 else data))
    with contextlib.suppress(FileError):
        open_weights(path).network()


def test_shipped_files_are_compared_with_their_checksums(tmp_path, monkeypatch):
    folder = tmp_path / "shipped"
    shutil.copytree(shipped_file().parent, folder)
    weights = open_weights()
    sums = subprocess.run(["sha256sum", "--check", SUMS], cwd=folder, capture_output=True)
    assert sums.returncode == 0 and sums.stdout.count(b": OK") == 3
    monkeypatch.setattr("egocap.detect.weights.files", lambda _: tmp_path)
    assert open_weights().sha256 == weights.sha256
    loads = {".onnx": lambda: filled_graph(weights), ".safetensors": open_weights,
             ".int8.onnx": lambda: eight_bit_file(open_weights())}  # fmt: skip
    for suffix, load in loads.items():
        path = folder / f"default{suffix}"
        content = bytearray(path.read_bytes())
        content[-1] ^= 1  # the last bit of a tensor, or of a name
        path.write_bytes(content)
        with pytest.raises(FileError, match=f"default{suffix}: changed since its release"):
            load()
        content[-1] ^= 1
        path.write_bytes(content)
    open_weights()
    (folder / SUMS).unlink()
    with pytest.raises(FileError, match=f"{SUMS}: no such file"):
        open_weights()


def test_unwritable_place_is_a_machine_error(tmp_path):
    with pytest.raises(MachineError, match="cannot write"):
        save_weights(tmp_path / "no" / "w.safetensors", build_network(CONFIGS["tiny"]))


def test_view_is_read_without_the_network(tiny_file):
    assert isinstance(open_weights(tiny_file).view, ViewSpec)
