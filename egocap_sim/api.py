"""Python functions for `egocap-sim generate` and `egocap-sim preview`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from egocap.data.dataset import find_sequences
from egocap.data.sequence import Sequence, open_sequence
from egocap.errors import InputError
from egocap_sim.core.resources import builtin_file, builtin_names, find_file
from egocap_sim.record.recorder import generate as record
from egocap_sim.scene.config import Scene, load_scene
from egocap_sim.world.overrides import UNCHANGED, Overrides, override_scene


def generate(
    scene: str | Path | Scene,
    out: str | Path,
    *,
    rig: str | Path | None = None,
    frames: int | None = None,
    seed: int | None = None,
    size: tuple[int, int] | None = None,
    motion: str | Path | None = None,
    workers: int = 0,
    append: bool = False,
    overrides: Overrides = UNCHANGED,
) -> Sequence:
    """Simulate a scene, render it into the folder `out` and open the result.

    Completes an unfinished run of the same scene and only opens a finished one.

    Args:
        scene: name of a built-in scene, a scene file, or a scene.
        out: folder of the sequence.
        rig: name of a built-in rig, a rig file, or 'sampled': drawn from the seed.
        frames: number of stereo frames; of a motion file, by default all frames.
        seed: seed of all random draws: person, clothes, place, style of motion.
        size: image width and height in pixels; the rig is scaled to it.
        motion: name of a procedural motion, or a BVH or npz file.
        workers: number of rendering processes; 0: render in this process. With processes, a script
            needs `if __name__ == "__main__":`, as for any use of multiprocessing.
        append: extend a finished sequence of fewer frames.
        overrides: all other changes of the scene.

    Raises InputError or FileError for bad input and for a scene of episodes, MachineError when GL
    is missing, the disk is full or workers keep dying.
    """
    given = {"rig": rig, "frames": frames, "seed": seed, "size": size, "motion": motion}
    named = {
        key: str(value) if isinstance(value, Path) else value
        for key, value in given.items()
        if value is not None
    }
    changed = _resolve_scene(scene, replace(overrides, **named))
    if changed.episodes is not None:
        raise InputError(
            f"scene '{changed.name}' is recorded in episodes, not as one sequence",
            valid="Overrides(no_episodes=True), or egocap_sim.generate_episodes",
        )
    record(changed, Path(out), workers=workers, append=append)
    return open_sequence(out)


def generate_episodes(
    scene: str | Path | Scene,
    out: str | Path,
    *,
    workers: int = 0,
    append: bool = False,
    overrides: Overrides = UNCHANGED,
) -> list[Sequence]:
    """Record a scene in episodes and open them; the arguments are those of `generate`."""
    changed = _resolve_scene(scene, replace(overrides, episodes=not overrides.no_episodes))
    record(changed, Path(out), workers=workers, append=append)
    return [open_sequence(folder) for folder in find_sequences([Path(out)])]


def preview(
    sequence: Sequence | str | Path, out: str | Path, *, rows: int = 6, width: int = 480
) -> None:
    """Write a contact sheet: every view, joints over the image, part labels.

    Args:
        sequence: a sequence, its folder, or a folder of sequences.
        out: PNG or JPEG file to write.
        rows: frames to show, spread over the sequence.
        width: width of one picture in pixels.
    """
    from egocap_sim.export.preview import save_contact_sheet

    folder = sequence.folder if isinstance(sequence, Sequence) else Path(sequence)
    save_contact_sheet(find_sequences([folder]), Path(out), rows=rows, tile_width=width)


def scene_file(name_or_path: str | Path) -> Path:
    """A scene's file; a folder, as of a recording, hides no built-in scene. Raises InputError."""
    name = str(name_or_path)
    if name in builtin_names("scene") and Path(name).is_dir():
        return builtin_file("scene", name)
    return find_file("scene", name_or_path)


def _resolve_scene(scene: str | Path | Scene, overrides: Overrides) -> Scene:
    loaded = scene if isinstance(scene, Scene) else load_scene(scene_file(scene))
    return override_scene(loaded, overrides)
