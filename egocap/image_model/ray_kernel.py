"""One ray through the Gaussians near it, compiled: equation 4 by cells, energy and gradient.

Single precision; the loops that matter run over the 16 or more cell edges that a Gaussian covers,
so that they vectorise: indices are unsigned, which spares numba's test for negative ones, and rows
are indexed, not sliced, as a slice costs more than its 16 numbers. The readable form is
`egocap.image_model.torch_visibility.cell_visibility`.

With D_k the optical depth of cell k, C_k the same weighted by every Gaussian's dissimilarity,
T_k = exp(-(D_0 + ... + D_(k-1))) and g(D) = (1 - exp(-D)) / D, a ray's energy is
sum_k T_k g(D_k) C_k. Its derivative by the depth that one Gaussian of dissimilarity d has in cell k
is d U_k + V_k, where U_k = T_k g(D_k) and V_k = T_k g'(D_k) C_k - sum_(j > k) U_j C_j: two numbers
a cell serve all Gaussians, and the cost stays linear in their number.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from egocap.image_model.kernel_arrays import LANES

DARK = np.float32(1e-5)
"""Transmittance behind which a ray is not followed."""

ERF_ERROR = 2e-6
"""Bound of the error of `edge_values` against the error function, in single precision.

The formula's own bound is 1.5e-7 (Abramowitz & Stegun 1964, equation 7.1.26).
"""

FAST = {"reassoc", "contract", "nsz", "arcp"}
"""What the compiler may assume: not that numbers are finite."""
RAY_CODE = {
    "cache": True, "fastmath": FAST, "error_model": "numpy", "inline": "always", "_nrt": False,
}  # fmt: skip
"""Options of all that runs once a ray or more: no reference counting, no calls."""

_f, _u = np.float32, np.uint64
_ZERO, _ONE, _HALF, _FOUR, _SIXTEEN = _f(0), _f(1), _f(0.5), _f(4), _f(16)
_E2, _E3, _E4, _E5 = _f(1 / 2), _f(1 / 6), _f(1 / 24), _f(1 / 120)
_P = _f(0.3275911)
_A1, _A2, _A3 = _f(0.254829592), _f(-0.284496736), _f(1.421413741)
_A4, _A5 = _f(-1.453152027), _f(1.061405429)
_TWO_OVER_ROOT_PI = _f(2.0 / np.sqrt(np.pi))
_SERIES = _f(0.25)
_G2, _G3, _G4, _G5 = _f(1 / 6), _f(-1 / 24), _f(1 / 120), _f(-1 / 720)
_H1, _H2, _H3, _H4, _H5 = _f(1 / 3), _f(-1 / 8), _f(1 / 30), _f(-1 / 144), _f(1 / 840)
_THIRTY_SECOND = _f(-1 / 32)


@njit(**RAY_CODE)
def _decay(y):
    """exp(-y) for y from 0 to 16: a polynomial of -y / 32, squared five times."""
    z = y * _THIRTY_SECOND
    p = _ONE + z * (_ONE + z * (_E2 + z * (_E3 + z * (_E4 + z * _E5))))
    p = p * p
    p = p * p
    p = p * p
    p = p * p
    return p * p


@njit(**RAY_CODE)
def edge_values(start, step, edges, lanes, i, erf, bell):
    """erf(x) and exp(-x^2) at x = start + j step for j < edges, a multiple of 16.

    `lanes` holds 0, 1, 2, ...; row i of `erf` and `bell` is output.
    """
    for block in range(edges // LANES):
        base = _u(block * LANES)
        for lane in range(LANES):
            j = base + _u(lane)
            x = start + lanes[j] * step
            a = min(abs(x), _FOUR)
            p = _decay(a * a)
            t = _ONE / (_ONE + _P * a)
            tail = p * t * (_A1 + t * (_A2 + t * (_A3 + t * (_A4 + t * _A5))))
            erf[i, j] = np.copysign(_ONE - tail, x)
            bell[i, j] = p


@njit(**RAY_CODE)
def find_near(n, arms, view, candidates, count, gaussians, scratch):
    """Gaussians of a tile that the ray n = (3,) meets, into `scratch`; returns how many."""
    radius2, reach = gaussians.radius2, gaussians.reach
    inv_2s2, half_depth = gaussians.inv_2s2, gaussians.half_depth
    near, middle, half, across = scratch.near, scratch.middle, scratch.half, scratch.across
    found = 0
    x, y, z = n[0], n[1], n[2]
    for c in range(count):
        q = _u(candidates[c])
        ax, ay, az = arms[view, q, 0], arms[view, q, 1], arms[view, q, 2]
        m = ax * x + ay * y + az * z
        ax -= m * x
        ay -= m * y
        az -= m * z
        d2 = ax * ax + ay * ay + az * az
        if d2 < radius2[q] and m > -reach[q]:
            near[found] = q
            middle[found] = m
            half[found] = half_depth[q] * np.exp(d2 * inv_2s2[q])
            across[found, 0] = ax
            across[found, 1] = ay
            across[found, 2] = az
            found += 1
    return found


@njit(**RAY_CODE)
def compare_colours(found, image, settings, gaussians, scratch):
    """Dissimilarity of every near Gaussian to the ray's colour: `image_model.colour_measure`."""
    near, like = scratch.near, scratch.like
    in_cone, scale = settings.in_cone, settings.colour_scale
    colours, blend = gaussians.colours, gaussians.blend
    for i in range(found):
        q = near[i]
        d0, d1, d2 = image[0] - colours[q, 0], image[1] - colours[q, 1], image[2] - colours[q, 2]
        if in_cone:
            x = (d0 * d0 + d1 * d1 + d2 * d2) * scale
        else:
            apart = abs(d0)
            hue = min(min(apart, _ONE - apart) * scale, _ONE)
            grey = abs(d2) + abs(d1)
            x = blend[q, 0] * hue * hue + (blend[q, 1] + blend[q, 1]) * d2 * d2 + blend[q, 2] * grey
        far = _ONE - min(x, _ONE)
        far2 = far * far
        like[i] = _ONE - far2 * far2 * (_f(10) - _f(8) * far)


