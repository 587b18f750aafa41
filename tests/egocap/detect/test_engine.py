"""Every engine says what torch says."""

import importlib.util
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.detect import engine as engines
from egocap.detect.detector import Detector
from egocap.detect.engine import eight_bit_cache, exported, fastest_engine, open_engine
from egocap.detect.heatmaps import decode
from egocap.detect.input_images import recorded_pictures
from egocap.detect.weights import open_weights
from egocap.errors import FileError, InputError, MachineError

needs_openvino = pytest.mark.skipif(
    importlib.util.find_spec("openvino") is None, reason="openvino is an extra"
)


def in_fresh_process(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def weights(tiny_file):
    return open_weights(tiny_file)


def images(count):
    return np.random.default_rng(5).integers(0, 256, (count, 64, 64, 3), dtype=np.uint8)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_onnxruntime_equals_torch(weights, count):
    said = open_engine(weights, "onnxruntime", threads=1).run(images(count))
    expected = open_engine(weights, "torch", threads=1).run(images(count))
    for a, b, shape in zip(said, expected, ((count, 18, 16, 16), (count, 18, 4)), strict=True):
        assert a.shape == b.shape == shape
        assert a.dtype == b.dtype == np.float32
        assert np.abs(a - b).max() < 1e-4 * max(1.0, np.abs(b).max())


def test_spinning_changes_nothing_but_the_time(weights):
    quiet, busy = (
        open_engine(weights, "onnxruntime", threads=2, spin=spin).run(images(2))
        for spin in (False, True)
    )
    assert all(np.array_equal(a, b) for a, b in zip(quiet, busy, strict=True))


@needs_openvino
@pytest.mark.parametrize("count", [1, 2, 5])
def test_openvino_is_close_to_torch(weights, count):
    """Also for numbers of images that it is not compiled for."""
    said = open_engine(weights, "openvino", threads=1, batch=2).run(images(count))
    expected = open_engine(weights, "torch", threads=1).run(images(count))
    for a, b in zip(said, expected, strict=True):
        assert a.shape == b.shape
        assert np.abs(a - b).max() < 0.03 * max(1.0, np.abs(b).max())  # bfloat16


@pytest.mark.parametrize(("threads", "streams"), [(0, 1), (257, 1), (2, 0), (2, 3)])
def test_numbers_out_of_range_are_refused(weights, threads, streams):
    with pytest.raises(InputError, match="1 to"):
        open_engine(weights, "onnxruntime", threads, streams=streams)


@needs_openvino
def test_a_signal_after_several_engines_is_no_crash():
    """Engines opened first are freed first, in a fresh process, which a failure would end."""
    code = """
import signal
from egocap.detect.engine import open_engine
from egocap.detect.weights import open_weights
weights = open_weights()
engines = [open_engine(weights, "openvino-int8", threads=1) for _ in range(3)]
while engines:
    del engines[0]
signal.signal(signal.SIGTERM, lambda *_: print("handled"))
signal.raise_signal(signal.SIGTERM)
"""
    done = in_fresh_process(code)
    assert (done.returncode, done.stdout) == (0, "handled\n"), done.stderr


def test_engines_of_several_threads_share_a_core(monkeypatch):
    made, together = [], Barrier(2)

    class Core:
        def __init__(self):
            made.append(self)
            time.sleep(0.05)  # the other thread asks meanwhile

        def read_model(self, path):
            raise KeyError(path)

    def engine():
        together.wait()
        with pytest.raises(KeyError):
            engines._openvino(Path("none"), threads=1, streams=1, batch=1)

    monkeypatch.setattr(engines, "_openvino_core", cache(Core))
    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(engine) for _ in range(2)]:
            done.result()
    assert len(made) == 1


@needs_openvino
def test_openvino_sends_no_usage_data(tiny_file):
    """In a fresh process, since the package reports when it is imported."""
    code = f"""
import os, sys
os.fork = lambda: sys.exit("forked")
from egocap.detect.engine import open_engine
from egocap.detect.heatmaps import decode
from egocap.detect.input_images import recorded_pictures
from egocap.detect.weights import open_weights
open_engine(open_weights({str(tiny_file)!r}), "openvino", threads=1)
assert "openvino" in sys.modules and sys.modules["openvino_telemetry"] is None
assert "openvino.tools.ovc.telemetry_stub" in sys.modules
"""
    done = in_fresh_process(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("found", "engine"), [(object(), "openvino"), (None, "onnxruntime")], ids=["with", "without"]
)
def test_auto_takes_openvino_where_it_is_and_8_bits_where_they_are(
    monkeypatch, weights, rounded, found, engine
):
    monkeypatch.setattr(engines, "find_spec", lambda name: found)
    assert fastest_engine(weights) == engine
    assert fastest_engine(rounded) == f"{engine}-int8"


