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
    ends, moved, window = np.empty((4, 2)), np.empty((4, 2)), np.empty(4)
    for i in range(len(quads)):
        quad, stats = quads[i], out[i]
        wide, blur = 0, np.nan
        for side in range(4):
            window[side] = reach[i, side] / 2
            if reach[i, side] > half[i, side]:
                wide = WIDE_ITERATIONS
        stats[OK] = 1.0
        for k in range(ITERATIONS + wide):
            far = reach[i] if k < wide else half[i]
            gain, blur, skew, inverted = _edges(
                luma, table, quad, bend[i], far, window, blur, fractions, slope, seen
            )
            stats[BLUR], stats[GAIN], stats[SKEW], stats[INVERTED] = (
                blur,
                gain,
                skew,
                inverted,
            )
            if (
                k < 3 + wide
                # the blur's estimate settles; then the window is held, so that the fixed point
                # is one
            ):
                after = reach[i] if k + 1 < wide else half[i]
                for side in range(4):
                    least = min(
                        max(WINDOW_FRACTION * half[i, side], WINDOW_PX[0]), WINDOW_PX[1]
                    )
                    window[side] = min(max(1.2 * blur, least), after[side] / 2)
            stats[SPREAD] = _fit(seen, fractions, ends)
            _meet(quad, ends, moved)
            step = 0.0
            finite = True
            for c in range(4):
                for j in range(2):
                    finite = finite and np.isfinite(moved[c, j])
                    step = max(step, abs(moved[c, j] - quad[c, j]))
            if not (finite and gain > least_gain[i]):
                stats[OK] = 0.0
                break
            for c in range(4):
                quad[c, 0], quad[c, 1] = moved[c, 0], moved[c, 1]
            if step <= CONVERGED_PX and k >= 2 + wide:
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _edges(
    luma, table, quad, bend, half, window, blur, fractions, slope, seen
):  # pragma: no cover - compiled
    """Where the four edges are along their normals: seen (2, 4, SAMPLES), px inwards from
    the chord; 1, or 0 where a normal shows too faint an edge.

    half, window : (4,) px of each side;  blur : NaN at first;  slope (4, SAMPLES, STEPS -
    1) : work space
    Returns the least slope of a side, the blur's standard deviation px, its skew, and 1.0
    for white on black."""
    h, w = luma.shape
    offset, there = seen[0], seen[1]
    samples, steps = len(fractions), slope.shape[2] + 1
    last_x, last_y = w - 1.001, h - 1.001
    total = 0.0
    for side in range(4):
        spacing = 2 * half[side] / (steps - 1)
        ax, ay = quad[side, 0], quad[side, 1]
        cx, cy = quad[(side + 1) % 4, 0] - ax, quad[(side + 1) % 4, 1] - ay
        length = np.sqrt(cx * cx + cy * cy)
        nx, ny = 0.0, 0.0  # normal, to the inside of a clockwise quad
        if length > 0:
            nx, ny = -cy / length, cx / length
        for m in range(samples):
            mx, my = (
                ax + cx * fractions[m] + bend[side, m, 0],
                ay + cy * fractions[m] + bend[side, m, 1],
            )
            before = 0.0
            for s in range(steps):
                along = half[side] * (s / ((steps - 1) / 2) - 1)
                # bilinear, in linear light, exact coordinates (cv2.remap rounds them to
                # 1/32 px); borders are replicated
                x, y = mx + nx * along, my + ny * along
                if not x > 0:  # also NaN
                    x = 0.0
                elif x > last_x:
                    x = last_x
                if not y > 0:
                    y = 0.0
                elif y > last_y:
                    y = last_y
                xi, yi = int(x), int(y)
                fx, fy = x - xi, y - yi
                a, b = table[luma[yi, xi]], table[luma[yi, xi + 1]]
                c, d = table[luma[yi + 1, xi]], table[luma[yi + 1, xi + 1]]
                top = a + (b - a) * fx
                light = top + (c + (d - c) * fx - top) * fy
                if s:
                    g = (before - light) / spacing
                    slope[side, m, s - 1] = g
                    total += g
                before = light
    inverted = 1.0 if total < 0 else 0.0  # else bright outside, dark inside: positive
    sign = -1.0 if total < 0 else 1.0
    mean, narrow, at, boost = (
        np.zeros((4, steps - 1)),
        np.empty((4, steps - 1)),
        np.empty((4, steps - 1)),
        np.ones(4),
    )
    for side in range(4):
        if np.isfinite(
            blur
        ):  # a window of width w over an edge of width b sees only w2 / (w2 + b2) of a displacement
            boost[side] = min(
                (blur * blur + window[side] * window[side]) / (window[side] * window[side]),
                3.0,
            )
        for s in range(steps - 1):
            at[side, s] = half[side] * ((s + 0.5) / ((steps - 1) / 2) - 1)
            narrow[side, s] = np.exp(-0.5 * (at[side, s] / window[side]) ** 2)
    gain, own, ordered = np.inf, np.empty(samples), np.empty(samples)
    for side in range(4):
        for m in range(samples):
            own[m] = 0.0
            for s in range(steps - 1):
                own[m] += sign * slope[side, m, s] * narrow[side, s]
            ordered[m] = own[m]
        sort(ordered)
        usual, count = ordered[3 * samples // 4], 0.0
        for m in range(samples):
            there[side, m] = 0.0 if usual > 0 and own[m] < _THERE * usual else 1.0
            count += there[side, m]
            for s in range(steps - 1):
                mean[side, s] += there[side, m] * slope[side, m, s]
        mass = 0.0
        for s in range(steps - 1):
            mean[side, s] *= sign / count
            mass += mean[side, s] * narrow[side, s]
        gain = min(gain, mass)
        for m in range(samples):
            first = 0.0
            for s in range(steps - 1):
                first += slope[side, m, s] * narrow[side, s] * at[side, s]
            e = sign * first / mass * boost[side]
            offset[side, m] = (
                min(max(e, -half[side]), half[side]) if np.isfinite(e) else 0.0
            )
    blur_px = _width(mean, at, half)
    third, near = 0.0, np.empty(steps - 1)
    for side in range(4):
        for s in range(steps - 1):
            near[s] = mean[side, s] * np.exp(-0.5 * (at[side, s] / (1.5 * blur_px)) ** 2)
        cube = _moments(near, at[side])[1]
        third += (cube if np.isfinite(cube) else 0.0) / 4
    return gain, blur_px, third / blur_px**3, inverted


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _width(mean, at, half):  # pragma: no cover - compiled
    """Standard deviation px of the mean profiles (4, s) at (4, s), median of the sides; the
    window's narrowing is taken out.
    """
    seen, wide = np.empty(4), np.empty(at.shape[1])
    for side in range(4):
        for s in range(len(wide)):
            wide[s] = max(mean[side, s], 0.0) * np.exp(
                -0.5 * (at[side, s] / (half[side] / 2)) ** 2
            )
        square = _moments(wide, at[side])[0]
        own = 1 / (1 / square - 1 / (half[side] / 2) ** 2)
        own = (
            min(max(own, 0.04), half[side] ** 2)
            if np.isfinite(own) and own > 0
            else half[side] ** 2
        )
        seen[side] = own if np.isfinite(square) else 1.0
    sort(seen)
    return np.sqrt((seen[1] + seen[2]) / 2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moments(profile, at):  # pragma: no cover - compiled
    """Means of the square and of the cube of `at` about its mean, under a profile; not
    finite where that sums up to nothing.
    """
    total, first, square, cube = 0.0, 0.0, 0.0, 0.0
    for s in range(len(at)):
        total += profile[s]
        first += profile[s] * at[s]
    centre = first / total if np.isfinite(first / total) else 0.0
    for s in range(len(at)):
        d = at[s] - centre
        square += profile[s] * (d * d)
        cube += profile[s] * (d * (d * d))
    return square / total, cube / total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fit(seen, f, ends):  # pragma: no cover - compiled
    """Robust line per side (iterated, Geman-McClure) through samples that are there: ends
    (4, 2) px; returns their spread px.
    """
    samples, offset, there = len(f), seen[0], seen[1]
    weight, size, ordered, scales = (
        np.empty(samples),
        np.empty(samples),
        np.empty(samples),
        np.empty(4),
    )
    for side in range(4):
        v = offset[side]
        for m in range(samples):
            weight[m] = there[side, m]
        for k in range(_ROUNDS):
            w0, w1, w2, v0, v1 = 0.0, 0.0, 0.0, 0.0, 0.0
            for m in range(samples):
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
                absent = 0
                for m in range(samples):
                    size[m] = abs(v[m] - at0 - grade * f[m])
                    ordered[m] = size[m] if there[side, m] > 0 else -1.0
                    absent += there[side, m] == 0
                sort(ordered)
                scale = 1.4826 * ordered[(samples + absent) // 2] + 1e-3
                for m in range(samples):
                    weight[m] = there[side, m] / (1.0 + (size[m] / (2.5 * scale)) ** 2) ** 2
                scales[side] = scale
        ends[side, 0], ends[side, 1] = at0, at0 + grade
    sort(scales)
    return (scales[1] + scales[2]) / 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(quad, ends, out):  # pragma: no cover - compiled
    """Corners (4, 2) where the moved sides meet; NaN where two are parallel."""
    p, d = np.empty((4, 2)), np.empty((4, 2))
    for side in range(4):
        ax, ay = quad[side, 0], quad[side, 1]
        bx, by = quad[(side + 1) % 4, 0], quad[(side + 1) % 4, 1]
        length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        nx, ny = 0.0, 0.0
        if length > 0:
            nx, ny = -(by - ay) / length, (bx - ax) / length
        p[side, 0], p[side, 1] = ax + nx * ends[side, 0], ay + ny * ends[side, 0]
        d[side, 0], d[side, 1] = (
            bx + nx * ends[side, 1] - p[side, 0],
            by + ny * ends[side, 1] - p[side, 1],
        )
    for side in range(4):
        q, e = p[side - 1], d[side - 1]  # the side before: they meet in this corner
        cross = e[0] * d[side, 1] - e[1] * d[side, 0]
        fraction = (
            (p[side, 0] - q[0]) * d[side, 1] - (p[side, 1] - q[1]) * d[side, 0]
        ) / cross
        if not np.isfinite(fraction):
            fraction = np.nan
        out[side, 0], out[side, 1] = q[0] + e[0] * fraction, q[1] + e[1] * fraction
