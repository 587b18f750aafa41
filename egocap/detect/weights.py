"""Weights files of the detector: safetensors with metadata.

The metadata hold the network's configuration, the labels, the calibration and the training record,
so that a file is self-contained. Matrices are stored in half precision.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.detect.calibration import Calibration
from egocap.detect.canonical_view import ViewSpec
from egocap.errors import FileError, InputError, MachineError, require
from egocap.files import read_bytes, write_atomically
from egocap.schema import parsed

if TYPE_CHECKING:
    from egocap.detect.network import DetectorNetwork

KIND = "egocap-detector"
SCHEMA = 1
SHIPPED = "default"  # of `egocap/detect/shipped/NAME.safetensors`
SUMS = "SHA256SUMS"  # of the shipped files, as sha256sum writes it
_EXPECTED = "detector weights written by egocap train, *.safetensors"
_LONGEST_HEADER, _MOST_BYTES = 1 << 20, 1 << 29
_MOST_LEVELS = 200  # of the metadata: a training record holds that of its initial weights


@dataclass(frozen=True, eq=False)
class Weights:
    """A weights file with a validated header; `network` reads the tensors."""

    path: Path
    sha256: str  # of the whole file
    config: Mapping[str, Any]  # `egocap.detect.network.NetworkConfig.to_dict`
    view: ViewSpec
    stride: int  # view pixels per heat-map cell
    calibration: Calibration
    training: Mapping[str, Any]  # record of the training, JSON-ready

    @property
    def name(self) -> str:
        """The network's name and the start of the file's checksum."""
        return f"{self.config['name']}-{self.sha256[:12]}"

    def network(self) -> DetectorNetwork:
        """The network with these weights, for inference. Raises FileError, or MachineError."""
        require("torch", "train")
        import torch

        from egocap.detect.network import build_network, config_from_dict

        try:
            config = config_from_dict(dict(self.config))
        except InputError as error:
            raise FileError(self.path, str(error), key="config") from None
        with torch.device("meta"):  # allocates nothing before the tensors are known to fit
            network = build_network(config)
        wanted = network.state_dict()
        state = self.tensors({name: tuple(tensor.shape) for name, tensor in wanted.items()})
        network.load_state_dict(
            {name: torch.from_numpy(v).to(wanted[name].dtype) for name, v in state.items()},
            assign=True,
        )
        return network.eval()

    def tensors(self, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
        """The tensors of a network whose tensors have these shapes. Raises FileError."""
        stored = self.stored()
        for name, shape in shapes.items():
            if name not in stored or stored[name].shape != shape:
                raise FileError(
                    self.path,
                    f"has {list(stored[name].shape)}" if name in stored else "tensor missing",
                    key=name,
                    valid=f"{list(shape)} in a '{self.config['name']}' network",
                )
            if not np.isfinite(stored[name]).all():
                raise FileError(self.path, "holds values that are not finite", key=name)
        if extra := sorted(stored.keys() - shapes.keys()):
            raise FileError(self.path, "unknown tensor", key=extra[0], valid=_EXPECTED)
        return stored

    def stored(self) -> dict[str, Array]:
        """The tensors of the file, by name. Raises FileError."""
        from safetensors import SafetensorError
        from safetensors.numpy import load_file

        try:
            return load_file(self.path)
        except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
            raise FileError(self.path, f"damaged: {error}", valid=_EXPECTED) from None


def open_weights(path: str | Path | None = None) -> Weights:
    """Read the header of a weights file; None: the shipped weights.

    Raises FileError if the file is missing, truncated, or not a weights file of this detector, or
    if the shipped weights have another checksum than the recorded one.
    """
    shipped, path = path is None, shipped_file() if path is None else Path(path)
    content = verified_content(path) if shipped else _content(path)
    metadata = _metadata(path, content)
    if _text(path, metadata, "labels") != json.dumps(LABELS):
        raise FileError(path, "has other labels", key="labels", valid=LABELS)
    optional = {"training": "{}", "calibration": "{}"} | metadata
    config, calibration, training = (
        parsed(_text(path, optional, key), path, key=key, levels=_MOST_LEVELS)
        for key in ("config", "calibration", "training")
    )
    try:
        if not (isinstance(config["name"], str) and config["name"].isprintable()):
            raise TypeError(f"name {config['name']!r:.40}")
        return Weights(
            path=path,
            sha256=hashlib.sha256(content).hexdigest(),
            config=config,
            view=ViewSpec(**config["view"]),
            stride=int(config["stride"]),
            calibration=Calibration(**calibration),
            training=training,
        )
    except (KeyError, TypeError, ValueError, OverflowError, InputError) as error:
        raise FileError(path, f"damaged metadata: {error}", key="config", valid=_EXPECTED) from None


def load_weights(path: str | Path | None = None) -> DetectorNetwork:
    """The network of a weights file, for inference; None: the shipped one. Raises FileError."""
    return open_weights(path).network()


def save_weights(
    path: str | Path,
    network: DetectorNetwork,
    training: Mapping[str, Any] | None = None,
    calibration: Calibration | None = None,
) -> None:
    """Write a network's weights, atomically.

    Args:
        path: the file, *.safetensors.
        network: trained network; matrices are rounded to half precision, vectors are kept.
        training: record of the training, JSON-ready: data, seeds, command, steps, metrics.
        calibration: fitted on footage not used in training.

    Raises:
        MachineError: the file cannot be written.
    """
    import torch
    from safetensors.torch import save

    state = {
        name: (t.half() if t.ndim > 1 and t.is_floating_point() else t).detach().cpu().contiguous()
        for name, t in network.state_dict().items()
    }
    assert all(bool(torch.isfinite(t).all()) for t in state.values()), "weights beyond half range"
    content = save(state, _header(network.config.to_dict(), training, calibration))
    write_atomically(Path(path), _in_order(content))


def with_calibration(
    weights: Weights, calibration: Calibration, training: Mapping[str, Any], path: str | Path
) -> None:
    """Write the same tensors with another calibration and training record."""
    from safetensors.numpy import save

    header = _header(weights.config, training, calibration)
    write_atomically(Path(path), _in_order(save(weights.stored(), header)))


def shipped_file(name: str = SHIPPED) -> Path:
    """Path of the shipped weights. Raises MachineError if they are not installed."""
    path = Path(str(files("egocap.detect") / "shipped" / f"{name}.safetensors"))
    if not path.is_file():
        raise MachineError(
            f"this installation has no detector weights '{name}'",
            remedy="give a file with --weights, or train one with egocap train",
        )
    return path


def verified_content(path: Path) -> bytes:
    """Content of a shipped file, of the SHA-256 that `SHA256SUMS` beside it states.

    Raises FileError.
    """
    content, sums = _content(path), _content(path.with_name(SUMS)).decode(errors="replace").split()
    expected = dict(zip(sums[1::2], sums[::2], strict=False)).get(path.name, "unknown")
    if (found := hashlib.sha256(content).hexdigest()) != expected:
        raise FileError(path, f"changed since its release: SHA-256 {found[:12]}",
                        valid=f"{expected[:12]}; install egocap again")  # fmt: skip
    return content


def _header(
    config: Mapping[str, Any], training: Mapping[str, Any] | None, calibration: Calibration | None
) -> dict[str, str]:
    return {
        "kind": KIND,
        "schema_version": str(SCHEMA),
        "config": json.dumps(config, sort_keys=True),
        "labels": json.dumps(LABELS),
        "calibration": json.dumps((calibration or Calibration()).to_dict()),
        "training": json.dumps(dict(training or {}), sort_keys=True),
    }


def _in_order(content: bytes) -> bytes:
    """Sort the keys of a safetensors header, so that equal weights give equal files."""
    (size,) = struct.unpack("<Q", content[:8])
    header = json.dumps(json.loads(content[8 : 8 + size]), sort_keys=True, separators=(",", ":"))
    text = header.encode()
    text += b" " * (-len(text) % 8)  # the tensors begin at a multiple of 8
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


def _content(path: Path) -> bytes:
    return read_bytes(path, _MOST_BYTES)


def _metadata(path: Path, content: bytes) -> dict[str, str]:
    """Metadata of the header. Raises FileError for a truncated file or another format."""
    try:
        (size,) = struct.unpack("<Q", content[:8])
        if size > min(_LONGEST_HEADER, len(content) - 8):
            raise ValueError
        header = json.loads(content[8 : 8 + size])
        metadata = header.pop("__metadata__", {})
        end = max(entry["data_offsets"][1] for entry in header.values())
    except (struct.error, ValueError, AttributeError, KeyError, TypeError, IndexError,
            RecursionError):  # fmt: skip
        raise FileError(path, "not a complete safetensors file", valid=_EXPECTED) from None
    if not isinstance(metadata, dict) or metadata.get("kind") != KIND:
        raise FileError(path, "weights of another program", key="kind", valid=_EXPECTED)
    if len(content) != 8 + size + end:
        raise FileError(
            path, f"truncated: {len(content)} of {8 + size + end} bytes", valid=_EXPECTED
        )
    version = str(metadata.get("schema_version", ""))
    if version not in map(str, range(1, SCHEMA + 1)):
        raise FileError(path, f"of schema {version[:40] or 'unknown'}", key="schema_version",
                        valid=f"up to {SCHEMA}; upgrade egocap")  # fmt: skip
    return metadata


def _text(path: Path, metadata: Mapping[str, Any], key: str) -> str:
    if not isinstance(text := metadata.get(key), str):
        raise FileError(path, "missing from the metadata", key=key, valid=_EXPECTED)
    return text
