"""Rays that meet the posed Gaussians as spheres, and the energy of tracked points, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from egocap.body.kinematics import forward_kinematics
from egocap.image_model.body_kernel import pose


@njit(cache=True, nogil=True)
def first_hit(eyes, centres, radius, core, view, ray, depth, which):
    """Output: depth, inf without a hit, and the Gaussian."""
    for i in range(len(view)):
        depth[i], which[i] = np.inf, 0
        eye, d = eyes[view[i]], ray[i]
        for q in range(len(radius)):
            x, y, z = centres[q, 0] - eye[0], centres[q, 1] - eye[1], centres[q, 2] - eye[2]
            middle = x * d[0] + y * d[1] + z * d[2]
            across = x * x + y * y + z * z - middle * middle
            squared = radius[q] * radius[q]
            if middle <= 0.0 or across > core * core * squared:
                continue
            near = middle - np.sqrt(squared - across)
            if near < depth[i]:
                depth[i], which[i] = near, q


@njit(cache=True, nogil=True)
def points_energy(chain, angles, eyes, view, joint, offset, ray, weight, sigma, H, g):
    """Sum of weight (sqrt(1 + |r|^2) - 1), r being the difference of unit rays over sigma."""
    origins, axes = np.empty((len(chain.parents), 3)), np.empty((len(angles), 3))
    R = np.empty((len(origins), 3, 3))
    forward_kinematics(chain, angles, origins, axes, R)
    J, which = np.empty((len(angles), 3)), np.empty(len(angles), np.int64)
    x, d, r = np.empty(3), np.empty(3), np.empty(3)
    energy = 0.0
    for i in range(len(view)):
        eye, carrier = eyes[view[i]], joint[i]
        for a in range(3):
            x[a] = origins[carrier, a]
            for b in range(3):
                x[a] += R[carrier, a, b] * offset[i, b]
            d[a] = x[a] - eye[a]
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        scale, squared = 1.0 / (length * sigma), 0.0
        for a in range(3):
            d[a] /= length
            r[a] = (d[a] - ray[i, a]) / sigma
            squared += r[a] * r[a]
        root = np.sqrt(1.0 + squared)
        energy += weight[i] * (root - 1.0)
        gain, count, j = weight[i] / root, 0, carrier
        while j >= 0:
            o = origins[j]
            for k in range(chain.first_dof[j], chain.first_dof[j + 1]):
                ax = axes[k]
                vx = ax[1] * (x[2] - o[2]) - ax[2] * (x[1] - o[1])
                vy = ax[2] * (x[0] - o[0]) - ax[0] * (x[2] - o[2])
                vz = ax[0] * (x[1] - o[1]) - ax[1] * (x[0] - o[0])
                along = vx * d[0] + vy * d[1] + vz * d[2]
                J[count, 0] = (vx - along * d[0]) * scale
                J[count, 1] = (vy - along * d[1]) * scale
                J[count, 2] = (vz - along * d[2]) * scale
                which[count] = k
                count += 1
            j = chain.parents[j]
        for p in range(count):
            g[which[p]] += gain * (J[p, 0] * r[0] + J[p, 1] * r[1] + J[p, 2] * r[2])
            for q in range(count):
                H[which[p], which[q]] += gain * (
                    J[p, 0] * J[q, 0] + J[p, 1] * J[q, 1] + J[p, 2] * J[q, 2]
                )
    return energy


@njit(cache=True, nogil=True)
def moved_centres(chain, angles, which, centres):
    """Output: centres (N, A, 3) of some Gaussians in every pose (N, 37)."""
    origins, axes = np.empty((len(chain.parents), 3)), np.empty((angles.shape[1], 3))
    every = np.empty((len(chain.carrier), 3))
    for i in range(len(angles)):
        pose(chain, angles[i], origins, axes, every)
        for a in range(len(which)):
            centres[i, a] = every[which[a]]


@njit(cache=True, nogil=True)
def limb_costs(eyes, pixels, width, centres, which, radius, index, direction, unlike, behind,
               depth, costs):  # fmt: skip
    """Output: what every pose (N,) of a limb changes of the rays' dissimilarities, summed.

    The limb is drawn as the nearest of its spheres along each ray, where it lies before the `depth`
    of the rest of the body; there `unlike` (G, P) takes the place of `behind` (P,). Spheres are
    looked for within `width` (V, N, A) of the `pixels` (V, N, A, 2) of their centres; `index`
    (V, H, W) has the rays of the pixels, -1 for none.
    """
    drawn, nearest, change = np.full(len(depth), -1), np.empty(len(depth)), np.empty(len(depth))
    touched = np.empty(len(depth), np.int64)
    views, height, across = index.shape
    for i in range(len(costs)):
        count = 0
        for v in range(views):
            for a in range(len(which)):
                u, w, h = pixels[v, i, a, 0], pixels[v, i, a, 1], width[v, i, a]
                if not np.isfinite(u):
                    continue
                x = centres[i, a, 0] - eyes[v, 0]
                y = centres[i, a, 1] - eyes[v, 1]
                z = centres[i, a, 2] - eyes[v, 2]
                length2, radius2 = x * x + y * y + z * z, radius[a] * radius[a]
                for row in range(max(0, int(np.ceil(w - h))), min(height, int(w + h) + 1)):
                    for column in range(max(0, int(np.ceil(u - h))), min(across, int(u + h) + 1)):
                        p = index[v, row, column]
                        if p < 0:
                            continue
                        d = direction[p]
                        middle = x * d[0] + y * d[1] + z * d[2]
                        beside = length2 - middle * middle
                        if middle <= 0.0 or beside > radius2:
                            continue
                        near = middle - np.sqrt(radius2 - beside)
                        if near >= depth[p]:
                            continue
                        if drawn[p] != i:
                            drawn[p], touched[count] = i, p
                            count += 1
                        elif near >= nearest[p]:
                            continue
                        nearest[p], change[p] = near, unlike[which[a], p] - behind[p]
        costs[i] = 0.0
        for k in range(count):
            costs[i] += change[touched[k]]
