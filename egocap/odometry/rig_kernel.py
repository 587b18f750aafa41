"""Normal equations of poses, a rig and points together (numba, float64).

Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def joint_equations(r, J, J_point, weight, frame, point, frames, points):
    """H (S, S), g (S,) of the poses and the rig; W (P, 3, S), V (P, 3, 3), g (P, 3) of the points.

    r (N, 2): residuals; J (N, 2, 6 + Q): their derivatives by the pose of their `frame` and by the
    rig, J_point (N, 2, 3) by their `point`; weight (N,). S is 6 * frames + Q.
    """
    N, _, n = J.shape
    size = 6 * frames + n - 6
    H, g = np.zeros((size, size)), np.zeros(size)
    W, V, g_point = np.zeros((points, 3, size)), np.zeros((points, 3, 3)), np.zeros((points, 3))
    at = np.empty(n, np.int64)
    at[6:] = np.arange(6 * frames, size)
    for i in range(N):
        at[:6] = 6 * frame[i] + np.arange(6)
        p = point[i]
        for row in range(2):
            own, by_point = J[i, row], J_point[i, row]
            for c in range(3):
                scaled = weight[i] * by_point[c]
                g_point[p, c] += scaled * r[i, row]
                for d in range(3):
                    V[p, c, d] += scaled * by_point[d]
                for a in range(n):
                    W[p, c, at[a]] += scaled * own[a]
            for a in range(n):
                scaled = weight[i] * own[a]
                g[at[a]] += scaled * r[i, row]
                for b in range(a + 1):
                    H[at[a], at[b]] += scaled * own[b]
    for a in range(size):
        for b in range(a):
            H[b, a] = H[a, b]
    return H, g, W, V, g_point
