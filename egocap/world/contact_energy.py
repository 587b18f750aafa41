"""Energy of contacts and of head poses: planted points stay, lie on the ground, and nothing sinks.

Residuals are in standard deviations. What does not change within a solution (the frames' weights,
the heights of the ground under the points) is in `ContactTerms`; the state of a frame is 37 angles
and the correction of the head pose. The head's error is a stationary first-order process.

Source: Hassan et al. 2021, "Stochastic scene-aware motion prediction", and Rempe et al. 2021,
"HuMoR", section 4, for contact terms of this kind; Gauss-Newton: Nocedal & Wright, section 10.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT
from egocap.world.foot_points import CORRECTION, SOLE_M, STATE, FootPoints

BAND = 2 * STATE


@dataclass(frozen=True, eq=False)
class ContactTerms:
    """What the contacts of a motion ask for."""

    T_world_head: Float[Array, "T 4 4"]  # as given
    slide: Float[Array, "T-1 4"]  # inverse deviation of the way between frames, 1/m
    height: Float[Array, "T 4"]  # inverse deviation of the height of planted points, 1/m
    sink: Float[Array, "T 4"]  # inverse deviation of a depth below the ground, 1/m
    ground: Float[Array, "T 4"]  # height of the ground under every point, m
    keep: Float[Array, "T-1"]  # correlation of the head's error with that of the next frame
    head_sigma: Float[Array, "6"]  # of the head's error: rad, m

    def __getitem__(self, frames: slice) -> ContactTerms:
        """Those of some frames."""
        first, last, _ = frames.indices(len(self.T_world_head))
        between = slice(first, max(last - 1, first))
        return ContactTerms(
            self.T_world_head[frames], self.slide[between], self.height[frames],
            self.sink[frames], self.ground[frames], self.keep[between], self.head_sigma,
        )  # fmt: skip


def contact_system(
    state: Float[Array, "T 43"], feet: FootPoints, terms: ContactTerms
) -> tuple[float, Float[Array, "87 N"], Float[Array, "N"]]:
    """Energy, Gauss-Newton matrix as LAPACK's lower band, and gradient."""
    points, J = feet.in_world(state, terms.T_world_head)
    diagonal = np.zeros((len(state), STATE, STATE))
    below = np.zeros((max(len(state) - 1, 0), STATE, STATE))  # of frame t + 1 with frame t
    gradient = np.zeros_like(state)
    energy = _heights(points, J, terms, diagonal, gradient)
    energy += _slides(points, J, terms, diagonal, below, gradient)
    energy += _heads(state[:, DOF_COUNT:], terms, diagonal, below, gradient)
    return energy, _bands(diagonal, below), gradient.ravel()


def _heights(
    points: Float[Array, "T 4 3"], J: Float[Array, "T 4 3 43"], terms: ContactTerms,
    diagonal: Float[Array, "T 43 43"], gradient: Float[Array, "T 43"],
) -> float:  # fmt: skip
    """Planted points on the ground, and no point below it."""
    above = points[..., 2] - terms.ground - SOLE_M
    weight = terms.height**2 + np.where(above < 0.0, terms.sink**2, 0.0)
    up = J[..., 2, :]
    gradient += np.einsum("tk,tkd->td", weight * above, up)
    diagonal += np.einsum("tk,tkd,tke->tde", weight, up, up, optimize=True)
    return float(0.5 * np.sum(weight * above**2))


def _slides(
    points: Float[Array, "T 4 3"], J: Float[Array, "T 4 3 43"], terms: ContactTerms,
    diagonal: Float[Array, "T 43 43"], below: Float[Array, "T-1 43 43"],
    gradient: Float[Array, "T 43"],
) -> float:  # fmt: skip
    """Planted points stay where they are."""
    way = np.diff(points, axis=0)
    weight = terms.slide**2
    pull = weight[..., None] * way
    first, second = J[:-1], J[1:]
    gradient[:-1] -= np.einsum("tki,tkid->td", pull, first)
    gradient[1:] += np.einsum("tki,tkid->td", pull, second)
    scaled = weight[..., None, None] * J[1:]
    diagonal[1:] += _product(scaled, second)
    below -= _product(scaled, first)
    diagonal[:-1] += _product(weight[..., None, None] * first, first)
    return float(0.5 * np.sum(weight * np.square(way).sum(-1)))


def _product(a: Float[Array, "T 4 3 43"], b: Float[Array, "T 4 3 43"]) -> Float[Array, "T 43 43"]:
    """Sum over points and axes of the outer products of their derivatives."""
    flat = (len(a), -1, STATE)
    return np.swapaxes(a.reshape(flat), 1, 2) @ b.reshape(flat)


def _heads(
    correction: Float[Array, "T 6"], terms: ContactTerms, diagonal: Float[Array, "T 43 43"],
    below: Float[Array, "T-1 43 43"], gradient: Float[Array, "T 43"],
) -> float:  # fmt: skip
    """The head poses' errors: each frame's is `keep` of the last one's, and a new part."""
    own, keep = np.arange(DOF_COUNT, STATE), terms.keep[:, None]
    precision = 1.0 / terms.head_sigma**2
    fresh = precision / (1.0 - keep**2)
    left = correction[1:] - keep * correction[:-1]
    diagonal[0, own, own] += precision
    gradient[0, own] += precision * correction[0]
    diagonal[1:, own, own] += fresh
    diagonal[:-1, own, own] += keep**2 * fresh
    below[:, own, own] -= keep * fresh
    gradient[1:, own] += fresh * left
    gradient[:-1, own] -= keep * fresh * left
    assert correction.shape[1] == CORRECTION
    return float(0.5 * (precision * correction[0] ** 2).sum() + 0.5 * (fresh * left**2).sum())


def _bands(
    diagonal: Float[Array, "T 43 43"], below: Float[Array, "T-1 43 43"]
) -> Float[Array, "87 N"]:
    """Blocks on and below the diagonal as a lower band, in Fortran's order."""
    bands = np.zeros((BAND + 1, len(diagonal) * STATE), order="F")
    _fill(diagonal, below, bands)
    return bands


@njit(cache=True, nogil=True)
def _fill(diagonal, below, bands):
    for frame in range(len(diagonal)):
        for column in range(STATE):
            at = frame * STATE + column
            for row in range(column, STATE):
                bands[row - column, at] = diagonal[frame, row, column]
            if frame < len(below):
                for row in range(STATE):
                    bands[STATE + row - column, at] = below[frame, row, column]


def widen(bands: Float[Array, "75 M"]) -> Float[Array, "87 N"]:
    """The band of the angles' system as that of states with a head pose, in Fortran's order."""
    wide = np.zeros((BAND + 1, bands.shape[1] // DOF_COUNT * STATE), order="F")
    _widen(bands, wide)
    return wide


@njit(cache=True, nogil=True)
def _widen(bands, wide):
    for unknown in range(bands.shape[1]):
        frame, column = divmod(unknown, DOF_COUNT)
        for k in range(len(bands)):
            later = (k + column) // DOF_COUNT  # frames between row and column
            wide[k + CORRECTION * later, frame * STATE + column] = bands[k, unknown]
