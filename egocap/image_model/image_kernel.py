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

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32
from numba import njit, prange
from numpy import ndarray as Array

from egocap.image_model.body_kernel import angle_forces, load, pose
from egocap.image_model.ray_kernel import (
    CACHE_LINE,
    FAST,
    compare_colours,
    find_near,
    look_up,
    ray_energy,
    ray_step,
    ray_visibility,
    scratch_of,
)

BLOCK = 32
"""Rays that a thread takes at a time."""
FLAT = 1e-4
"""Derivatives of a ray's energy below this, per radian, do not enter the Gauss-Newton matrix."""
FIT_FLOOR = 0.05
"""Least 1 + e that the Gauss-Newton matrix divides by."""


class Shape(NamedTuple):
    """What rays need of the Gaussians, single precision."""

    radius2: Float32[Array, "G"]  # squared distance from a ray beyond which it is not felt
    reach: Float32[Array, "G"]  # its root
    inv_2s2: Float32[Array, "G"]  # -1 / (2 sigma^2)
    inv_s: Float32[Array, "G"]  # 1 / (sqrt(2) sigma)
    inv_s2: Float32[Array, "G"]  # 1 / sigma^2
    half_depth: Float32[Array, "G"]  # half of the optical depth through the centre
    edges: Int32[Array, "G"]
    colours: Float32[Array, "G 3"]
    blend: Float32[Array, "G 3"]


class RayArrays(NamedTuple):
    """`image_rays.ImageRays` in the kernel's precision."""

    origins: Float[Array, "V 3"]
    camera: Int32[Array, "P"]  # the view, under a name that numba does not take for a method
    direction: Float32[Array, "P 3"]
    tile: Int32[Array, "P"]
    tile_view: Int32[Array, "N"]
    tile_axis: Float32[Array, "N 3"]
    tile_cos: Float32[Array, "N"]
    tile_sin: Float32[Array, "N"]


class Posed(NamedTuple):
    """The body in a pose, and how the views see it."""

    origins: Float[Array, "18 3"]  # of skull and joints
    axes: Float[Array, "37 3"]
    centres: Float[Array, "G 3"]
    arms: Float32[Array, "V G 3"]  # from the camera to the centre
    cones: Float32[Array, "V 5 G"]  # direction, cos and sin of the angle


class Palettes(NamedTuple):
    """Colours by bins: which bin every ray is in, and how unlike each Gaussian every bin is."""

    bins: Int32[Array, "P"]  # empty: colours are compared directly
    unlike: Float32[Array, "G K"]


class Forces(NamedTuple):
    """Working memory of `angle_forces`."""

    wrench: Float[Array, "18 6"]
    loaded: Bool[Array, "18"]
    row: Float[Array, "37"]
    which: Int[Array, "37"]


class Output(NamedTuple):
    """One row a thread."""

    energy: Float[Array, "C"]
    centre: Float[Array, "C G 3"]  # derivative by the Gaussians' centres
    curvature: Float[Array, "C 37 37"]  # lower triangle


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


@njit(cache=True, parallel=True, fastmath=FAST,
      error_model="numpy")  # fmt: skip
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
def _posed(angles, chain, shape, rays):
    """The fields of `Posed`, which numba must see made where a parallel loop takes it."""
    gaussians, views = len(chain.carrier), len(rays.origins)
    origins, axes = np.empty((len(chain.parents) + 1, 3)), np.empty((len(angles), 3))
    centres = np.empty((gaussians, 3))
    pose(chain, angles, origins, axes, centres)
    arms = np.empty((views, gaussians, 3), np.float32)
    cones = np.empty((views, 5, gaussians), np.float32)
    _cones(centres, rays.origins, shape.reach, arms, cones)
    return origins, axes, centres, arms, cones


@njit(cache=True, parallel=True, fastmath=FAST,
      error_model="numpy")  # fmt: skip
def image_visibility(
    angles, chain, shape, rays, cell, cells, lanes, lists, counts, scratches, threads
):  # fmt: skip
    """Visibility of every Gaussian along every ray (P, G): see `ImageModel.visibility`."""
    _, _, _, arms, cones = _posed(angles, chain, shape, rays)
    _fill_tiles(rays, cones, lists, counts)
    seen = np.zeros((len(rays.camera), len(chain.carrier)), np.float32)
    for thread in prange(threads):
        _see_share_of_rays(
            thread, threads, arms, shape, rays, cell, cells, lanes, lists, counts,
            scratch_of(scratches, thread), seen,
        )  # fmt: skip
    return seen


@njit(cache=True, fastmath=FAST, error_model="numpy", _nrt=False)  # pyright: ignore[reportCallIssue]
def _see_share_of_rays(
    thread, threads, arms, shape, rays, cell, cells, lanes, lists, counts, scratch, seen
):  # fmt: skip
    """One thread's rays of `image_visibility`."""
    for first in range(thread * BLOCK, len(rays.camera), threads * BLOCK):
        for p in range(first, min(first + BLOCK, len(rays.camera))):
            tile = rays.tile[p]
            if counts[tile] == 0:
                continue
            found = find_near(
                rays.direction[p], arms, rays.camera[p], lists[tile], counts[tile],
                shape.radius2, shape.reach, shape.inv_2s2, shape.half_depth, scratch,
            )  # fmt: skip
            if found == 0:
                continue
            ray_energy(found, shape.edges, shape.inv_s, cell, cells, lanes, scratch)
            for i in range(found):
                seen[p, scratch.near[i]] = ray_visibility(np.uint64(i), shape.edges, scratch)


@njit(cache=True, parallel=True, fastmath=FAST,
      error_model="numpy")  # fmt: skip
