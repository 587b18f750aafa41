"""The colour energy of all views with its gradient and Gauss-Newton matrix, compiled, parallel.

`egocap.image_model.model` calls it. A pose costs, in order: forward kinematics; a list of the
Gaussians near each tile of 8 x 8 pixels, by comparing cones; then every ray on its own, over the
Gaussians of its tile that it passes within their reach. Rays that meet none are done at once. The
compiled code is cached on disk; sizes, settings and body are arguments, so that nothing compiles
again.

Gauss-Newton: the energy of a ray lies in [-1, 1], so that 1 + e is a square r^2, and
sum e + const = sum r^2. With J the ray's gradient, its Gauss-Newton matrix 2 (dr)(dr)^T is
J J^T / (2 (1 + e)), held finite where a ray already fits.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from egocap.image_model.body_kernel import add_force, angle_derivatives, pose
from egocap.image_model.kernel_arrays import Posed, Thread, thread_scratch
from egocap.image_model.ray_kernel import (
    FAST,
    RAY_CODE,
    compare_colours,
    find_near,
    look_up_colours,
    ray_energy,
    ray_step,
    ray_visibility,
)

BLOCK = 32
"""Rays that a thread takes at a time."""
FLAT = 1e-4
"""Derivatives of a ray's energy below this, per radian, do not enter the Gauss-Newton matrix."""
FIT_FLOOR = 0.05
"""Least 1 + e that the Gauss-Newton matrix divides by."""
PARALLEL = {"cache": True, "parallel": True, "fastmath": FAST, "error_model": "numpy"}
SERIAL = {"cache": True, "fastmath": FAST, "error_model": "numpy", "_nrt": False}


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _cones(centres, origins, reach, arms, cones):
    """Gaussians as seen from every view: arm (V, G, 3); direction, cos and sin of the cone's angle.

    A cone of cos -2 holds every direction: the camera is within the Gaussian's reach.
    """
    for v in range(len(origins)):
        for q in range(len(centres)):
            x = centres[q, 0] - origins[v, 0]
            y = centres[q, 1] - origins[v, 1]
            z = centres[q, 2] - origins[v, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            arms[v, q, 0], arms[v, q, 1], arms[v, q, 2] = x, y, z
            cones[v, 0, q] = x / max(distance, 1e-6)
            cones[v, 1, q] = y / max(distance, 1e-6)
            cones[v, 2, q] = z / max(distance, 1e-6)
            sin = reach[q] / max(distance, 1e-6)
            if sin >= 1.0:
                cones[v, 3, q], cones[v, 4, q] = -2.0, 0.0
            else:
                cones[v, 3, q], cones[v, 4, q] = np.sqrt(1.0 - sin * sin), sin


@njit(**PARALLEL)
def _fill_tiles(rays, cones, lists, counts):
    """List the Gaussians whose cone meets that of each tile."""
    gaussians = cones.shape[2]
    for t in prange(len(rays.tile_view)):
        v = rays.tile_view[t]
        x, y, z = rays.tile_axis[t, 0], rays.tile_axis[t, 1], rays.tile_axis[t, 2]
        cos, sin = rays.tile_cos[t], rays.tile_sin[t]
        ux, uy, uz, c, s = cones[v, 0], cones[v, 1], cones[v, 2], cones[v, 3], cones[v, 4]
        count = 0
        for q in range(gaussians):
            towards = x * ux[q] + y * uy[q] + z * uz[q]
            lists[t, count] = q
            count += towards > cos * c[q] - sin * s[q] or c[q] < np.float32(-1.5)
        counts[t] = count


@njit(cache=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def _kept(seed, ray, gaussian, keep):
    """A repeatable draw for a ray and a Gaussian: true with probability `keep`.

    Source: the finaliser of SplitMix64 (Steele, Lea & Flood 2014).
    """
    z = seed + np.uint64(ray) * np.uint64(0x9E3779B97F4A7C15)
    z += np.uint64(gaussian) * np.uint64(0xD1B54A32D192ED03)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return np.float64(z >> np.uint64(11)) * 2.0**-53 < keep


@njit(cache=True)
def _posed(angles, chain, gaussians, rays):
    """The fields of `Posed`: numba needs to see it made where a parallel loop takes it."""
    count, views = len(chain.carrier), len(rays.origins)
    origins, axes = np.empty((len(chain.parents), 3)), np.empty((len(angles), 3))
    centres = np.empty((count, 3))
    pose(chain, angles, origins, axes, centres)
    arms = np.empty((views, count, 3), np.float32)
    cones = np.empty((views, 5, count), np.float32)
    _cones(centres, rays.origins, gaussians.reach, arms, cones)
    return origins, axes, centres, arms, cones


@njit(**PARALLEL)
def image_visibility(angles, chain, gaussians, rays, settings, scratches, memory):
    """Visibility of every Gaussian along every ray (P, G): see `ImageModel.visibility`."""
    _, _, _, arms, cones = _posed(angles, chain, gaussians, rays)
    _fill_tiles(rays, cones, memory.lists, memory.counts)
    seen = np.zeros((len(rays.camera), len(chain.carrier)), np.float32)
    for thread in prange(len(memory.energy)):
        _thread_visibility(thread, arms, gaussians, rays, settings, scratches, memory, seen)
    return seen


@njit(**SERIAL)
def _thread_visibility(thread, arms, gaussians, rays, settings, scratches, memory, seen):
    """One thread's rays of `image_visibility`."""
    scratch, step = thread_scratch(scratches, thread), len(memory.energy) * BLOCK
    for first in range(thread * BLOCK, len(rays.camera), step):
        for p in range(first, min(first + BLOCK, len(rays.camera))):
            tile = rays.tile[p]
            if memory.counts[tile] == 0:
                continue
            found = find_near(
                rays.direction[p], arms, rays.camera[p], memory.lists[tile], memory.counts[tile],
                gaussians, scratch,
            )  # fmt: skip
            if found == 0:
                continue
            ray_energy(found, settings, gaussians, memory.lanes, scratch)
            for i in range(found):
                seen[p, scratch.near[i]] = ray_visibility(np.uint64(i), gaussians.edges, scratch)


@njit(**PARALLEL)
def image_energy(
    angles, colours, chain, gaussians, rays, settings, request, scratches, memory
):  # fmt: skip
    """Energy, gradient (37,), Gauss-Newton matrix (37, 37): see `ImageModel.evaluate`."""
    origins, axes, centres, arms, cones = _posed(angles, chain, gaussians, rays)
    posed = Posed(origins, axes, centres, arms, cones)
    _fill_tiles(rays, cones, memory.lists, memory.counts)
    energies = memory.energy  # numba loses what a parallel loop writes to a field
    for thread in prange(len(energies)):
        energies[thread] = _thread_energy(
            thread, posed, colours, chain, gaussians, rays, settings, request, scratches, memory
        )
    return _gather(chain, posed, request.curvature, memory)


@njit(**SERIAL)
def _thread_energy(
    thread, posed, colours, chain, gaussians, rays, settings, request, scratches, memory
):  # fmt: skip
    """One thread's rays: energy; adds to the derivatives by the centres and to the matrix."""
    scratch, H = thread_scratch(scratches, thread), memory.curvature[thread]
    mine = Thread(scratch, memory.by_centre[thread], memory.wrench[thread], memory.loaded[thread])
    row, which, pixels = memory.row[thread], memory.which[thread], memory.pixels
    _clear(mine.by_centre)
    if request.curvature:
        _clear(H)
    every, binned = len(request.selected) == 0, len(colours.bins) > 0
    total = len(rays.camera) if every else len(request.selected)
    energy = 0.0
    for first in range(thread * BLOCK, total, len(memory.energy) * BLOCK):
        for entry in range(first, min(first + BLOCK, total)):
            p = entry if every else request.selected[entry]
            pixels[0, p] = pixels[1, p] = pixels[2, p] = np.float32(0.0)
            n, tile = rays.direction[p], rays.tile[p]
            count = memory.counts[tile]
            if count == 0:
                continue
            found = find_near(
                n, posed.arms, rays.camera[p], memory.lists[tile], count, gaussians, scratch
            )
            if found == 0:
                continue
            if binned:
                look_up_colours(found, colours.bins[p], colours.unlike, scratch)
            else:
                compare_colours(found, colours.features[p], settings, gaussians, scratch)
            e, end, light = ray_energy(found, settings, gaussians, memory.lanes, scratch)
            weight = 1.0 if every else np.float64(request.weights[entry])
            energy += weight * e
            squared = _add_derivatives(p, n, found, end, weight, posed, chain, gaussians, request,
                                       mine)  # fmt: skip
            pixels[0, p], pixels[1, p], pixels[2, p] = e, np.sqrt(squared), np.float32(1.0) - light
            if request.curvature:
                count = angle_derivatives(
                    chain, posed.origins, posed.axes, mine.wrench, mine.loaded, row, which
                )
                _add_outer(H, row, which, count, weight / (2.0 * max(1.0 + e, FIT_FLOOR)))
    return energy


@njit(**RAY_CODE)
def _add_derivatives(p, n, found, end, weight, posed, chain, gaussians, request, mine):
    """Add a ray's derivatives by the near Gaussians' centres; returns their squared length."""
    squared = np.float32(0.0)
    gain = weight / request.keep
    for i in range(found):
        q = mine.scratch.near[i]
        joint = chain.carrier[q]
        if joint < 0 or (request.keep < 1.0 and not _kept(request.seed, p, q, request.keep)):
            continue  # the skull does not move
        if not ray_step(np.uint64(i), n, gaussians, end, mine.scratch):
            continue
        step = mine.scratch.step[i]
        for c in range(3):
            mine.by_centre[q, c] += gain * step[c]
            squared += step[c] * step[c]
        if request.curvature:
            add_force(mine.wrench, joint, posed.centres[q], step)
            mine.loaded[joint] = True
    return squared


@njit(**RAY_CODE)
def _clear(values):
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            values[r, c] = 0.0


@njit(cache=True)
def _gather(chain, posed, curvature, memory):
    """Sum over the threads; turn derivatives by the centres into those by the angles."""
    joints, dofs = len(posed.origins), len(posed.axes)
    wrench, loaded = np.zeros((joints, 6)), np.ones(joints, np.bool_)
    row, which = np.empty(dofs), np.empty(dofs, np.int64)
    gradient, matrix = np.zeros(dofs), np.zeros((dofs, dofs))
    for thread in range(len(memory.energy)):
        for q in range(len(chain.carrier)):
            if chain.carrier[q] >= 0:
                force = memory.by_centre[thread, q]
                add_force(wrench, chain.carrier[q], posed.centres[q], force)
    count = angle_derivatives(chain, posed.origins, posed.axes, wrench, loaded, row, which)
    for i in range(count):
        gradient[which[i]] = row[i]
    if curvature:
        for r in range(dofs):
            for c in range(r + 1):
                matrix[r, c] = matrix[c, r] = memory.curvature[:, r, c].sum()
    return memory.energy.sum(), gradient, matrix


@njit(cache=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def _add_outer(H, row, which, count, scale):
    """Add scale * J J^T to the lower triangle of H, J given by its entries above `FLAT`."""
    kept = 0
    for i in range(count):
        if abs(row[i]) > FLAT:
            row[kept], which[kept] = row[i], which[i]
            kept += 1
    for i in range(kept):
        a, scaled = which[i], scale * row[i]
        for j in range(kept):
            if which[j] <= a:
                H[a, which[j]] += scaled * row[j]
