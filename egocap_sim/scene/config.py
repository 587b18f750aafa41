"""Scene files: rig, person, motion, place, bystanders, props, sensor and recording.

A scene is TOML; every key has a default but the name and the motion. Unknown keys, wrong types and
values out of range are errors that name the file and the key.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from egocap.schema import Number, Strict, checked, read_toml
from egocap_sim.core.resources import SAMPLED
from egocap_sim.sensor.config import SensorTable, Share

Whole = Annotated[int, Field(strict=True)]
"""An integer; text and booleans are refused."""
Switch = Annotated[bool, Field(strict=True)]
Pixels = Annotated[int, Field(strict=True, ge=64, le=8192)]


def _plain(value: Any) -> Any:
    """Check that TOML can hold the value on one line; the motion checks its meaning."""
    if isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
        return list(value)
    if not isinstance(value, str | int | float):
        raise ValueError("input should be a number, text, true or false, or a list of texts")
    return value


Parameter = Annotated[Any, AfterValidator(_plain)]


class RigTable(Strict):
    """The cameras: a built-in rig's name or a rig file, and the recorded image size."""

    name: str | None = None  # None and no file: egorig1
    family: Literal["arms", "glasses", "headset", "single", "any"] | None = (
        None  # of a sampled rig; None: arms
    )
    file: str | None = None  # path, relative to the scene file; in place of a name
    size: tuple[Pixels, Pixels] | None = None  # width, height; None: the rig's own

    @model_validator(mode="after")
    def _one_source(self) -> RigTable:
        if self.name is not None and self.file is not None:
            raise ValueError("give either 'name' (a built-in rig) or 'file' (a rig file)")
        if self.family is not None and self.name != SAMPLED:
            raise ValueError(f"'family' is of the rig '{SAMPLED}'")
        return self


class PersonTable(Strict):
    """The wearer. Missing values are drawn from the seed."""

    sex: Literal["female", "male"] | None = None
    height_m: Number | None = Field(default=None, ge=1.40, le=2.10)
    age_years: Number | None = Field(default=None, ge=18, le=90)
    skin_tone: Number | None = Field(default=None, ge=0, le=1)  # light to dark
    phenotype: dict[str, Number] = {}  # weight, muscle, ...: egocap_sim.human.body.phenotype
    outfit: dict[str, str] = {}  # garments and fabrics: egocap_sim.human.clothing.outfit
    headgear: Literal["helmet", "headset", "cap", "glasses", "none", "rig"] = (
        "rig"  # "rig": the one of the rig
    )


class MotionTable(Strict):
    """The wearer's motion: a procedural motion by name, or a clip file."""

    name: str | None = None
    parameters: dict[str, Parameter] = {}  # of a procedural motion
    file: str | None = None  # BVH or npz; path relative to the scene file
    start_s: Number = Field(default=0.0, ge=0)  # in the motion's own time, whatever its speed
    up: Literal["y", "z"] | None = None  # of BVH files; None: detected
    unit: Literal["m", "cm", "mm", "inch", "foot", "cmu"] | None = None
    joint_names: str | None = None  # TOML file that maps bodies to the files' joint names
    length_s: Number | None = Field(default=None, ge=0.5, le=3600)  # to make or use; None: all
    mirrored: Switch = False  # exchange left and right of a clip
    speed: Number = Field(default=1.0, ge=0.5, le=2.0)  # playback speed of a clip
    then: str | None = None  # second clip, blended in half-way through `length_s`
    then_start_s: Number = Field(default=0.0, ge=0)  # start time in the second clip

    @model_validator(mode="after")
    def _one_source(self) -> MotionTable:
        if (self.name is None) == (self.file is None):
            raise ValueError("give either 'name' (a procedural motion) or 'file' (a clip)")
        return self

    @model_validator(mode="after")
    def _nothing_unused(self) -> MotionTable:
        of_clips = {"up": self.up, "unit": self.unit, "joint_names": self.joint_names,
                    "mirrored": self.mirrored, "then": self.then,
                    "speed": None if self.speed == 1.0 else self.speed}  # fmt: skip
        unused = [key for key, value in of_clips.items() if self.name is not None and value]
        if unused:
            raise ValueError(f"'{unused[0]}' is for a clip, not for the motion '{self.name}'")
        if self.file is not None and self.parameters:
            raise ValueError("'parameters' are for a procedural motion, not for a clip")
        if self.then is not None and self.length_s is None:
            raise ValueError("'then' requires 'length_s': the clips are joined half-way")
        if self.then_start_s and self.then is None:
            raise ValueError("'then_start_s' requires 'then', the second clip")
        return self


class PlaceTable(Strict):
    """The surroundings."""

    name: str = "room"
    clear_radius: Number = Field(default=2.0, ge=0.5, le=15)  # metres around the origin, kept free
    light: Literal["day", "dusk"] = "day"
    contact: Switch = True  # contact shadows on the floor
    textures: str | None = None  # folder of images for floors and walls, relative to the file
    panorama: str | None = None  # equirectangular image in place of the sky

    @model_validator(mode="after")
    def _chroma_is_even(self) -> PlaceTable:
        if self.name == "chroma" and (self.textures or self.panorama):
            key = "textures" if self.textures else "panorama"
            raise ValueError(f"'{key}' is not for the place 'chroma', which has one colour")
        return self


