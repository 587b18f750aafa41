"""Validation footage of the detector: 1000 stereo frames, after the paper's Validation2D.

People, clothes and places have the seeds 160 to 170, which training does not use. 750 frames are of
procedural motions, from the generators that training uses, with other seeds; 250 are of recorded
clips of the validation set. Weights are chosen by this score.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from egocap.cameras.rig_files import load_rig
from egocap.commandline import progress
from egocap.errors import FileError
from egocap_sim.core.resources import builtin_file, rig_names
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene, load_scene

SIZE = (640, 512)


@dataclass(frozen=True)
class Part:
    """One sequence of the validation frames: so many frames of a built-in scene."""

    scene: str
    frames: int
    clip: str = ""  # in a folder of motions, in place of the scene's own motion
    seed: int | None = None  # another person and place than the scene's
    start_s: float = 0.0  # where in the clip to begin


PARTS: dict[str, Part] = {
    "validation-walk": Part("validation-walk", 200),
    "validation-gesture": Part("validation-gesture", 250),
    "crowded": Part("crowded", 150),
    "basketball": Part("basketball", 150),
    "007_05": Part("validation-walk", 125, clip="bvh/007_05.bvh", seed=160),
    "basketball_signal_3": Part(
        "validation-gesture", 125, clip="npz/basketball_signal_3.npz", seed=161
    ),
}
"""With the clips 1000 frames, without 750."""


def make_validation(
    out: Path,
    *,
    motions: Path | None = None,
    size: tuple[int, int] = SIZE,
    rig: str | None = None,
    workers: int = 1,
) -> list[Path]:
    """Generate missing sequences of the validation frames in folder `out`; return all folders.

    Args:
        out: folder of the set, one sequence a folder in it.
        motions: folder with the validation clips; without it the parts that need one are left out.
        size: image width and height, pixels.
        rig: a rig's name or file in place of the scenes' own; its pictures are as wide as `size`
            and keep the aspect of a file's.
        workers: rendering processes.

    Raises:
        FileError: a clip or rig is missing, or `out` holds other sequences under these names.
    """
    scenes = validation_scenes(motions, size, rig)
    for scene in scenes:
        with progress(scene.name, scene.frames) as advance:
            generate(scene, out / scene.name, workers=workers, on_frames=advance)
    return [out / scene.name for scene in scenes]


def validation_scenes(
    motions: Path | None = None, size: tuple[int, int] = SIZE, rig: str | None = None
) -> list[Scene]:
    """The scenes of the validation frames; those of clips only with a folder of motions."""
    return [
        _scene(name, part, motions, size, rig)
        for name, part in PARTS.items()
        if motions is not None or not part.clip
    ]


def _scene(
    name: str, part: Part, motions: Path | None, size: tuple[int, int], rig: str | None
) -> Scene:
    scene = load_scene(builtin_file("scene", part.scene))
    changes = {"name": name, "frames": part.frames}
    changes |= {"seed": part.seed} if part.seed is not None else {}
    changes["rig"] = scene.rig.model_copy(update={"size": size, **_rig(rig, size)})
    if part.clip and motions is not None:
        path = motions / part.clip
        if not path.is_file():
            clips = [p.clip for p in PARTS.values() if p.clip]
            raise FileError(path, "no such clip", valid=clips)
        changes["motion"] = type(scene.motion)(file=str(path.resolve()), start_s=part.start_s)
    return scene.model_copy(update=changes)


def _rig(rig: str | None, size: tuple[int, int]) -> dict[str, Any]:
    """Entries of a scene's rig table for a rig's name or file. Raises FileError."""
    if rig is None or rig in rig_names():
        return {} if rig is None else {"name": rig}
    camera = load_rig(rig).cameras[0]
    height = round(size[0] * camera.height / camera.width)
    return {"name": None, "file": str(Path(rig).resolve()), "size": (size[0], height)}
