"""More formats under test: what runs leave behind and read again, data sets, copies of stores.

Each function writes valid files below a folder and returns what reads them, as in `targets`.
"""

from __future__ import annotations

import io
import json
import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from functools import partial
from pathlib import Path
from typing import Any

from egocap.data.sequence import Sequence
from egocap.data.sequence_writer import digest

Parts = tuple[Any, ...]
"""Name, file, reader, and the folder that is copied with the file, if any."""


def training(sequence: Sequence, work: Path) -> list[Parts]:
    """Canonical views, records and weights of a run of training."""
    import torch

    from egocap.detect.network import build_network, config_named
    from egocap.detect.train.checkpoint import FINAL, save_checkpoint, save_run_weights
    from egocap.detect.train.config import RunConfig, TrainingConfig
    from egocap.detect.train.examples import sequence_views
    from egocap.detect.train.run import prepare_run
    from egocap.detect.weights import open_weights, save_weights
    from egocap.detect.weights_card import card

    config = config_named("tiny")
    network, store, run = build_network(config), work / "views", work / "training"
    store.mkdir(exist_ok=True)
    sequence_views(sequence.folder, config.view, store)
    (labels,) = store.glob("*/labels.npz")
    if not run.exists():
        run.mkdir()
        save_run_weights(run, network, None)
        save_checkpoint(run, network, network, torch.optim.AdamW(network.parameters()), {"step": 1})
        options = TrainingConfig()
        content = {"network": config.to_dict(), "seed": options.seed, "batch": options.batch}
        (run / "run.json").write_text(json.dumps(content))
    described = work / "described.safetensors"
    first = {"command": "egocap train a", "steps": 3, "seconds": 2.0, "scores": {"pck": 1.0}}
    start = {"name": "tiny", "sha256": "0", "training": first}
    save_weights(described, network, first | {"start": start, "averaged_with": start})

    def resume(folder: Path) -> None:
        prepare_run(RunConfig(folder, (work,), "tiny", resume=True), TrainingConfig())

    def begin(folder: Path, name: str) -> None:
        out = folder / "new"
        shutil.rmtree(out, ignore_errors=True)
        prepare_run(RunConfig(out, (work,), "tiny", start=folder / name), TrainingConfig())

    latest = "checkpoint.pt"
    read_views = partial(_views, sequence.folder, config.view)
    return [
        ("views/labels.npz", labels, read_views, store),
        ("views/images.npy", labels.with_name("images.npy"), read_views, store),
        ("training/run.json", run / "run.json", resume, run),
        ("training/final.safetensors", run / FINAL, partial(begin, name=FINAL), run),
        ("training/checkpoint.pt", run / latest, partial(begin, name=latest), run),
        ("described.safetensors", described, lambda path: card(open_weights(path))),
    ]  # fmt: skip


def _views(sequence: Path, spec: Any, store: Path) -> None:
    from egocap.detect.train.examples import sequence_views

    views = sequence_views(sequence, spec, store)
    assert views.images.shape == (len(views), spec.height, spec.width, 3)


def results(work: Path) -> list[Parts]:
    """A detector's errors, results of studies and their registry."""
    from egocap.posterior.detector_error import SHIPPED, load_detector_error
    from egocap_eval.evidence.registry import FILE, read_registry
    from egocap_eval.harness.cases import ScoreLog
    from egocap_eval.harness.compare import study as compare

    result, cases = work / "result.json", work / "cases.jsonl"
    content = {"schema": 1, "command": "c", "result": {"a": {"mm": 1.0}, "b": [1, 2]}}
    result.write_text(json.dumps(content))
    other = work / "other.json"
    other.write_text(json.dumps(content | {"result": {"a": {"mm": 2.0}, "b": [1, 3]}}))
    rows = ({"frame": f"a/{n}", "score": {"error": 1.0}} for n in range(3))
    cases.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return [
        ("detector_error.json", SHIPPED, load_detector_error),
        ("result.json", result, lambda path: compare(other, path)),
        ("cases.jsonl", cases, ScoreLog),
        ("results.toml", FILE, read_registry),
    ]


def datasets(sequence: Sequence, work: Path) -> list[Parts]:
    """A data set of one episode: verified, resumed, and its sequences found and read."""
    from egocap.data.dataset import EPISODES, SCHEMA, Dataset, episode_name, find_sequences
    from egocap.data.dataset_writer import DatasetWriter, episode_entry
    from egocap_sim.verification.integrity import verify

    folder, episode = work / "dataset", episode_name(0)
    shutil.copytree(sequence.folder, folder / episode, dirs_exist_ok=True)
    entry, config = episode_entry(folder / episode, 0), {"a": 1}
    assert entry is not None
    asked = Dataset(
        schema_version=SCHEMA, name="a", frames=entry.frames, parts=[entry.frames], seed=0,
        config=config, config_sha256=digest(config), code_version="1",
    )  # fmt: skip
    listed = asked.model_copy(update={"episodes": [entry]})
    (folder / EPISODES).write_text(listed.model_dump_json())

    def use(copy: Path) -> None:
        verify(copy)
        with _without_warnings(), DatasetWriter(copy, asked, append=False) as writer:
            assert writer.done() <= {0}
        for found in find_sequences([copy]):
            assert len(Sequence(found).truth.time) > 0

    return [(f"dataset/{name}", folder / name, use, folder)
            for name in (EPISODES, f"{episode}/manifest.json", f"{episode}/truth.npz")]  # fmt: skip


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Log no episode that is damaged: most are."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def stores(sequence: Sequence, work: Path) -> list[Parts]:
    """A sequence on an object store, and the state of its local copy."""
    from egocap.storage.copies import Copy

    address, folder = "memory://fuzz/walk", work / "store"
    shutil.copytree(sequence.folder, folder, dirs_exist_ok=True)
    with _cache_in(work), redirect_stderr(io.StringIO()):
        copy = Copy(address)
        with copy.held():
            shutil.copytree(folder, copy.path, dirs_exist_ok=True)
            copy.send()
        shutil.copy(copy.path.with_name("state.json"), folder)

    def fetch(folder: Path) -> None:
        """Fetch the sequence with this manifest, then send the manifest again."""
        with _cache_in(folder), redirect_stderr(io.StringIO()):  # without the progress
            copy = Copy(address)
            copy.path.mkdir(parents=True)
            shutil.copy(folder / "state.json", copy.path.with_name("state.json"))
            with copy.held():
                copy.store.put("manifest.json", folder / "manifest.json")
                copy.fetch()
                shutil.copy(folder / "manifest.json", copy.path)
                copy.send()

    return [(f"store/{name}", folder / name, fetch, folder)
            for name in ("manifest.json", "state.json")]  # fmt: skip


@contextmanager
def _cache_in(folder: Path) -> Iterator[None]:
    """Have the cache of the block in an empty folder there."""
    cache, before = folder / "cache", os.environ.get("XDG_CACHE_HOME")
    shutil.rmtree(cache, ignore_errors=True)
    os.environ["XDG_CACHE_HOME"] = str(cache)
    try:
        yield
    finally:
        os.environ.pop("XDG_CACHE_HOME")
        os.environ |= {} if before is None else {"XDG_CACHE_HOME": before}
