"""The Rerun viewer on sequences, tracks, posteriors and rigs, or a file for it.

Source: https://rerun.io/docs (recordings, blueprints).
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from collections.abc import Sequence as Items
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from egocap.cameras.rig_files import load_rig
from egocap.commandline import progress
from egocap.data.head_pose import load_head_pose, load_surroundings
from egocap.data.sequence import Sequence
from egocap.data.track import load_track
from egocap.errors import FileError, InputError, MachineError, require
from egocap.files import make_folder, read_npz, write_atomically
from egocap.posterior.result import KIND, load_posterior
from egocap.view.film import write_film
from egocap.view.scene import HeadPath, Scene, Shown

SUFFIX, FILM = ".rrd", ".mp4"
CURVES = {"error": "mean error, mm", "confidence": "least confidence", "angles": "angles, degrees"}
"""Curves of a track, by the names of `Scene`, and their titles."""


def open_all(paths: Items[Path]) -> Shown:
    """Read what is to be shown. Raises FileError, and InputError for two sequences or rigs."""
    shown = Shown()
    for path in paths:
        if path.is_dir():
            _only(shown.sequence, path)
            shown.sequence = Sequence(path)
        elif path.suffix == ".npz":
            found = read_npz(path, only=("kind", "T_world_head"))
            if "kind" not in found and "T_world_head" in found:
                _only(shown.head, path)
                shown.head = HeadPath(*load_head_pose(path), load_surroundings(path))
                continue
            posterior = str(found.get("kind")) == KIND
            of_kind: dict[str, Any] = shown.posteriors if posterior else shown.tracks
            name = path.stem if path.stem not in of_kind else f"{path.stem}-{len(of_kind)}"
            of_kind[name] = load_posterior(path) if posterior else load_track(path)
        elif path.suffix.lower() in (".toml", ".json"):
            _only(shown.rig, path)
            shown.rig = load_rig(path)
        else:
            raise FileError(path, "cannot be viewed",
                            valid="a sequence, which egocap import makes of videos; a track, "
                            "posterior or head poses, npz; a rig file, toml or json")  # fmt: skip
    if shown.sequence is not None and shown.rig is None:
        shown.rig = shown.sequence.rig
    if shown.head is not None and not shown.in_world:
        raise InputError("head poses beside a motion in the head frame",
                         valid="tracks made with --head-pose beside them")  # fmt: skip
    return shown


def view(paths: Items[Path], save: Path | None = None, images: bool = True) -> None:
    """Open the viewer on what the paths hold, or save a recording for it, or a film (.mp4).

    Raises FileError, InputError, and MachineError without the extra `view`, which a film does not
    need, or without a display.
    """
    if save is not None and save.suffix == FILM:
        return _film(open_all(paths), save)
    if save is not None and save.suffix != SUFFIX:
        raise InputError(f"cannot write '{save.name}'",
                         valid=f"a name that ends in {SUFFIX} or {FILM}")  # fmt: skip
    require("rerun", "view")
    import rerun as rr

    shown = open_all(paths)
    if save is not None:
        make_folder(save.parent)
        write_atomically(save, _recording(rr, shown, images))
        return
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"egocap{SUFFIX}"
        file.write_bytes(_recording(rr, shown, images))
        # Without --bind the viewer accepts data from other machines.
        done = subprocess.run([sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(file)],
                              check=False)  # fmt: skip
    if done.returncode:
        raise MachineError("the viewer did not open", remedy=f"--save FILE{SUFFIX} writes a file")


def _film(shown: Shown, save: Path) -> None:
    if shown.sequence is None or len(shown.tracks) != 1 or shown.posteriors:
        raise InputError("a film of something else", valid="one sequence and one track of it")
    (track,) = shown.tracks.values()
    with progress("film", len(shown.sequence)) as advance:
        points = None if shown.head is None else shown.head.points
        write_film(save, shown.sequence, track, advance, points)


def _recording(rr: Any, shown: Shown, images: bool) -> bytes:
    """Content of a file. In memory: on a full disk rerun would wait without end."""
    recording = rr.RecordingStream("egocap")
    content = recording.memory_recording()
    views = shown.rig.views if shown.sequence and shown.rig else ()
    curves = dict(CURVES) if shown.tracks else {}
    if shown.sequence is None or not shown.sequence.manifest.truth:
        curves.pop("error", None)
    recording.send_blueprint(layout(rr, shown, views, curves))
    Scene(rr, recording, shown).log(images)
    recording.flush()
    return content.drain_as_bytes()


def layout(rr: Any, shown: Shown, views: Items[str], curves: Mapping[str, str]) -> Any:
    """Space to the left; images of the views, and curves by name and title, to the right."""
    panels = [rr.blueprint.Spatial2DView(origin=f"views/{view}", name=view) for view in views]
    if curves:
        panels.append(rr.blueprint.Tabs(*(
            rr.blueprint.TimeSeriesView(origin=f"curves/{name}", name=title)
            for name, title in curves.items()
        )))  # fmt: skip
    grid = rr.blueprint.LineGrid3D(plane=rr.components.Plane3D((0.0, 0.0, 1.0), shown.floor))
    space = rr.blueprint.Spatial3DView(
        origin="space", name="world" if shown.in_world else "head", line_grid=grid
    )
    if not panels:
        return rr.blueprint.Blueprint(space, collapse_panels=True)
    side = rr.blueprint.Vertical(*panels)
    return rr.blueprint.Blueprint(rr.blueprint.Horizontal(space, side, column_shares=[3, 2]),
                                  collapse_panels=True)  # fmt: skip


def _only(before: object, path: Path) -> None:
    if before is not None:
        raise InputError(f"{path}: a second one of its kind",
                         valid="one sequence, one rig and one file of head poses")  # fmt: skip
