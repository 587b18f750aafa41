"""Reduced normal equations of a bundle adjustment over rays (numba, float64).

The points are eliminated (Schur complement); what is left are 6 x 6 blocks between keyframes that
see the same points. Source: Triggs et al., Bundle adjustment - a modern synthesis, 2000, section 6.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from egocap.odometry.ray_kernel import residual

NONE = -1
"""Row of a keyframe that is held fixed."""


@njit(cache=True, nogil=True)
def inverse3(A):
    """Inverse of a symmetric 3 x 3 matrix by cofactors."""
    a, b, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]
    p, q, s = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * p + b * q + c * s
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = p, q, s
    out[1, 0], out[1, 1], out[1, 2] = q, a * f - c * c, b * c - a * e
    out[2, 0], out[2, 1], out[2, 2] = s, b * c - a * e, a * d - b * b
    return out / det


@njit(cache=True, nogil=True)
def robust_cost(R, t, X, start, frame, o, b, inv_sigma, width):
    """Sum of the Geman-McClure losses of all observations; arguments as `reduced_system`."""
    r, J_pose, J_point = np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    c2, cost = width * width, 0.0
    for p in range(len(X)):
        for n in range(start[p], start[p + 1]):
            k = frame[n]
            residual(R[k], t[k], X[p], o[n], b[n], inv_sigma[n], r, J_pose, J_point)
            e2 = r[0] * r[0] + r[1] * r[1]
            cost += c2 * e2 / (c2 + e2)
    return cost


@njit(cache=True, nogil=True)
def reduced_system(R, t, X, start, frame, o, b, inv_sigma, width, row, slot, blocks, g, damping):
    """Add up the reduced system; returns what `back_substitute` needs for the points.

    R (K, 3, 3), t (K, 3): poses. X (P, 3): points; the observations of point p are those from
    start[p] to start[p + 1], each of keyframe `frame`, along ray b (N, 3) from o (N, 3).
    row (K,): row of a keyframe in the system, or NONE. slot (F, F): index of the block of two rows,
    for row <= column. blocks (B, 6, 6) and g (F, 6) are added to.
    """
    N, P = len(frame), len(X)
    W = np.zeros((N, 6, 3))
    V_inv, gp = np.zeros((P, 3, 3)), np.zeros((P, 3))
    r, Jc, Jp = np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    c2 = width * width
    for p in range(P):
        V = np.zeros((3, 3))
        for n in range(start[p], start[p + 1]):
            k = frame[n]
            if not residual(R[k], t[k], X[p], o[n], b[n], inv_sigma[n], r, Jc, Jp):
                continue
            e2 = r[0] * r[0] + r[1] * r[1]
            weight = (c2 / (c2 + e2)) ** 2
            for i in range(3):
                gp[p, i] += weight * (Jp[0, i] * r[0] + Jp[1, i] * r[1])
                for j in range(3):
                    V[i, j] += weight * (Jp[0, i] * Jp[0, j] + Jp[1, i] * Jp[1, j])
            f = row[k]
            if f == NONE:
                continue
            diagonal = slot[f, f]
            for i in range(6):
                g[f, i] += weight * (Jc[0, i] * r[0] + Jc[1, i] * r[1])
                for j in range(6):
                    blocks[diagonal, i, j] += weight * (Jc[0, i] * Jc[0, j] + Jc[1, i] * Jc[1, j])
                for j in range(3):
                    W[n, i, j] = weight * (Jc[0, i] * Jp[0, j] + Jc[1, i] * Jp[1, j])
        for i in range(3):
            V[i, i] += damping * V[i, i] + 1e-6
        V_inv[p] = inverse3(V)
        _eliminate(W, V_inv[p], gp[p], start[p], start[p + 1], frame, row, slot, blocks, g)
    return W, V_inv, gp


@njit(cache=True, nogil=True)
def _eliminate(W, V_inv, gp, first, last, frame, row, slot, blocks, g):
    """Subtract one point's part: W V^-1 W^T and W V^-1 g."""
    WV = np.empty((6, 3))
    for n in range(first, last):
        f = row[frame[n]]
        if f == NONE:
            continue
        for i in range(6):
            for j in range(3):
                WV[i, j] = (W[n, i, 0] * V_inv[0, j] + W[n, i, 1] * V_inv[1, j]
                            + W[n, i, 2] * V_inv[2, j])  # fmt: skip
            g[f, i] -= WV[i, 0] * gp[0] + WV[i, 1] * gp[1] + WV[i, 2] * gp[2]
        for m in range(first, last):
            h = row[frame[m]]
            if h < f:  # also when it is NONE
                continue
            B = blocks[slot[f, h]]
            for i in range(6):
                for j in range(6):
                    B[i, j] -= (WV[i, 0] * W[m, j, 0] + WV[i, 1] * W[m, j, 1]
                                + WV[i, 2] * W[m, j, 2])  # fmt: skip


@njit(cache=True, nogil=True)
def back_substitute(X, start, frame, row, W, V_inv, gp, step):
    """Points (P, 3) after the keyframes' step (F, 6)."""
    moved = np.empty_like(X)
    for p in range(len(X)):
        rest = -gp[p]
        for n in range(start[p], start[p + 1]):
            f = row[frame[n]]
            if f == NONE:
                continue
            for j in range(3):
                for i in range(6):
                    rest[j] -= W[n, i, j] * step[f, i]
        for j in range(3):
            moved[p, j] = X[p, j] + (V_inv[p, j, 0] * rest[0] + V_inv[p, j, 1] * rest[1]
                                     + V_inv[p, j, 2] * rest[2])  # fmt: skip
    return moved


@njit(cache=True, nogil=True)
def pair_slots(start, frame, row, slot):
    """Number the blocks of keyframes that share a point into `slot` (F, F, filled with NONE)."""
    count = 0
    for p in range(len(start) - 1):
        for n in range(start[p], start[p + 1]):
            f = row[frame[n]]
            for m in range(start[p], start[p + 1]):
                h = row[frame[m]]
                if f != NONE and h >= f and slot[f, h] == NONE:
                    slot[f, h] = count
                    count += 1
    return count
