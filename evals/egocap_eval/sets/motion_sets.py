"""The training, validation and test sets of recorded motions, and the seeds kept for them."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Literal, get_args

from pydantic import Field, model_validator

from egocap.errors import FileError
from egocap.schema import Strict, checked, read_toml

SetName = Literal["training", "validation", "test"]
SETS: tuple[SetName, ...] = get_args(SetName)
FILE = Path(__file__).with_name("motion_sets.toml")
KINDS = (".bvh", ".npz")


class MotionSets(Strict):
    """Patterns of clips' file names by set, clips left out with the reason, and seeds by set."""

    training: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]
    excluded: dict[str, str] = {}
    seeds: dict[Literal["validation", "test"], tuple[int, int]] = Field(min_length=2)

    @model_validator(mode="after")
    def _seeds_apart(self) -> MotionSets:
        (a, b), (c, d) = self.seeds["validation"], self.seeds["test"]
        if not (a <= b < c <= d or c <= d < a <= b):
            raise ValueError("the ranges of 'seeds' overlap")
        return self

    def set_of(self, clip: str | Path) -> SetName | None:
        """The set of a clip by its file name; None for one of no set, e.g. a user's own.

        Raises FileError for a clip that patterns of several sets match.
        """
        name = Path(clip).name
        if name in self.excluded:
            return None
        found: list[SetName] = [s for s in SETS if any(fnmatch(name, p) for p in getattr(self, s))]
        if len(found) > 1:
            raise FileError(FILE, f"{name} is in the sets {', '.join(found)}", valid="one set")
        return found[0] if found else None

    def may_train(self, clip: str | Path) -> bool:
        """Whether anything may be learned from a clip: one of training, or a user's own."""
        return Path(clip).name not in self.excluded and self.set_of(clip) in ("training", None)

    def seed(self, name: Literal["validation", "test"], index: int) -> int:
        """Seed of the person, room and rig of a set's clip of this index."""
        first, last = self.seeds[name]
        assert 0 <= index <= last - first, (name, index)
        return first + index


@cache
def motion_sets() -> MotionSets:
    """The project's sets."""
    return checked(MotionSets, read_toml(FILE), FILE)


def split_clips(folder: Path, sets: MotionSets | None = None) -> Mapping[SetName, list[Path]]:
    """The clips of a folder by set, sorted by name.

    Raises:
        FileError: there is no such folder, a clip is of several sets or of none, or two files
            have one name.
    """
    sets = sets or motion_sets()
    if not folder.is_dir():
        raise FileError(folder, "no such folder", valid="a folder of motion clips")
    found: dict[SetName, list[Path]] = {name: [] for name in SETS}
    names: dict[str, Path] = {}
    for path in sorted(p for p in folder.rglob("*") if p.suffix in KINDS):
        if path.name in names:
            raise FileError(path, f"has the name of {names[path.name]}")
        names[path.name] = path
        name = sets.set_of(path)
        if name is not None:
            found[name].append(path)
        elif path.name not in sets.excluded:
            raise FileError(path, "is of no set", valid=f"clips that {FILE.name} names")
    return {name: sorted(paths, key=lambda p: p.name) for name, paths in found.items()}