@njit(**RAY_CODE)
def look_up_colours(found, bin_, unlike, scratch):
    """Dissimilarity of every near Gaussian to the ray's bin of colour: `image_model.palette`."""
    near, like = scratch.near, scratch.like
    for i in range(found):
        like[i] = unlike[near[i], bin_]


@njit(**RAY_CODE)
def ray_energy(found, settings, gaussians, lanes, scratch):
    """Energy of a ray from its near Gaussians; leaves U and V of every cell in `scratch`.

    Returns the energy, the first cell behind which all is dark, and the transmittance.
    """
    edges, inv_s = gaussians.edges, gaussians.inv_s
    cell, cells = settings.cell, settings.cells
    low, high = cells, 0
    for i in range(found):
        q = scratch.near[i]
        width = edges[q]
        first = int(np.floor(scratch.middle[i] / cell + _HALF)) - width // 2
        first = min(max(first, 0), cells)
        scratch.first[i] = first
        low, high = min(low, first), max(high, first + width)
    depth, coloured, share, rest = scratch.depth, scratch.coloured, scratch.share, scratch.rest
    start = _u(low)
    blocks = (high - low + LANES - 1) // LANES
    for k in range(blocks * LANES):
        depth[start + _u(k)] = _ZERO
        coloured[start + _u(k)] = _ZERO
    for i in range(found):
        _add_depth(_u(i), edges, inv_s, cell, lanes, scratch)
    for block in range(blocks):
        _absorb(start + _u(block * LANES), scratch)
    light = _ONE
    end = start + _u(blocks * LANES)
    k = start
    while k < end:
        passed = light * (_ONE - depth[k] * share[k])
        share[k] *= light
        rest[k] *= light * coloured[k]
        light = passed
        k += _u(1)
        if light < DARK:
            break
    bright = k
    behind = _ZERO
    while k > start:
        k -= _u(1)
        rest[k] -= behind
        behind += share[k] * coloured[k]
    k = bright
    while k < end:
        share[k] = _ZERO
        rest[k] = _ZERO
        k += _u(1)
    return behind, bright, light