class OthersTable(Strict):
    """Bystanders; the behaviours are assigned to them in turn."""

    count: Whole = Field(default=0, ge=0, le=12)
    behaviours: tuple[Literal["walk_by", "stand", "gesture", "approach", "shake_hands"], ...] = (
        Field(default=("walk_by", "gesture", "approach", "stand"), min_length=1)
    )
    nearest_m: Number = Field(default=0.75, ge=0.6, le=10)  # from the wearer, of standing ones
    farthest_m: Number = Field(default=2.0, gt=0, le=14)  # as long as there is room

    @model_validator(mode="after")
    def _near_before_far(self) -> OthersTable:
        if self.nearest_m >= self.farthest_m:
            raise ValueError("'farthest_m' must be greater than 'nearest_m'")
        return self


class ThingTable(Strict):
    """A prop: `egocap_sim.props.registry`."""

    kind: str
    hand: Literal["left", "right"] | None = None  # hand that holds it; None: the right


class EpisodesTable(Strict):
    """A data set of episodes instead of one sequence.

    Person, place, motion and, if sampled, rig are drawn for each episode from the scene's seed and
    the episode's number. `[others] count` is the maximum.
    """

    frames: tuple[Whole, Whole] = (25, 100)  # of each: minimum and maximum
    motions: tuple[str, ...] = ()  # procedural, with equal probability; empty: the scene's own
    clips: str | None = None  # folder of BVH and npz files, relative to the file
    clip_share: Share = 0.5  # share of episodes with a clip, if there are clips
    dusk: Share = 0.0  # share of episodes at dusk
    props: Share = 0.0  # share of episodes with props that suit the motion

    @model_validator(mode="after")
    def _least_before_most(self) -> EpisodesTable:
        if not 1 <= self.frames[0] <= self.frames[1] <= 10_000:
            raise ValueError("'frames' must be the minimum and the maximum, 1 to 10000")
        return self


class RecordTable(Strict):
    """Rendering quality and recorded data."""

    image_format: Literal["jpg", "png"] = "jpg"
    jpeg_quality: Whole = Field(default=95, ge=1, le=100)
    samples: Literal[0, 2, 4, 8] = 0  # multisample anti-aliasing
    face_size: Whole | None = Field(default=None, ge=16, le=4096)  # pixels; None: the image's own
    masks: Switch = True  # part labels
    depth: Switch = False
    shard_frames: Whole = Field(default=25, ge=1)


class Scene(Strict):
    """The content of a scene file."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,79}$")
    frames: Whole = Field(default=250, ge=1, le=1_000_000)
    fps: Number = Field(default=30.0, gt=0, le=240)
    seed: Whole = Field(default=1, ge=0, lt=2**63)
    rig: RigTable = RigTable()
    person: PersonTable = PersonTable()
    motion: MotionTable
    place: PlaceTable = PlaceTable()
    others: OthersTable = OthersTable()
    things: tuple[ThingTable, ...] = ()
    record: RecordTable = RecordTable()
    sensor: SensorTable | None = None  # None: perfect cameras
    episodes: EpisodesTable | None = None  # None: one sequence

    @model_validator(mode="after")
    def _episodes_draw_their_motions(self) -> Scene:
        if self.episodes is None:
            return self
        given = self.motion.model_dump(exclude_defaults=True)
        if self.episodes.motions and (unused := sorted(set(given) - {"name"})):
            raise ValueError(f"'{unused[0]}' of [motion] is unused with 'motions' of [episodes]")
        drawn = [key for key in ("start_s", "length_s") if key in given]
        if self.motion.name is not None and drawn:
            raise ValueError(f"'{drawn[0]}' of [motion] is drawn in [episodes]")
        return self

    @model_validator(mode="after")
    def _others_begin_in_time(self) -> Scene:
        accompanied = self.others.count or self.things or (self.episodes and self.episodes.props)
        if accompanied and self.sensor and -self.sensor.time_offset_s * self.fps > 1:
            raise ValueError(
                f"'time_offset_s' of [sensor] must be at least {-1 / self.fps:.4f} (a frame) with "
                f"[others], [[things]] or props, which begin with the first frame"
            )
        return self


def load_scene(path: Path) -> Scene:
    """Read a scene file and make its paths absolute. Raises FileError with the invalid key."""
    data = _with_absolute_paths(read_toml(path), path.resolve().parent)
    return checked(Scene, data, path)


def _with_absolute_paths(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    for table, key in (
        ("rig", "file"),
        ("motion", "file"),
        ("motion", "joint_names"),
        ("motion", "then"),
        ("episodes", "clips"),
        ("place", "textures"),
        ("place", "panorama"),
    ):
        section = data.get(table)
        if isinstance(section, dict) and isinstance(section.get(key), str):
            section[key] = str(folder / section[key])
    return data


def to_toml(scene: Scene) -> str:
    """A scene as TOML text that `load_scene` reads back to an equal scene."""
    data = scene.model_dump(mode="json", exclude_none=True)
    lines = [f"{key} = {_toml_value(v)}" for key, v in data.items() if not isinstance(v, dict)]
    for table, content in data.items():
        if isinstance(content, dict):
            lines += ["", f"[{table}]"]
            lines += [f"{key} = {_toml_value(v)}" for key, v in content.items()]
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + "".join(map(_toml_character, value)) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, dict):
        pairs = ", ".join(f"{_toml_value(k)} = {_toml_value(v)}" for k, v in value.items())
        return f"{{ {pairs} }}"
    return repr(value)


def _toml_character(c: str) -> str:
    if c in '"\\':
        return "\\" + c
    return c if c.isprintable() else f"\\U{ord(c):08x}"
