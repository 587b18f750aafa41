"""Motion in the world: a solved motion and head poses in; both, with contacts and the ground, out.

Contact probabilities come from the motion (`egocap.world.contact_network`); points that it places
off the ground lose theirs. The interval energy is then minimised with the terms of
`egocap.world.contact_energy`, over the angles and small corrections of the head poses. This is
repeated while the allowed speed of a planted point shrinks (graduated non-convexity); before each
round the ground is learned again from the feet that stand, and points that still slide are let go.

Source: Blake & Zisserman 1987, "Visual Reconstruction".
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT
from egocap.data.head_pose import HeadPoses
from egocap.pose.banded import banded_inverse
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.motion_prior import MotionPrediction
from egocap.pose.observations import Observations
from egocap.track.smoother import BandedSystem, interval_system, minimise, windows
from egocap.world.contact_energy import ContactTerms, contact_system, widen
from egocap.world.foot_points import SOLE_M, STATE, FootPoints, correct
from egocap.world.ground import UNEVEN_M, Ground, footholds

_ROUNDS = (0.3, 0.1, 0.03)
"""Standard deviation of a planted point's speed in each round, m/s."""
_HEIGHT_M, _SINK_M = 0.01, 0.004
"""Standard deviations of a planted point's height above the ground, and of a depth below it."""
_HEIGHT_TAIL_M = 0.05  # planted points farther than this from the ground are outliers
_LEAST = 0.1  # contact probability below which a point is free
_TRAVELS = 1.5  # speed of a point, m/s, at which its contact is half as probable
_SLIDES = 40.0
"""Speed of a planted point, in the round's deviations, at which it holds half as firmly: it
slides."""
_LONGEST_S = 0.2  # between frames of one contact
_HEAD_CORRELATION_S = 1.0


@dataclass(frozen=True, eq=False)
class WorldSolution:
    """The motion of all frames in the world."""

    state: Float[Array, "T 43"]  # the angles, and the corrections of the head poses
    T_world_head: Float[Array, "T 4 4"]
    converged: Bool[Array, "T"]
    ground: Ground
    contacts: Float[Array, "T 4"]  # probabilities, given the heights
    terms: ContactTerms  # of the last round

    @property
    def angles(self) -> Float[Array, "T 37"]:
        """Joint angles, rad."""
        return self.state[:, :DOF_COUNT]


