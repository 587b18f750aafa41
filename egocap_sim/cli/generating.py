"""The command that generates sequences."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from egocap.commandline import DONE, progress
from egocap.options import several
from egocap_sim.cli.registry import app, print_json
from egocap_sim.world.overrides import UNCHANGED, Overrides, override_scene, shown

if TYPE_CHECKING:
    from egocap_sim.record.sequence_recorder import Summary
    from egocap_sim.scene.config import Scene


@app.command
def generate(
    scenes: Positional[Annotated[tuple[str, ...], several("SCENE")]],
    out: Path,
    overrides: Annotated[Overrides, tyro.conf.OmitArgPrefixes] = UNCHANGED,
    workers: int | None = None,
    cluster: Annotated[str | None, shown("ADDRESS")] = None,
    append: bool = False,
    strict: bool = False,
    json: bool = False,
) -> int:
    """Simulate scenes and render them into sequences.

    Run the same command again to continue an interrupted run.

    Args:
        scenes: names of built-in scenes, or scene files.
        out: folder of the sequence; of several scenes, the folder that holds theirs.
        overrides: changes of the scenes.
        workers: number of rendering processes; 0: this one. By default this one for at most 100
            frames, else 2.
        cluster: render on the workers of this Dask scheduler, e.g. tcp://host:8786.
        append: extend a finished sequence of fewer frames up to --frames.
        strict: stop at a motion file that is suspect (check-motion), and at one in --motions that
            cannot be read, instead of skipping it.
        json: print the summary as JSON; of several scenes, a list.
    """
    from egocap.errors import InputError
    from egocap_sim.api import scene_file
    from egocap_sim.scene.config import load_scene

    if not scenes:
        raise InputError("no scene given", valid="names or files of scenes")
    files = [scene_file(name) for name in scenes]
    loaded = [override_scene(load_scene(file), overrides) for file in files]
    names = [scene.name for scene in loaded]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two scenes have the name '{twice[0]}'", valid="different names")
    done = []
    for file, scene in zip(files, loaded, strict=True):
        summary = _generate(
            scene, file, out / scene.name if len(loaded) > 1 else out, workers, cluster,
            append, strict,
        )  # fmt: skip
        done.append(_as_json(summary))
        if not json:
            _print_summary(summary)
    if json:
        print_json(done if len(done) > 1 else done[0])
    return DONE


def _generate(
    scene: Scene,
    file: Path,
    folder: Path,
    workers: int | None,
    cluster: str | None,
    append: bool,
    strict: bool,
) -> Summary:
    from egocap.errors import FileError
    from egocap_sim.record.recorder import generate as generate_sequence
    from egocap_sim.scene.scene_error import SceneError

    try:
        with progress(scene.name, scene.frames) as advance:
            return generate_sequence(
                scene, folder, workers=workers, cluster=cluster, append=append, strict=strict,
                on_frames=advance,
            )  # fmt: skip
    except SceneError as error:
        raise FileError(file, error.problem, key=error.key) from None


def _as_json(summary: Summary) -> dict[str, object]:
    physics = vars(summary.physics) if summary.physics else None
    return {"folder": str(summary.folder), "frames": summary.frames, "rendered": summary.rendered,
            "seconds": summary.seconds, "bytes": summary.bytes, "physics": physics,
            "motions": [report.to_dict() for report in summary.motions],
            "episodes": summary.episodes, "people": summary.people,
            "bystanders": summary.bystanders}  # fmt: skip


def _print_summary(summary: Summary) -> None:
    size = summary.bytes / 1e6
    if not summary.rendered:
        print(f"{summary.folder}: {summary.frames} frames, {size:.1f} MB, already complete")
        return
    wearers = "1 wearer" if summary.people == 1 else f"{summary.people} wearers"
    others = ""
    if count := summary.bystanders:
        each = "each " if summary.people > 1 else ""
        others = f", {each}among {count} {'other' if count == 1 else 'others'}"
    print(f"{summary.folder}: {summary.frames} frames of {wearers}{others}, {size:.1f} MB, "
          f"{summary.frames_per_second:.1f} frames/s")  # fmt: skip
    if stats := summary.physics:
        print(f"physics: joints within {stats.joint_error_cm:.2f} cm of the reference (max "
              f"{stats.joint_error_max_cm:.1f}), planted feet {stats.planted_foot_speed_cm_s:.1f} "
              f"cm/s, residual wrench {stats.residual_wrench_bw:.2f} body weights")  # fmt: skip
        if stats.raw_error_cm is not None:
            print(f"         joints within {stats.raw_error_cm:.2f} cm of the motion file as "
                  f"recorded (max {stats.raw_error_max_cm:.1f})")  # fmt: skip
