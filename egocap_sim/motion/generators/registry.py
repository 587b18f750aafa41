"""Built-in procedural motions: the table `MOTIONS`, and `make_motion`.

All are canonical clips on the standard figure (`figure`), in metres, with the floor at z = 0.
Standing motions start and end in the neutral stance at the origin, facing +x, so that `sequence`
can join them.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from egocap.errors import InputError
from egocap_sim.motion.clips.editing import concatenate
from egocap_sim.motion.generators.ball_handling import DribbleParams, JuggleParams, dribble, juggle
from egocap_sim.motion.generators.cycling import CycleParams, cycle, fit_rider
from egocap_sim.motion.generators.gestures import GESTURES, GestureParams, gesticulate
from egocap_sim.motion.generators.keyframes import PaceParams
from egocap_sim.motion.generators.postures import (
    GuidedParams,
    IdleParams,
    LookParams,
    SitParams,
    SquatParams,
    guided,
    idle,
    look_around,
    sit,
    squat,
)  # fmt: skip
from egocap_sim.motion.generators.random_poses import PosesParams, poses
from egocap_sim.motion.generators.stairs import StairsParams, fit_climber, stairs
from egocap_sim.motion.generators.tasks import (
    DeskParams,
    HoldParams,
    WorkParams,
    desk,
    handshake,
    hold,
    work,
)  # fmt: skip
from egocap_sim.motion.generators.walk import WalkParams, walk
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.retarget.retarget import Reference

PART_S = 4.5  # least seconds per part of a sequence
USUAL_PARTS = ("walk", "gestures", "look_around", "squat", "sit")


@dataclass(frozen=True)
class SequenceParams:
    """Several motions, one after another."""

    parts: tuple[str, ...] = ()
    """Names of motions of equal duration; empty: the usual ones, as many as fit."""


@dataclass(frozen=True)
class Motion:
    """A built-in motion: its generator function, parameter type and default parameters."""

    make: Callable[..., Clip]  # (times, rng, params, fps)
    params: type
    about: str
    defaults: dict[str, Any] = dataclasses.field(default_factory=dict)
    mounted: Callable[..., Reference] | None = None
    """For motions on a bicycle or staircase: (reference, person, rng, params) moves a person's
    hands and feet to their supports; `rng` has the state from before the motion was made."""


def _sequence(t: np.ndarray, rng: np.random.Generator, params: SequenceParams, fps: float) -> Clip:
    others = [m for m, motion in MOTIONS.items() if m != "sequence" and not motion.mounted]
    for part in params.parts:
        if part not in others:
            raise InputError(f"unknown part '{part}'", valid=others)
    room = max(int((t[-1] + 0.5 / fps) / PART_S), 1)
    if len(params.parts) > room:
        raise InputError(f"{len(params.parts)} parts in {t[-1]:.3g} s", valid=f"{room} or fewer")
    parts = params.parts or USUAL_PARTS[:room]
    edges = np.linspace(0, len(t) - 1, len(parts) + 1).round().astype(int)
    clips = [
        _make(MOTIONS[part], int(b - a) + 1, rng, fps, {})
        for part, a, b in zip(parts, edges[:-1], edges[1:], strict=True)
    ]
    return concatenate("sequence", clips)


MOTIONS: dict[str, Motion] = {
    "walk": Motion(walk, WalkParams, "walk along a winding way inside a circle"),
    "gestures": Motion(gesticulate, GestureParams, "gestures and reaches of all kinds, standing"),
    "squat": Motion(squat, SquatParams, "squats"),
    "sit": Motion(sit, SitParams, "sit down onto an implied seat and stand up"),
    "look_around": Motion(look_around, LookParams, "look at one thing after another"),
    "guided": Motion(guided, GuidedParams, "the moves that fit-rig asks for, standing"),
    "idle": Motion(idle, IdleParams, "stand, breathe, shift weight"),
    "dribble": Motion(dribble, DribbleParams, "dribble a ball while walking about"),
    "cycle": Motion(cycle, CycleParams, "ride a bicycle around", mounted=fit_rider),
    "hold": Motion(hold, HoldParams, "use a phone, a cup or a newspaper, standing"),
    "desk": Motion(desk, DeskParams, "sit at a desk: type, use a mouse, write"),
    "handshake": Motion(handshake, PaceParams, "shake hands, standing"),
    "work": Motion(work, WorkParams, "work with both hands at a counter, standing"),
    "poses": Motion(poses, PosesParams, "random poses within reach, one after another"),
    "stairs": Motion(stairs, StairsParams, "walk up and down a staircase", mounted=fit_climber),
    "juggle": Motion(juggle, JuggleParams, "juggle three balls, standing"),
    "sequence": Motion(_sequence, SequenceParams, "several motions, one after another"),
} | {
    name: Motion(
        gesticulate, GestureParams, (make.__doc__ or "").split("\n")[0], {"kinds": (name,)}
    )
    for name, make in GESTURES.items()
}
"""Every built-in motion by name."""


def make_motion(
    name: str, duration_s: float, rng: np.random.Generator, fps: float = 60.0, /, **params: Any
) -> Clip:
    """Make a built-in motion of `duration_s` seconds; `rng` draws style and choices.

    `params` are fields of the motion's parameter class (`MOTIONS[name].params`). Raises InputError
    for an unknown motion or parameter or an impossible value, listing what is valid.
    """
    if name not in MOTIONS:
        raise InputError(f"unknown motion '{name}'", valid=MOTIONS)
    if not (np.isfinite(duration_s) and 0.5 <= duration_s <= 3600.0):
        raise InputError(f"a motion of {duration_s} s", valid="0.5 to 3600 s")
    if not (np.isfinite(fps) and 10.0 <= fps <= 1000.0):
        raise InputError(f"{fps} frames per second", valid="10 to 1000")
    frames = round(duration_s * fps) + 1
    clip = _make(MOTIONS[name], frames, rng, fps, params)
    return dataclasses.replace(clip, name=name)


def _make(
    motion: Motion, frames: int, rng: np.random.Generator, fps: float, params: dict[str, Any]
) -> Clip:
    t = np.arange(frames) / fps
    return motion.make(t, rng, _parameters(motion, params), fps)


def motion_parameters(name: str, params: dict[str, Any]) -> Any:
    """The validated parameters of a built-in motion."""
    return _parameters(MOTIONS[name], params)


def _parameters(motion: Motion, params: dict[str, Any]) -> Any:
    hints = typing.get_type_hints(motion.params, include_extras=True)
    for key, value in params.items():
        if key not in hints:
            raise InputError(f"unknown parameter '{key}'", valid=hints or "none")
        params = params | {key: _checked(key, value, hints[key])}
    return motion.params(**(motion.defaults | params))


def _checked(key: str, value: Any, hint: Any) -> Any:
    """Validate a value of an annotated field: numbers by range, names by membership."""
    kind: Any = hint
    valid: Any = None
    if typing.get_origin(hint) is Annotated:
        kind, valid = typing.get_args(hint)
    if kind is float:
        low, high = valid
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not low <= value <= high:
            raise InputError(f"{key} is {value!r}", valid=f"{low:g} to {high:g}")
        return float(value)
    if kind is bool:
        if not isinstance(value, bool):
            raise InputError(f"{key} is {value!r}", valid="a bool")
        return value
    if kind is str:
        if value not in valid:
            raise InputError(f"{key} is {value!r}", valid=valid)
        return value
    if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
        raise InputError(f"{key} is {value!r}", valid="a list of names")
    if unknown := [v for v in value if valid is not None and v not in valid]:
        raise InputError(f"unknown name '{unknown[0]}' in {key}", valid=valid)
    return tuple(value)
