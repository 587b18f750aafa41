"""A command over many recordings, with one index of the finished ones.

`recordings.json` in the folder of results has the settings, and a checksum of every result. The
same call goes on: a recording is done again if its sources or its result have changed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

from egocap.commandline import progress
from egocap.data.sequence_writer import digest
from egocap.errors import FileError
from egocap.execution.jobs import Executor
from egocap.execution.recording_task import Made, RecordingTask, Report
from egocap.execution.recordings import Recording
from egocap.files import sha256, write_json
from egocap.locks import IN_FOLDER, holding
from egocap.schema import Strict, checked, read_json

INDEX = "recordings.json"


class Finished(Strict):
    """A recording in the index."""

    stamp: str  # of the sources
    sha256: str  # of the result
    summary: dict[str, Any]
    lines: list[str]
    missed: bool


class Index(Strict):
    """recordings.json."""

    kind: Literal["egocap-recordings"] = "egocap-recordings"
    command: str
    version: str
    settings: dict[str, Any]
    recordings: dict[str, Finished] = {}


@dataclass(frozen=True)
class Outcome:
    """Reports of the finished recordings and errors of the others, by name."""

    reports: dict[str, Report]
    errors: dict[str, str]
    before: int  # recordings that an earlier run finished


def run_recordings(
    command: str, function: Callable[..., Report], settings: dict[str, Any],
    recordings: Sequence[Recording], out: Path, executor: Executor,
) -> Outcome:  # fmt: skip
    """Call a function for every recording whose result is not in the folder `out` yet.

    Args:
        command: name of the command, for the index and the progress.
        function: what is done; see RecordingTask.
        settings: its arguments by name. Results of others are not mixed with these.
        recordings: what to work on.
        out: folder of the results; one process holds its lock.
        executor: what runs the jobs.

    Raises FileError if `out` holds results of another command, version or settings; MachineError
    when workers keep dying. A recording that fails does not end the others.
    """
    task = RecordingTask(function, settings, executor.separate)
    asked = Index(command=command, version=task.version(), settings=_plain(settings))
    wanted = {recording.name: recording for recording in recordings}
    errors: dict[str, str] = {}
    with holding(out, folder=True), progress(command, len(wanted), unit="recordings") as advance:
        index = _open(out / INDEX, asked)
        done = {name for name, recording in wanted.items() if _is_done(index, recording, out)}
        advance(len(done))

        def enter(made: Made) -> None:
            if made.report is None:
                errors[made.name] = made.error
            else:
                index.recordings[made.name] = _finished(made.report, wanted[made.name], out)
                write_json(out / INDEX, index.model_dump(mode="json"))
            advance(1)

        if left := [recording for recording in recordings if recording.name not in done]:
            executor.run(task, left, out, enter)
    reports = {name: _report(index.recordings[name]) for name in wanted if name not in errors}
    return Outcome(reports, errors, len(done))


def _open(path: Path, asked: Index) -> Index:
    """The index that is there, or the empty one that is asked for."""
    if not path.exists():
        return asked
    there = checked(Index, read_json(path), path)
    for key, how in (("command", f"by '{there.command}'"), ("settings", "with other settings"),
                     ("version", f"by version {there.version}")):  # fmt: skip
        if getattr(there, key) != getattr(asked, key):
            raise FileError(path, f"its results were made {how}", valid="another --out")
    return there


def _is_done(index: Index, recording: Recording, out: Path) -> bool:
    entry = index.recordings.get(recording.name)
    return (entry is not None and entry.stamp == recording.stamp
            and entry.sha256 == _checksum(out / recording.name))  # fmt: skip


def _finished(report: Report, recording: Recording, out: Path) -> Finished:
    return Finished(
        stamp=recording.stamp, sha256=_checksum(out / recording.name), summary=report.summary,
        lines=list(report.lines), missed=report.missed,
    )  # fmt: skip


def _report(entry: Finished) -> Report:
    return Report(entry.summary, tuple(entry.lines), entry.missed)


def _checksum(path: Path) -> str:
    """Of a file, or of all files of a folder; empty where there is nothing."""
    if path.is_file():
        return sha256(path)
    files = sorted(p for p in path.rglob("*") if p.is_file() and p.name != IN_FOLDER)
    return digest({str(p.relative_to(path)): sha256(p) for p in files}) if files else ""


def _plain(value: Any) -> Any:
    """The value JSON-ready; names of files with their checksums."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, (str, Path)):
        name = str(value).removeprefix("learned:")  # an empty one would be the working folder
        return [str(value), _checksum(Path(name))] if name and Path(name).exists() else str(value)
    return list(value) if isinstance(value, tuple) else value
