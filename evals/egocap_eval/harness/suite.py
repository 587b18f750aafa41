"""Suites: sequences, methods, studies and thresholds, read from a TOML file.

[[sequences]]      made where missing: a scene (built in, or a file beside the suite) at a size,
                   perhaps with another motion file, or an existing folder
[[methods]]        a tracker on a source of detections, or a file of predictions per sequence
[[studies]]        commands of `egocap-eval`, their results beside the suite's own
[[thresholds]]     most or least of a measure
[[rows]]           quantitative statements of the paper, and where ours is found
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from egocap.errors import FileError, InputError
from egocap.evaluation import find_measure, find_protocol
from egocap.schema import Strict, checked, read_toml

FOLDER = Path(__file__).parents[1] / "suites"


class SequenceEntry(Strict):
    """A sequence of a suite."""

    name: str = Field(pattern=r"^[\w.-]+$")
    scene: str | None = None  # name of a built-in scene, or a .toml beside the suite
    folder: str | None = None  # an existing sequence, beside the suite or absolute
    motion: str | None = None  # file under --motions; left out without that option
    frames: int | None = Field(default=None, ge=1)
    size: tuple[int, int] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> SequenceEntry:
        if (self.scene is None) == (self.folder is None):
            raise ValueError(f"sequence '{self.name}' needs one of 'scene' and 'folder'")
        return self


class MethodEntry(Strict):
    """How joints are made from a sequence."""

    name: str = Field(pattern=r"^[\w.-]+$")
    detections: str | None = None  # a source, e.g. "simulated:2.0" or "detector:mine"
    tracker: str = "egocap"  # or a plug-in
    config: dict[str, float | str | bool | int] = {}  # settings of the built-in tracker
    predictions: str | None = None  # or files made elsewhere, "{sequence}" standing for the name
    seeds: int = Field(default=1, ge=1)  # of the noise of simulated detections
    optional: bool = False  # left out, with a warning, where its weights or files are missing

    @model_validator(mode="after")
    def _one_source(self) -> MethodEntry:
        if self.predictions is not None and (self.detections is not None or self.config):
            raise ValueError(f"method '{self.name}' has predictions and a tracker's settings")
        return self


class StudyEntry(Strict):
    """A study to run with the suite."""

    name: str
    options: tuple[str, ...] = ()


class Threshold(Strict):
    """A bound on one number, of every sequence unless one is named."""

    method: str
    measure: str
    sequence: str | None = None
    most: float | None = None
    least: float | None = None

    @model_validator(mode="after")
    def _bounded(self) -> Threshold:
        if self.most is None and self.least is None:
            raise ValueError("a threshold needs 'most' or 'least'")
        return self


class PaperRow(Strict):
    """A quantitative statement of the paper, and where ours is found.

    `ours` is "method/sequence/measure" of this suite, or "STUDY.json:key.key" of a study's result,
    which may be a word; `less`, of the same form, is subtracted from it, and `error` is the place
    of its error bar. `command` measures it, for those that no result holds yet.
    """

    section: str
    statement: str
    paper: str
    unit: str = ""
    ours: str | None = None
    less: str | None = None
    error: str | None = None
    scale: float = 1.0
    digits: int = 1
    conditions: str = ""
    command: str = ""


class Suite(Strict):
    """A suite file, checked."""

    name: str = Field(pattern=r"^[\w.-]+$")
    description: str = ""
    protocols: tuple[str, ...] = ("egocap-17",)
    measures: tuple[str, ...] = ("mpjpe_mm", "pa_mpjpe_mm", "pck3d_150", "accel_error")
    sequences: tuple[SequenceEntry, ...] = ()
    methods: tuple[MethodEntry, ...] = ()
    studies: tuple[StudyEntry, ...] = ()
    thresholds: tuple[Threshold, ...] = ()
    rows: tuple[PaperRow, ...] = ()
    rows_file: str | None = None  # another TOML with [[rows]], beside this one


class _RowsFile(Strict):
    rows: tuple[PaperRow, ...]


def load_suite(path: str | Path) -> Suite:
    """A suite by its file, or by the name of a built-in one.

    Raises:
        FileError: not a suite, or an unknown protocol, measure, method or sequence in it.
    """
    path = find_suite(path)
    suite = checked(Suite, read_toml(path), path)
    if suite.rows_file is not None:
        rows_path = path.parent / suite.rows_file
        more = checked(_RowsFile, read_toml(rows_path), rows_path).rows
        suite = suite.model_copy(update={"rows": suite.rows + more})
    _check_names(suite, path)
    return suite


def shortened(suite: Suite, frames: int) -> Suite:
    """A short version of a suite: at most `frames` frames, one seed, no studies, another name.

    Raises InputError for fewer than two frames.
    """
    if frames < 2:
        raise InputError(f"--frames {frames}", valid="2 or more")
    sequences = (
        s.model_copy(update={"frames": min(frames, s.frames or frames)})
        if s.folder is None else s for s in suite.sequences
    )  # fmt: skip
    methods = (m.model_copy(update={"seeds": 1}) for m in suite.methods)
    return suite.model_copy(update={
        "name": f"{suite.name}-{frames}", "sequences": tuple(sequences), "methods": tuple(methods),
        "studies": (), "thresholds": (),
    })  # fmt: skip


def find_suite(name: str | Path) -> Path:
    """The file of a suite; FileError lists the built-in ones."""
    path = Path(name)
    if path.suffix == ".toml":
        return path
    built_in = FOLDER / f"{name}.toml"
    if not built_in.is_file():
        names = sorted(p.stem for p in FOLDER.glob("*.toml") if p.stem != "paper")
        raise FileError(path, "no such suite", valid=[*names, "a .toml file"])
    return built_in


def _check_names(suite: Suite, path: Path) -> None:
    methods = [m.name for m in suite.methods]
    sequences = [s.name for s in suite.sequences]
    for key, names in (("methods", methods), ("sequences", sequences)):
        if len(set(names)) < len(names):
            raise FileError(path, "the same name twice", key=key)
    for key, names, find in (
        ("protocols", suite.protocols, find_protocol),
        ("measures", suite.measures, find_measure),
        ("thresholds", [t.measure for t in suite.thresholds], find_measure),
    ):
        for name in names:
            _found(path, key, name, find)
    for i, threshold in enumerate(suite.thresholds):
        for key, name, valid in (("method", threshold.method, methods),
                                 ("sequence", threshold.sequence, sequences)):  # fmt: skip
            if name is not None and name not in valid:
                raise FileError(path, f"no {key} '{name}'", key=f"thresholds.{i}", valid=valid)


def _found(path: Path, key: str, name: str, find: Any) -> None:
    try:
        find(name)
    except InputError as error:
        raise FileError(path, str(error), key=key) from None
