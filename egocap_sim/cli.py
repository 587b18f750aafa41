"""The command `egocap-sim`: generate sequences, look at them, check them."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional
from tyro.extras import SubcommandApp

from egocap.commandline import DONE, USAGE, progress, run

if TYPE_CHECKING:
    from egocap_sim.record import Summary
    from egocap_sim.scene import Scene

app = SubcommandApp()


@dataclass(frozen=True)
class Overrides:
    """What the command line changes in a scene file. Paths are relative to where you are."""

    frames: int | None = None
    """Number of stereo frames."""
    seed: int | None = None
    """Seed of everything random: person, clothes, place, style of motion."""
    rig: str | None = None
    """A built-in rig's name or a rig file."""
    size: tuple[int, int] | None = None
    """Image width and height in pixels; the rig is scaled to it."""
    motion: str | None = None
    """A procedural motion's name, or a BVH or npz clip."""
    start: float | None = None
    """Where in the motion to begin, seconds."""
    up: str | None = None
    """Up axis of a BVH file, y or z; recognised when not given."""
    unit: str | None = None
    """Length unit of a BVH file, m, cm, mm or in; recognised when not given."""
    joint_names: Path | None = None
    """TOML file that maps body names to a BVH file's joint names."""
    samples: int | None = None
    """Multisample anti-aliasing: 0, 2, 4 or 8."""
    masks: bool | None = None
    """Record part labels."""
    depth: bool | None = None
    """Record depth."""
    image_format: str | None = None
    """jpg (quality 95, 4:4:4) or png."""


@app.command
def generate(
    scenes: Positional[tuple[str, ...]],
    out: Path,
    overrides: Annotated[Overrides, tyro.conf.OmitArgPrefixes] = Overrides(),
    workers: int = 2,
    json: bool = False,
) -> int:
    """Simulate scenes and render them into sequences; run again to continue after a kill.

    Args:
        scenes: built-in scene names or scene files.
        out: folder of the sequence; with several scenes, one folder in it for each.
        overrides: what to change in the scenes.
        workers: rendering processes.
        json: print the summary as JSON.
    """
    from egocap.errors import InputError
    from egocap_sim.builtin import find_file
    from egocap_sim.scene import load_scene

    if not scenes:
        raise InputError("no scene given", valid="names or files of scenes")
    if workers < 1:
        raise InputError(f"{workers} workers", valid="1 or more")
    loaded = [_overridden(load_scene(find_file("scene", name)), overrides) for name in scenes]
    for scene in loaded:
        folder = out / scene.name if len(loaded) > 1 else out
        _print_summary(_generate(scene, folder, workers), json)
    return DONE


@app.command
def preview(sequence: Positional[Path], out: Path, rows: int = 6, width: int = 480) -> int:
    """Draw a contact sheet: left, right, joints over the image, part labels.

    Args:
        sequence: folder of a sequence.
        out: PNG or JPEG file to write.
        rows: frames to show, spread over the sequence.
        width: width of one picture in pixels.
    """
    from egocap.sequence import Sequence
    from egocap_sim.preview import save_contact_sheet

    save_contact_sheet(Sequence(sequence), out, rows=rows, tile_width=width)
    print(out)
    return DONE


@app.command
def verify(sequence: Positional[Path], json: bool = False) -> int:
    """Check that a sequence is whole, undamaged and consistent with itself.

    Args:
        sequence: folder of a sequence.
        json: print the result as JSON.
    """
    from egocap_sim.verify import verify as check

    result = check(sequence)
    if json:
        _print_json({"folder": str(sequence), "clean": result.clean, "frames": result.frames,
                     "shards": result.shards, "bytes": result.bytes,
                     "problems": list(result.problems)})  # fmt: skip
    elif result.clean:
        size = result.bytes / 1e6
        print(f"{sequence}: {result.frames} frames in {result.shards} shards, {size:.0f} MB, clean")
    else:
        for problem in result.problems:
            print(f"{sequence}: {problem}", file=sys.stderr)
    return DONE if result.clean else USAGE


@app.command(name="list")
def list_() -> int:
    """Name the built-in scenes, rigs and motions."""
    from egocap_sim.builtin import builtin_names
    from egocap_sim.motion.procedural import MOTIONS

    print("scenes: ", *builtin_names("scene"))
    print("rigs:   ", *builtin_names("rig"))
    print("motions:", *MOTIONS)
    return DONE


def main() -> int:
    """Run `egocap-sim` and return its exit code."""
    return run(app, prog="egocap-sim", description="Simulate egocentric stereo fisheye footage.")


def _overridden(scene: Scene, asked: Overrides) -> Scene:
    """The scene with the command line's changes, checked like the file itself."""
    from egocap.schema import checked
    from egocap_sim.builtin import builtin_names
    from egocap_sim.motion.procedural import MOTIONS
    from egocap_sim.scene import Scene

    data = scene.model_dump(exclude_none=True)
    for key in ("frames", "seed"):
        _set(data, key, getattr(asked, key))
    for key in ("samples", "masks", "depth", "image_format"):
        _set(data["record"], key, getattr(asked, key))
    if asked.rig is not None:
        kind = "name" if asked.rig in builtin_names("rig") else "file"
        data["rig"].pop("file", None)
        data["rig"][kind] = asked.rig if kind == "name" else str(Path(asked.rig).resolve())
    _set(data["rig"], "size", asked.size)
    if asked.motion is not None:
        source = {"name": asked.motion} if asked.motion in MOTIONS else {
            "file": str(Path(asked.motion).resolve())}  # fmt: skip
        data["motion"] = source
    for key, value in (("start_s", asked.start), ("up", asked.up), ("unit", asked.unit)):
        _set(data["motion"], key, value)
    if asked.joint_names is not None:
        data["motion"]["joint_names"] = str(asked.joint_names.resolve())
    return checked(Scene, data, "command line")


def _set(table: dict, key: str, value: object) -> None:
    if value is not None:
        table[key] = value


def _generate(scene: Scene, folder: Path, workers: int) -> Summary:
    from egocap_sim.record import generate as generate_sequence

    with progress(scene.name, scene.frames) as advance:
        return generate_sequence(scene, folder, workers=workers, on_frames=advance)


def _print_summary(summary: Summary, as_json: bool) -> None:
    if as_json:
        physics = vars(summary.physics) if summary.physics else None
        _print_json({"folder": str(summary.folder), "frames": summary.frames,
                     "rendered": summary.rendered, "seconds": summary.seconds,
                     "bytes": summary.bytes, "physics": physics})  # fmt: skip
        return
    size = summary.bytes / 1e6
    if not summary.rendered:
        print(f"{summary.folder}: {summary.frames} frames, {size:.0f} MB, already complete")
        return
    print(f"{summary.folder}: {summary.frames} stereo frames, {size:.0f} MB, "
          f"{summary.frames_per_second:.1f} frames/s")  # fmt: skip
    if stats := summary.physics:
        print(f"physics: joints within {stats.joint_error_cm:.2f} cm of the reference (max "
              f"{stats.joint_error_max_cm:.1f}), planted feet {stats.planted_foot_speed_cm_s:.1f} "
              f"cm/s, residual wrench {stats.residual_wrench_bw:.2f} body weights")  # fmt: skip


def _print_json(content: dict) -> None:
    print(json.dumps(content, indent=1))