def image_energy(
    angles, colours, palettes, chain, shape, rays, cell, cells, in_cone, colour_scale, selected,
    weights, keep, seed, curvature, lanes, lists, counts, scratches, pixels, output,
):  # fmt: skip
    """Energy, gradient (37,), Gauss-Newton matrix (37, 37): see `ImageModel.evaluate`."""
    frames, dofs = len(chain.parents) + 1, len(angles)
    origins, axes, centres, arms, cones = _posed(angles, chain, shape, rays)
    posed = Posed(origins, axes, centres, arms, cones)
    _fill_tiles(rays, cones, lists, counts)
    energies = output.energy  # numba loses what a parallel loop writes to a field
    threads = len(energies)
    apart = CACHE_LINE
    wrenches = np.zeros((threads, frames + apart, 6))
    loadeds = np.zeros((threads, frames + 4 * apart), np.bool_)
    rows = np.empty((threads, dofs + apart))
    whiches = np.empty((threads, dofs + apart), np.int64)
    for thread in prange(threads):
        energies[thread] = _share_of_rays(
            thread, threads, posed, colours, palettes, chain, shape, rays, cell, cells, in_cone,
            colour_scale, selected, weights, keep, seed, curvature, lanes, lists, counts,
            scratch_of(scratches, thread),
            Forces(wrenches[thread], loadeds[thread], rows[thread], whiches[thread]), pixels,
            output.centre[thread], output.curvature[thread],
        )  # fmt: skip
    return _gather(chain, posed, curvature, output)


@njit(cache=True, fastmath=FAST, error_model="numpy", _nrt=False)  # pyright: ignore[reportCallIssue]
def _share_of_rays(
    thread, threads, posed, colours, palettes, chain, shape, rays, cell, cells, in_cone,
    colour_scale, selected, weights, keep, seed, curvature, lanes, lists, counts, scratch, forces,
    pixels, by_centre, H,
):  # fmt: skip
    """One thread's rays: energy; adds to the derivatives by the centres and to the matrix."""
    wrench, loaded, row, which = forces.wrench, forces.loaded, forces.row, forces.which
    for q in range(len(by_centre)):
        for c in range(3):
            by_centre[q, c] = 0.0
    if curvature:
        for r in range(H.shape[1]):
            for c in range(H.shape[1]):
                H[r, c] = 0.0
    every, binned = len(selected) == 0, len(palettes.bins) > 0
    total = len(rays.camera) if every else len(selected)
    energy = 0.0
    for first in range(thread * BLOCK, total, threads * BLOCK):
        for entry in range(first, min(first + BLOCK, total)):
            p = entry if every else selected[entry]
            tile = rays.tile[p]
            pixels[0, p] = np.float32(0.0)
            pixels[1, p] = np.float32(0.0)
            pixels[2, p] = np.float32(0.0)
            if counts[tile] == 0:
                continue
            n = rays.direction[p]
            found = find_near(
                n, posed.arms, rays.camera[p], lists[tile], counts[tile], shape.radius2,
                shape.reach, shape.inv_2s2, shape.half_depth, scratch,
            )  # fmt: skip
            if found == 0:
                continue
            if binned:
                look_up(found, palettes.bins[p], palettes.unlike, scratch)
            else:
                compare_colours(
                    found, colours[p], in_cone, colour_scale, shape.colours, shape.blend, scratch
                )
            e, end, light = ray_energy(found, shape.edges, shape.inv_s, cell, cells, lanes, scratch)
            pixels[0, p] = e
            pixels[2, p] = np.float32(1.0) - light
            pull = np.float32(0.0)
            weight = 1.0 if every else np.float64(weights[entry])
            energy += weight * e
            for i in range(found):
                q = scratch.near[i]
                f = chain.carrier[q]
                if f == 0 or (keep < 1.0 and not _kept(seed, p, q, keep)):  # the skull stays
                    continue
                if not ray_step(
                    np.uint64(i), n, shape.edges, shape.inv_s, shape.inv_s2, end, scratch
                ):
                    continue
                step = scratch.step[i]
                gain = weight / keep
                for c in range(3):
                    by_centre[q, c] += gain * step[c]
                    pull += step[c] * step[c]
                if curvature:
                    load(wrench, f, posed.centres[q], step)
                    loaded[f] = True
            pixels[1, p] = np.sqrt(pull)
            if curvature:
                count = angle_forces(chain, posed.origins, posed.axes, wrench, loaded, row, which)
                _add_outer(H, row, which, count, weight / (2.0 * max(1.0 + e, FIT_FLOOR)))
    return energy


@njit(cache=True)
def _gather(chain, posed, curvature, output):
    """Sum up the threads; turn derivatives by the centres into those by the angles."""
    frames, dofs = len(posed.origins), len(posed.axes)
    wrench, loaded = np.zeros((frames, 6)), np.ones(frames, np.bool_)
    row, which = np.empty(dofs), np.empty(dofs, np.int64)
    gradient, matrix = np.zeros(dofs), np.zeros((dofs, dofs))
    for thread in range(len(output.energy)):
        for q in range(len(chain.carrier)):
            load(wrench, chain.carrier[q], posed.centres[q], output.centre[thread, q])
    for i in range(angle_forces(chain, posed.origins, posed.axes, wrench, loaded, row, which)):
        gradient[which[i]] = row[i]
    if curvature:
        for r in range(dofs):
            for c in range(r + 1):
                matrix[r, c] = output.curvature[:, r, c].sum()
                matrix[c, r] = matrix[r, c]
    return output.energy.sum(), gradient, matrix


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