@njit(**RAY_CODE)
def _add_depth(i, edges, inv_s, cell, lanes, scratch):
    """Add the depth of near Gaussian i to the cells, plain and times its dissimilarity."""
    q, first = scratch.near[i], scratch.first[i]
    width = edges[q]
    erf, bell, D, C = scratch.erf, scratch.bell, scratch.depth, scratch.coloured
    start = (_f(first) * cell - scratch.middle[i]) * inv_s[q]
    edge_values(start, cell * inv_s[q], width, lanes, i, erf, bell)
    if first > _u(0):  # what little lies in front of the first edge goes into the first cell
        erf[i, _u(0)], bell[i, _u(0)] = -_ONE, _ZERO
    last = _u(width)  # and what lies behind the last edge into the last
    erf[i, last - _u(1)], bell[i, last - _u(1)] = _ONE, _ZERO
    erf[i, last], bell[i, last] = _ONE, _ZERO
    half, tinted = scratch.half[i], scratch.half[i] * scratch.like[i]
    for block in range(width // LANES):
        base = _u(block * LANES)
        for lane in range(LANES):
            j = base + _u(lane)
            inside = erf[i, j + _u(1)] - erf[i, j]
            D[first + j] += half * inside
            C[first + j] += tinted * inside


@njit(**RAY_CODE)
def _absorb(base, scratch):
    """g(D) and g'(D) of 16 cells, into `share` and `rest`; by series where D is small."""
    depth, share, rest = scratch.depth, scratch.share, scratch.rest
    for lane in range(LANES):
        k = base + _u(lane)
        d = depth[k]
        e = _decay(min(d, _SIXTEEN))
        safe = max(d, _SERIES)
        g = (_ONE - e) / safe
        slope = (e - g) / safe
        g_series = _ONE + d * (-_HALF + d * (_G2 + d * (_G3 + d * (_G4 + d * _G5))))
        h_series = -_HALF + d * (_H1 + d * (_H2 + d * (_H3 + d * (_H4 + d * _H5))))
        share[k] = g if d > _SERIES else g_series
        rest[k] = slope if d > _SERIES else h_series


@njit(**RAY_CODE)
def ray_step(i, n, gaussians, end, scratch):
    """Derivative of the ray's energy by the centre of near Gaussian i, into `scratch.step`.

    Returns False when the Gaussian lies behind cell `end`, where all is dark.
    """
    edges, inv_s, inv_s2 = gaussians.edges, gaussians.inv_s, gaussians.inv_s2
    q, first = scratch.near[i], scratch.first[i]
    if first >= end:
        return False
    erf, bell, U, V = scratch.erf, scratch.bell, scratch.share, scratch.rest
    like = scratch.like[i]
    sums, moments = scratch.sums, scratch.moments
    for lane in range(LANES):
        sums[_u(lane)] = _ZERO
        moments[_u(lane)] = _ZERO
    for block in range(edges[q] // LANES):
        base = _u(block * LANES)
        for lane in range(LANES):
            j = base + _u(lane)
            h = like * U[first + j] + V[first + j]
            sums[_u(lane)] += h * (erf[i, j + _u(1)] - erf[i, j])
            moments[_u(lane)] += h * (bell[i, j] - bell[i, j + _u(1)])
    for lane in range(LANES // 2):  # a tree of sums stays in vectors
        sums[_u(lane)] += sums[_u(lane + LANES // 2)]
        moments[_u(lane)] += moments[_u(lane + LANES // 2)]
    for lane in range(LANES // 4):
        sums[_u(lane)] += sums[_u(lane + LANES // 4)]
        moments[_u(lane)] += moments[_u(lane + LANES // 4)]
    by_depth = (sums[_u(0)] + sums[_u(1)]) + (sums[_u(2)] + sums[_u(3)])
    by_middle = (moments[_u(0)] + moments[_u(1)]) + (moments[_u(2)] + moments[_u(3)])
    half = scratch.half[i]
    along = by_middle * half * _TWO_OVER_ROOT_PI * inv_s[q]
    across = -by_depth * half * inv_s2[q]
    for c in range(3):
        scratch.step[i, c] = along * n[c] + across * scratch.across[i, c]
    return True


@njit(**RAY_CODE)
def ray_visibility(i, edges, scratch):
    """Share of the ray that near Gaussian i sends back, by the U that `ray_energy` left."""
    first, erf, U = scratch.first[i], scratch.erf, scratch.share
    seen = _ZERO
    for j in range(edges[scratch.near[i]]):
        at = _u(j)
        seen += U[first + at] * (erf[i, at + _u(1)] - erf[i, at])
    return scratch.half[i] * seen
