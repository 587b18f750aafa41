"""Inference engines: OpenVINO or onnxruntime on CPUs, optionally torch on CPU or GPU.

The network is written as ONNX and cached under its weights' checksum, so that detection does not
import torch: in 8-bit integers when weights are calibrated or adapted (the shipped weights have it
beside them), in floating point at first use. The shipped graph is then filled with the weights;
only a network of another configuration is exported by torch.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.detect.onnx_graph import filled_graph, has_graph
from egocap.detect.weights import Weights, shipped_file, verified_content
from egocap.errors import EgocapError, FileError, InputError, MachineError, require
from egocap.files import cache_folder, make_folder, write_atomically

EngineName = Literal[
    "auto", "onnxruntime", "openvino", "onnxruntime-int8", "openvino-int8", "torch", "cuda"
]
"""auto: openvino if installed, else onnxruntime, in 8 bits where the weights have such a network;
onnxruntime: 32-bit floats; openvino: bfloat16 on CPUs that support it; -int8: 8-bit integers, two
to three times as fast as 32-bit floats on CPUs with VNNI instructions; torch: eager mode."""

INPUT, OUTPUTS = "images", ("heat", "info")
MOST_STREAMS = 8
"""Runs at once, where the caller does not say."""
_EXPORT = 2  # version of the export, part of the cached file's name
_OPSET = 17

log = logging.getLogger(__name__)

Outputs = tuple[Float[Array, "B 18 h w"], Float[Array, "B 18 4"]]
Run = Callable[[UInt8[Array, "B H W 3"]], Outputs]


@dataclass(frozen=True, eq=False)
class Engine:
    """A network ready to run: `run` takes images (B, H, W, 3), uint8 RGB."""

    name: str
    run: Run
    streams: int = 1  # calls of `run` at once, from threads of the caller, that fill the CPU


def open_engine(
    weights: Weights,
    name: EngineName = "auto",
    threads: int | None = None,
    spin: bool = False,
    streams: int | None = 1,
    batch: int = 1,
) -> Engine:
    """Open an inference engine.

    Args:
        weights: of the network.
        name: one of `EngineName`.
        threads: CPU threads of the network; all cores when None.
        streams: runs at once that share the threads, at most as many: one a thread, but at most
            `MOST_STREAMS`, when None; torch has one.
        batch: images a run. OpenVINO compiles the network for this number, and runs others in
            parts of it.
        spin: let onnxruntime's threads spin within a call: lower latency on an idle machine.

    Raises:
        InputError: unknown engine, number of threads or streams out of range, or no network in 8
            bits.
        FileError: the network in 8 bits is damaged.
        MachineError: the engine's package or the GPU is missing.
    """
    if name not in get_args(EngineName):
        raise InputError(f"unknown engine '{name}'", valid=get_args(EngineName))
    threads = available_cores() if threads is None else threads
    if not 1 <= threads <= 256:
        raise InputError(f"{threads} threads", valid="1 to 256")
    streams = min(threads, MOST_STREAMS) if streams is None else streams
    if not 1 <= streams <= threads:
        raise InputError(f"{streams} streams", valid=f"1 to the number of threads, {threads}")
    path = eight_bit_file(weights) if name == "auto" or name.endswith("-int8") else None
    if name == "auto":
        name = _fastest(eight_bit=path is not None)
    if name.endswith("-int8"):
        if path is None:
            raise InputError(
                f"this machine has no network in 8-bit integers of {weights.path}",
                valid="another engine; egocap calibrate-detector makes one",
            )
        return eight_bit_engine(path, name, threads, streams, batch)
    if name == "onnxruntime":
        run = _from_cache(weights, lambda path: _onnxruntime(path, threads, streams, spin=spin))
        return Engine(name, run, streams)
    if name == "openvino":
        run = _from_cache(weights, lambda path: _openvino(path, threads, streams, batch))
        return Engine(name, run, streams)
    return Engine(name, _torch(weights, "cuda" if name == "cuda" else "cpu", threads))


def fastest_engine(weights: Weights) -> EngineName:
    """The engine of `auto` in this installation."""
    return _fastest(eight_bit=eight_bit_file(weights) is not None)


def _fastest(*, eight_bit: bool) -> EngineName:
    if find_spec("openvino") is not None:
        return "openvino-int8" if eight_bit else "openvino"
    return "onnxruntime-int8" if eight_bit else "onnxruntime"


def eight_bit_file(weights: Weights) -> Path | None:
    """The file of the network in 8-bit integers, shipped or cached, if there is one.

    Raises FileError if the shipped one has changed.
    """
    if weights.path == shipped_file():
        verified_content(path := weights.path.with_suffix(".int8.onnx"))
        return path
    path = eight_bit_cache(weights)
    return path if path.is_file() else None


def eight_bit_cache(weights: Weights) -> Path:
    """Where the network in 8-bit integers of weights that are not shipped is kept."""
    return cache_folder() / f"detector-{weights.sha256[:32]}-int8.onnx"


def eight_bit_engine(
    path: Path, name: EngineName, threads: int | None = None, streams: int = 1, batch: int = 1
) -> Engine:
    """An engine of a network in 8-bit integers. Raises FileError for a damaged file."""
    threads = available_cores() if threads is None else threads
    try:
        if name == "openvino-int8":
            return Engine(name, _openvino(path, threads, streams, batch), streams)
        return Engine(name, _onnxruntime(path, threads, streams), streams)
    except EgocapError:
        raise
    except Exception as error:  # each engine has its own exceptions for a damaged file
        said = str(error).split("\n")[0]
        raise FileError(path, f"damaged: {said}",
                        valid="calibrate the detector again, or delete it") from None  # fmt: skip


def available_cores() -> int:
    """Number of CPU cores available to this process."""
    return len(os.sched_getaffinity(0))


def _from_cache(weights: Weights, start: Callable[[Path], Run]) -> Run:
    """An engine of the cached ONNX file, which is exported again where it cannot be read."""
    path = exported(weights)
    try:
        return start(path)
    except EgocapError:
        raise
    except Exception as error:  # each engine has its own exceptions for a damaged file
        log.warning("%s: exported again, as it is damaged (%s)", path, str(error).split("\n")[0])
        path.unlink(missing_ok=True)
        return start(exported(weights))


def exported(weights: Weights) -> Path:
    """Path of the cached ONNX file with free batch size, exported if missing.

    Raises FileError for damaged weights, MachineError if the cache cannot be written.
    """
    path = cache_folder() / f"detector-{weights.sha256[:32]}-{_EXPORT}.onnx"
    if path.is_file():
        return path
    content = onnx_file(weights)
    try:
        make_folder(path.parent)
        write_atomically(path, content)
    except (EgocapError, OSError) as error:
        remedy = "set XDG_CACHE_HOME to a folder with 100 MB of space"
        raise MachineError(f"cannot cache the exported network: {error}", remedy=remedy) from None
    return path


def onnx_file(weights: Weights) -> bytes:
    """The network as ONNX: uint8 images (B, H, W, 3) in, `heat` and `info` out.

    Raises FileError for damaged weights, MachineError without torch where it is needed.
    """
    if has_graph(weights):
        return filled_graph(weights)
    export_onnx(weights, file := BytesIO())
    return file.getvalue()


def export_onnx(weights: Weights, file: BytesIO, *, folded: bool = True) -> None:
    """Export the network by torch, with batch normalisation folded into the convolutions or not."""
    import warnings

    network = weights.network()
    import torch

    images = torch.zeros((2, weights.view.height, weights.view.width, 3), dtype=torch.uint8)
    mode = torch.onnx.TrainingMode
    with warnings.catch_warnings(), torch.inference_mode():
        # The tracing exporter needs no package besides onnx; it is deprecated.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network,
            (images,),
            file,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=_OPSET,
            input_names=[INPUT],
            output_names=list(OUTPUTS),
            dynamic_axes={name: {0: "B"} for name in (INPUT, *OUTPUTS)},
            training=mode.EVAL if folded else mode.PRESERVE,
            do_constant_folding=folded,
        )


def _onnxruntime(path: Path, threads: int, streams: int, *, spin: bool = False) -> Run:
    try:
        import onnxruntime
    except ImportError:
        raise MachineError("onnxruntime is missing", remedy="pip install onnxruntime") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads // streams
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", str(int(spin)))
    # Threads that spin between runs would compete with image decoding.
    options.add_session_config_entry("session.force_spinning_stop", "1")
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def run(images: Array) -> Outputs:
        heat, info = session.run(list(OUTPUTS), {INPUT: np.ascontiguousarray(images)})
        return np.asarray(heat), np.asarray(info)

    return run


_MAKING_CORE = Lock()


@cache
def _openvino_core() -> Any:
    """The process's only OpenVINO core.

    A core gives its thread a stack for signals and puts back the one before when it is freed. Of
    several cores, that one can be freed by then: the next signal, such as Ctrl-C, is a crash.
    """
    # OpenVINO's import sends usage data from a forked process, and a fork after OpenGL has started
    # can crash. Without this package it uses a stub.
    sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type]
    require("openvino", "fast")
    import openvino  # pyright: ignore[reportMissingImports] (an extra)

    # A table of types is filled at its first use: two threads at once can wait for each other.
    openvino.Type.f32.to_dtype()
    return openvino.Core()


def _openvino(path: Path, threads: int, streams: int, batch: int) -> Run:
    with _MAKING_CORE:  # `cache` alone lets two threads make one each
        core = _openvino_core()
    model = core.read_model(str(path))
    shape = model.input(INPUT).partial_shape
    shape[0] = batch  # a free batch size takes 15 % more time
    model.reshape(shape)
    options: dict[str, Any] = {
        "PERFORMANCE_HINT": "LATENCY" if streams == 1 else "THROUGHPUT",
        "NUM_STREAMS": streams, "INFERENCE_NUM_THREADS": threads,
    }  # fmt: skip
    compiled = core.compile_model(model, "CPU", options)
    requests: SimpleQueue[Any] = SimpleQueue()  # those that are free
    for _ in range(streams):
        requests.put(compiled.create_infer_request())

    def infer(images: Array) -> Outputs:
        request = requests.get()
        try:
            found = request.infer({INPUT: np.ascontiguousarray(images)})
            heat, info = (np.array(found[name], np.float32) for name in OUTPUTS)
        finally:
            requests.put(request)
        return heat, info

    def run(images: Array) -> Outputs:
        return infer(images) if len(images) == batch else _in_batches(infer, images, batch)

    return run


def _in_batches(run: Run, images: UInt8[Array, "B H W 3"], batch: int) -> Outputs:
    """Run a network on `batch` images at a time; the last ones are filled up with black."""
    filled = np.pad(images, ((0, -len(images) % batch), (0, 0), (0, 0), (0, 0)))
    parts = [run(filled[i : i + batch]) for i in range(0, len(filled), batch)]
    heat, info = (np.concatenate(part)[: len(images)] for part in zip(*parts, strict=True))
    return heat, info


def _torch(weights: Weights, device: str, threads: int) -> Run:
    require("torch", "train")
    import torch

    if device == "cuda" and not torch.cuda.is_available():
        raise MachineError("no CUDA GPU that torch can use", remedy="use the engine onnxruntime")
    network = weights.network().to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    if device == "cpu":
        torch.set_num_threads(threads)

    def run(images: Array) -> Outputs:
        with torch.inference_mode():
            heat, info = network(torch.from_numpy(np.ascontiguousarray(images)).to(device))
        return heat.cpu().numpy(), info.cpu().numpy()

    return run