@dataclass(frozen=True, eq=False)
class WorldSolver:
    """Solves the motion of one recording in the world, from a motion in the head frame."""

    proportions: Proportions
    model: Model
    config: TrackerConfig
    observations: Observations
    prediction: MotionPrediction
    heads: HeadPoses

    def solve(
        self, angles: Float[Array, "T 37"], contacts: Float[Array, "T 4"],
        spread: Float[Array, "T 4"],
    ) -> WorldSolution:  # fmt: skip
        """The motion that detections, priors, head poses and contacts agree on.

        `contacts` are the contact probabilities, `spread` the standard deviations of the points'
        heights [m] without them.
        """
        feet = FootPoints.of(self.proportions)
        state = np.concatenate([angles, np.zeros((len(angles), STATE - DOF_COUNT))], 1)
        converged, terms = np.ones(len(angles), bool), None
        points, _ = feet.in_world(state, self.heads.T_world_head)
        slow = self._slow(points)
        ground = self._ground(points, self._probable(slow * contacts), spread)
        contacts, firm = self._on_ground(points, ground, contacts, spread)
        probable = self._probable(slow * contacts)
        for speed in _ROUNDS:
            ground, terms = self._terms(state, feet, probable, spread, firm, speed)
            state, converged = self._minimise(state, feet, terms)
        assert terms is not None
        poses = correct(self.heads.T_world_head, state[:, DOF_COUNT:], self.heads.known)
        return WorldSolution(state, poses, converged, ground, contacts, terms)

    def covariances(
        self, solution: WorldSolution, independent: Observations,
        independent_prediction: MotionPrediction,
    ) -> Float[Array, "T 37 37"]:  # fmt: skip
        """Covariances of the angles, rad^2, from the information of independent frames.

        `independent` and `independent_prediction` are the observations and the prediction with it.
        """
        solver = replace(self, observations=independent, prediction=independent_prediction)
        feet = FootPoints.of(self.proportions)
        found = np.empty((len(solution.state), DOF_COUNT, DOF_COUNT))
        for kept, window, within in windows(len(solution.state)):
            _, bands, _ = solver._system(solution.state[window], window, feet, solution.terms)
            inverse = banded_inverse(bands, STATE)
            found[kept] = inverse[within, :DOF_COUNT, :DOF_COUNT]
        return found

    def _slow(self, points: Float[Array, "T 4 3"]) -> Float[Array, "T 4"]:
        """Factor of the contact probabilities: a point that travels does not stand."""
        if len(points) < 2:
            return np.ones((len(points), 4))
        speed = np.linalg.norm(np.gradient(points, self.observations.times, axis=0), axis=-1)
        return 1.0 / (1.0 + np.square(speed / _TRAVELS))

    def _on_ground(
        self, points: Float[Array, "T 4 3"], ground: Ground, contacts: Float[Array, "T 4"],
        spread: Float[Array, "T 4"],
    ) -> tuple[Float[Array, "T 4"], Float[Array, "T 4"]]:  # fmt: skip
        """Contact probabilities given the heights without contacts, and how firm the ground is.

        The odds fall as the likelihood of the height does from its value on the ground. Ground that
        points are seen to be below, as on a ladder, is not there for them, unless it is the floor.
        """
        height = ground.height(points[..., :2])
        off = points[..., 2] - SOLE_M - height
        likelihood = np.exp(-0.5 * off**2 / (spread**2 + UNEVEN_M**2 + _HEIGHT_M**2))
        likely = contacts * likelihood
        floor = (height < 2.0 * UNEVEN_M) & (self.heads.floor_std is not None)
        firm = np.where((off > 0.0) | floor, 1.0, likelihood)
        return likely / np.maximum(likely + 1.0 - contacts, 1e-9), firm

    def _probable(self, contacts: Float[Array, "T 4"]) -> Float[Array, "T 4"]:
        """The contact probabilities; 0 where they are small, or the head pose is not known."""
        return np.where((contacts >= _LEAST) & self.heads.known[:, None], contacts, 0.0)

    def _ground(
        self, points: Float[Array, "T 4 3"], probable: Float[Array, "T 4"],
        spread: Float[Array, "T 4"],
    ) -> Ground:  # fmt: skip
        """The ground where points touch."""
        found, floor = footholds(points, probable, spread, SOLE_M), self.heads.floor_std
        return Ground.learn(found if floor is None else found.on_floor(floor))

    def _terms(
        self, state: Float[Array, "T 43"], feet: FootPoints, probable: Float[Array, "T 4"],
        spread: Float[Array, "T 4"], firm: Float[Array, "T 4"], speed: float,
    ) -> tuple[Ground, ContactTerms]:  # fmt: skip
        """The ground, and what the contacts ask for, at a motion."""
        points, _ = feet.in_world(state, self.heads.T_world_head)
        ground = self._ground(points, probable, spread)
        known, steps = self.heads.known, np.diff(self.observations.times)
        slide = np.sqrt(probable[1:] * probable[:-1]) * (steps <= _LONGEST_S)[:, None]
        moving = np.linalg.norm(np.diff(points, axis=0), axis=-1) / steps[:, None]
        slide = slide / (1.0 + np.square(moving / (_SLIDES * speed)))
        height = ground.height(points[..., :2])
        off = points[..., 2] - SOLE_M - height
        near = ground.known(points[..., :2]) & known[:, None]
        planted = np.sqrt(probable / (1.0 + np.square(off / _HEIGHT_TAIL_M))) * near
        keep = np.exp(-steps / _HEAD_CORRELATION_S)
        sigma = np.repeat([self.config.head_turn_sigma, self.config.head_shift_sigma], 3)
        return ground, ContactTerms(
            self.heads.T_world_head, slide / (speed * steps[:, None]), planted / _HEIGHT_M,
            near * firm / _SINK_M, height, keep, sigma,
        )  # fmt: skip

    def _minimise(
        self, state: Float[Array, "T 43"], feet: FootPoints, terms: ContactTerms
    ) -> tuple[Float[Array, "T 43"], Bool[Array, "T"]]:
        refined, converged = state.copy(), np.zeros(len(state), bool)
        for kept, window, within in windows(len(state)):

            def system(trial: Float[Array, "T 43"], window: slice = window) -> BandedSystem:
                return self._system(trial, window, feet, terms)

            solved, done, _ = minimise(
                state[window], system, self.config.max_iterations, self.config.tolerance
            )
            refined[kept], converged[kept] = solved[within], done[within]
        return refined, converged

    def _system(
        self, state: Float[Array, "T 43"], window: slice, feet: FootPoints, terms: ContactTerms
    ) -> BandedSystem:
        """Energy of a window, its Gauss-Newton matrix and gradient."""
        energy, bands, gradient = interval_system(
            state[:, :DOF_COUNT], self.observations[window], self.model, self.config,
            self.prediction[window],
        )  # fmt: skip
        more, wide, slope = contact_system(state, feet, terms[window])
        slope = slope.reshape(state.shape)
        slope[:, :DOF_COUNT] += gradient.reshape(len(state), DOF_COUNT)
        return energy + more, np.asfortranarray(wide + widen(bands)), slope.ravel()