def test_auto_says_which_engine_it_took(weights):
    assert open_engine(weights, threads=1).name == fastest_engine(weights)


@pytest.fixture
def rounded(weights, tmp_path):
    """Weights that differ in a bit, and have a network in 8 bits."""
    pytest.importorskip("onnx")
    from egocap.detect.train.quantise import eight_bit_graph, keep_eight_bit

    content = bytearray(weights.path.read_bytes())
    content[-2] ^= 1
    (tmp_path / "w.safetensors").write_bytes(bytes(content))
    others = open_weights(tmp_path / "w.safetensors")
    keep_eight_bit(others, eight_bit_graph(others, images(16)))
    return others


@pytest.mark.parametrize("engine", ["onnxruntime-int8", "openvino-int8"])
def test_8_bits_are_close_to_floats(rounded, engine):
    pytest.importorskip(engine.removesuffix("-int8"))
    said = open_engine(rounded, engine, threads=1).run(images(3))
    for a, b in zip(said, open_engine(rounded, "torch", threads=1).run(images(3)), strict=True):
        assert 0.0 < np.abs(a - b).max() < 0.1 * np.abs(b).max()


def test_weights_without_8_bits_say_how_to_get_them(weights):
    with pytest.raises(InputError, match=r"no network in 8-bit .*calibrate-detector"):
        open_engine(weights, "onnxruntime-int8")


@pytest.mark.parametrize("engine", ["onnxruntime-int8", "openvino-int8"])
def test_damaged_8_bits_are_named(rounded, engine):
    pytest.importorskip(engine.removesuffix("-int8"))
    path = eight_bit_cache(rounded)
    path.write_bytes(path.read_bytes()[:-99])
    with pytest.raises(FileError, match=r"int8\.onnx: damaged"):
        open_engine(rounded, engine)


def test_exported_once(weights, monkeypatch):
    path = exported(weights)
    monkeypatch.setattr(engines, "export_onnx", lambda *_: pytest.fail("exported again"))
    assert exported(weights) == path
    assert weights.sha256[:32] in path.name
    assert not [p for p in path.parent.iterdir() if p.name.endswith(".tmp")]


@pytest.mark.parametrize("engine", ["onnxruntime", "openvino"])
def test_a_damaged_cache_is_exported_again(weights, engine, monkeypatch, tmp_path, caplog):
    pytest.importorskip(engine)
    monkeypatch.setattr(engines, "cache_folder", lambda: tmp_path)
    wanted = open_engine(weights, engine, threads=1).run(images(1))
    path = exported(weights)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = open_engine(weights, engine, threads=1).run(images(1))
    assert "exported again" in caplog.text
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, other)


def test_cache_that_cannot_be_written_says_so(weights, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(engines, "cache_folder", lambda: tmp_path / "file" / "egocap")
    with pytest.raises(MachineError, match="XDG_CACHE_HOME"):
        exported(weights)


def test_impossible_wishes(weights):
    with pytest.raises(
        InputError,
        match="auto, onnxruntime, openvino, onnxruntime-int8, openvino-int8, torch, cuda",
    ):
        open_engine(weights, "tflite")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="0 threads"):
        open_engine(weights, threads=0)


def test_shipped_8_bits_find_the_joints_where_floats_do(tiny_sequence):
    """In pictures, within a fifth of a pixel of the canonical view: rounding hides nothing."""
    sequence, weights = Sequence(tiny_sequence), open_weights()
    pictures = [recorded_pictures(sequence, i) for i in range(len(sequence))]
    found = []
    for engine in ("onnxruntime", "onnxruntime-int8"):
        detector = Detector(sequence.rig, weights, engine, threads=1)
        heat, info = detector.run(detector.canonical(pictures)[0])
        found.append((decode(heat, weights.stride).points, info))
    (points, info), (rounded, others) = found
    sure = np.exp(info[..., 3]) < 6.0
    off = np.linalg.norm(points - rounded, axis=-1)[sure]
    assert sure.mean() > 0.5 and 0.0 < np.median(off) < 0.2 and np.percentile(off, 95) < 1.0
    assert np.abs(info - others)[..., 3][sure].mean() < 0.1
