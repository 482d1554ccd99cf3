"""The compiled inner loop of corners.py: edges along the sides of one quad, lines through
them, where the lines meet.

One marker after the other, so that a result does not depend on its company. What is not
finite never becomes an index."""

from __future__ import annotations

import numba
import numpy as np

from arfx.analyse.pose.kernels import sort

SAMPLES = 32  # normals per side
STEPS = 33  # samples along a normal
# Where along a side: its rounded and occluded ends are left out. Uneven, lest the samples
# keep step with the pixels that a slanted edge crosses (at a slope of 1 in 2 even ones
# every 2.2 px saw one phase of them all: .05 px of error became .02).
_EVEN = (np.arange(SAMPLES) + 0.5) / SAMPLES
FRACTIONS = 0.05 + 0.9 * (_EVEN + 0.15 * np.sin(2 * np.pi * _EVEN) / (2 * np.pi))
CONVERGED_PX = 4e-3  # a fifth of the noise of a good corner
ITERATIONS = 6
# A normal on which the edge is fainter than so much of the side's (its upper quartile)
# meets something that covers the print.
_THERE = 0.5
# of the robust line: with three, a quarter of the samples off by .5 px still moves an end
# by .1 px
_ROUNDS = 5
# Least standard deviation of the window: a narrower one sees the steps of the pixels in a
# sharp edge and is drawn towards them, by up to .13 px at .7 px. Noise gains nothing from a
# narrow window. Small cells need one: what is beyond is near.
WINDOW_PX = (0.7, 1.3)
WINDOW_FRACTION = 0.4  # of what is looked at to one side, between those two
WIDE_ITERATIONS = 2  # with the far reach, before the others
# Columns of what `refine_quad` returns for a marker.
OK, BLUR, SPREAD, GAIN, SKEW, INVERTED = range(6)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def refine_quad(
    luma, table, quads, bend, half, reach, least_gain, fractions, out
):  # pragma: no cover - compiled
    """Move quads (n, 4, 2) onto their edges, in place; out (n, 6) by the columns above.

    luma : (h, w) uint8, at least 2 x 2;  table : (256,) to linear light;  bend : (n, 4,
    SAMPLES, 2) px off the chord
    half : (n, 4) px searched to either side of an edge;  reach : (n, 4) px for the first
    passes, not below half
    least_gain : (n,) give up where a side is fainter, at once;  fractions : FRACTIONS (a
    constant would be unrolled, and
    the compiler take three times as long)"""
    samples = len(fractions)
    seen, slope = np.empty((2, 4, samples)), np.empty((4, samples, STEPS - 1))
    ends = np.empty((4, 2))
    for i in range(len(quads)):
        quad, stats = quads[i], out[i]
        wide = WIDE_ITERATIONS if (reach[i] > half[i]).any() else 0
        least = np.minimum(
            np.maximum(WINDOW_FRACTION * half[i], WINDOW_PX[0]), WINDOW_PX[1]
        )
        window, stats[BLUR], stats[OK] = reach[i] / 2, np.nan, 1.0
        for k in range(ITERATIONS + wide):
            far = reach[i] if k < wide else half[i]
            _edges(luma, table, quad, bend[i], far, window, fractions, slope, seen, stats)
            # the blur's estimate settles; then the window is held, so that the fixed point
            # is one
            if k < 3 + wide:
                after = reach[i] if k + 1 < wide else half[i]
                window = np.minimum(np.maximum(1.2 * stats[BLUR], least), after / 2)
            stats[SPREAD] = _fit(seen, fractions, ends)
            moved = _meet(quad, ends)
            step = np.abs(moved - quad).max()
            if not (np.isfinite(moved).all() and stats[GAIN] > least_gain[i]):
                stats[OK] = 0.0
                break
            quad[:] = moved
            if step <= CONVERGED_PX and k >= 2 + wide:
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _edges(
    luma, table, quad, bend, half, window, fractions, slope, seen, stats
):  # pragma: no cover - compiled
    """Where the four edges are along their normals: seen (2, 4, SAMPLES), px inwards from
    the chord; 1, or 0 where a normal shows too faint an edge. Sets stats' GAIN, the least
    slope of a side, BLUR, SKEW and INVERTED; its BLUR is NaN at first.

    half, window : (4,) px of each side;  slope (4, SAMPLES, STEPS - 1) : work space"""
    h, w = luma.shape
    steps = slope.shape[2] + 1
    for side in range(4):
        ax, ay = quad[side]
        cx, cy = quad[(side + 1) % 4] - quad[side]
        nx, ny = _normal(cx, cy)
        spacing = 2 * half[side] / (steps - 1)
        for m in range(len(fractions)):
            mx, my = (
                ax + cx * fractions[m] + bend[side, m, 0],
                ay + cy * fractions[m] + bend[side, m, 1],
            )
            before = 0.0
            for s in range(steps):
                along = half[side] * (s / ((steps - 1) / 2) - 1)
                # bilinear, in linear light, exact coordinates (cv2.remap rounds them to
                # 1/32 px); borders are replicated
                x, y = _within(mx + nx * along, w), _within(my + ny * along, h)
                xi, yi = int(x), int(y)
                fx, fy = x - xi, y - yi
                a, b = table[luma[yi, xi]], table[luma[yi, xi + 1]]
                c, d = table[luma[yi + 1, xi]], table[luma[yi + 1, xi + 1]]
                top = a + (b - a) * fx
                light = top + (c + (d - c) * fx - top) * fy
                if s:
                    slope[side, m, s - 1] = (before - light) / spacing
                before = light
    stats[INVERTED] = 1.0 if slope.sum() < 0 else 0.0
    if stats[INVERTED]:  # else bright outside, dark inside: positive
        slope *= -1.0
    centres = (np.arange(steps - 1) + 0.5) / ((steps - 1) / 2) - 1
    mean, gain = np.empty((4, steps - 1)), np.inf
    for side in range(4):
        reach, wide = half[side], window[side] ** 2
        at = reach * centres
        narrow = np.exp(-0.5 / wide * at * at)
        own = _product(slope[side], narrow)
        ordered = own.copy()
        sort(ordered)
        least = _THERE * ordered[3 * len(own) // 4]
        there = 1.0 - ((least > 0) & (own < least))
        mean[side] = _product(slope[side].T, there) / there.sum()
        mass = (mean[side] * narrow).sum()
        gain = min(gain, mass)
        off = _product(slope[side], narrow * at) / mass
        if np.isfinite(stats[BLUR]):
            # a window of width w over an edge of width b sees only w2 / (w2 + b2) of a
            # displacement
            off *= min((stats[BLUR] ** 2 + wide) / wide, 3.0)
        seen[0, side] = np.where(
            np.isfinite(off), np.minimum(np.maximum(off, -reach), reach), 0.0
        )
        seen[1, side] = there
    blur, third = _width(mean, centres, half), 0.0
    for side in range(4):
        at = half[side] * centres
        near = np.exp(-0.5 / (1.5 * blur) ** 2 * at * at)
        cube = _moments(mean[side] * near, at)[1]
        third += (cube if np.isfinite(cube) else 0.0) / 4
    stats[GAIN], stats[BLUR], stats[SKEW] = gain, blur, third / blur**3


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _product(matrix, v):  # pragma: no cover - compiled
    """matrix @ v; numpy's own waits for Python's lock."""
    out = np.zeros(len(matrix))
    for i in range(len(out)):
        for j in range(len(v)):
            out[i] += matrix[i, j] * v[j]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _normal(x, y):  # pragma: no cover - compiled
    """Unit normal of a side, to the inside of a clockwise quad; 0 where it has no length."""
    length = np.sqrt(x * x + y * y)
    return (-y / length, x / length) if length > 0 else (0.0, 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _within(x, size):  # pragma: no cover - compiled
    """A coordinate between pixels of a picture of this size; NaN is 0."""
    if not x > 0:
        return 0.0
    return x if x < size - 1.001 else size - 1.001


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _width(mean, centres, half):  # pragma: no cover - compiled
    """Standard deviation px of the mean profiles (4, s) at half (4,) * centres (s,), median
    of the sides; the window's narrowing is taken out.
    """
    seen = np.ones(4)
    for side in range(4):
        at, most = half[side] * centres, half[side] ** 2
        profile = np.maximum(mean[side], 0.0) * np.exp(-2.0 * centres * centres)
        square = _moments(profile, at)[0]
        own = 1 / (1 / square - 4 / most)
        if np.isfinite(square):
            seen[side] = min(max(own, 0.04), most) if np.isfinite(own) and own > 0 else most
    sort(seen)
    return np.sqrt((seen[1] + seen[2]) / 2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moments(profile, at):  # pragma: no cover - compiled
    """Means of the square and of the cube of `at` about its mean, under a profile; not
    finite where that sums up to nothing.
    """
    total = profile.sum()
    centre = (profile * at).sum() / total
    d = at - (centre if np.isfinite(centre) else 0.0)
    return (profile * d * d).sum() / total, (profile * d * d * d).sum() / total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fit(seen, f, ends):  # pragma: no cover - compiled
    """Robust line per side (iterated, Geman-McClure) through samples that are there: ends
    (4, 2) px; returns their spread px.
    """
    scales = np.empty(4)
    for side in range(4):
        v, there = seen[0, side], seen[1, side]
        weight, absent = there, len(f) - int(there.sum())
        for k in range(_ROUNDS):
            w0, w1, w2, v0, v1 = 0.0, 0.0, 0.0, 0.0, 0.0
            for m in range(len(f)):
                wf = weight[m] * f[m]
                w0 += weight[m]
                w1 += wf
                w2 += wf * f[m]
                v0 += weight[m] * v[m]
                v1 += wf * v[m]
            det = w0 * w2 - w1 * w1
            at0, grade = (w2 * v0 - w1 * v1) / det, (w0 * v1 - w1 * v0) / det
            if not (np.isfinite(at0) and np.isfinite(grade)):
                at0, grade = 0.0, 0.0
            if k < _ROUNDS - 1:  # the last round only needs the line
                size = np.abs(v - at0 - grade * f)
                ordered = there * size + (there - 1.0)  # below 0 where there is none
                sort(ordered)
                scales[side] = 1.4826 * ordered[(len(f) + absent) // 2] + 1e-3
                root = 1.0 + size * size / (2.5 * scales[side]) ** 2
                weight = there / (root * root)
        ends[side, 0], ends[side, 1] = at0, at0 + grade
    sort(scales)
    return (scales[1] + scales[2]) / 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(quad, ends):  # pragma: no cover - compiled
    """Corners (4, 2) where the moved sides meet; not finite where two are parallel."""
    p, d, out = np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 2))
    for side in range(4):
        chord = quad[(side + 1) % 4] - quad[side]
        normal = np.array(_normal(chord[0], chord[1]))
        p[side] = quad[side] + normal * ends[side, 0]
        d[side] = chord + normal * (ends[side, 1] - ends[side, 0])
    for side in range(4):
        gap, e = p[side] - p[side - 1], d[side - 1]  # the side before: they meet here
        cross = e[0] * d[side, 1] - e[1] * d[side, 0]
        out[side] = p[side - 1] + e * ((gap[0] * d[side, 1] - gap[1] * d[side, 0]) / cross)
    return out
