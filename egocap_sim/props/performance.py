"""The wearer's bodies in every frame and the parameters of the motion, for fitting props."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline

from egocap_sim.core.rng import make_rng
from egocap_sim.human.body.person import Person
from egocap_sim.motion.generators.registry import motion_parameters
from egocap_sim.motion.retarget.palms import Palm, find_palm
from egocap_sim.scene.config import MotionTable


@dataclass(frozen=True, eq=False)
class Performance:
    """A wearer's recorded motion, and the settings that produced it."""

    person: Person
    motion: MotionTable
    seed: int
    times: Float[Array, "T"]  # seconds since the first frame
    bodies: Float[Array, "T 21 4 4"]

    @property
    def start_s(self) -> float:
        """Time of the first frame in the motion (s)."""
        return self.motion.start_s

    @property
    def parameters(self) -> Any:
        """Parameters of the built-in motion."""
        assert self.motion.name is not None
        return motion_parameters(self.motion.name, self.motion.parameters)

    @property
    def rng(self) -> np.random.Generator:
        """The random generator of the motion in its initial state."""
        return make_rng(self.seed, "motion")

    @cached_property
    def palms(self) -> tuple[Palm, Palm]:
        """The left and the right palm."""
        return find_palm(self.person, "l"), find_palm(self.person, "r")

    @property
    def palm_paths(self) -> tuple[Float[Array, "T 3"], Float[Array, "T 3"]]:
        """World paths of the centres of the left and the right palm."""
        left, right = (self.held(hand, palm.centre) for hand, palm in enumerate(self.palms))
        return left, right

    def held(self, hand: int, offset: Float[Array, "3"]) -> Float[Array, "T 3"]:
        """World path of a point fixed to a hand (0 left), given in the hand body's frame."""
        T = self.bodies[:, self.palms[hand].body]
        return T[:, :3, :3] @ offset + T[:, :3, 3]

    def held_at(
        self, hand: int, offset: Float[Array, "3"], times: Float[Array, "*n"], period_s: float
    ) -> Float[Array, "*n 3"]:
        """Like `held`, interpolated at any times.

        Outside the recording the motion is continued periodically relative to the pelvis.
        """
        times = np.asarray(times, float)
        last = float(self.times[-1])
        before, after = np.ceil(-times / period_s), np.ceil((times - last) / period_s)
        turns = np.where(times < 0, before, np.where(times > last, -after, 0.0))
        known = np.clip(times + turns * period_s, 0.0, last)
        if len(self.times) < 4:
            return np.broadcast_to(self.held(hand, offset)[0], (*times.shape, 3)).copy()
        pelvis = CubicSpline(self.times, self.bodies[:, 0, :3, 3])
        point = CubicSpline(self.times, self.held(hand, offset))
        here = pelvis(np.clip(times, 0.0, last))
        return point(known) - pelvis(known) + here
