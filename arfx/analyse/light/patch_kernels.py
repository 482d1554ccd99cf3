"""The compiled part of patches.py: where the samples of a print lie, and robust means of
them by colour and quarter.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numba
import numpy as np

from arfx.analyse.pose.kernels import sort

PATCHES = 8
MARGIN, MOST_MARGIN = (
    0.2,
    0.45,
)  # of a cell that is left out at each side: the inner 60 % remain, at least 10 %
# A bilinear sample has 4/9 of a pixel's noise variance, on average; samples nearer than 1.5
# px have that noise in common.
SHARED_PX2 = 9 / 4
FEWEST = 4  # samples that make a patch
LEAST_STEP_PX = 1.25  # between samples: nearer ones tell next to nothing more
BLURS = 2.5  # margin in standard deviations of the blur
MOST_SAMPLES = 5  # per cell and axis
OUT = 3.5  # robust standard deviations beyond which a sample is no part of its patch
_GAMMA = 2.2  # about the slope of the transfer function


@numba.njit(cache=True, nogil=True, error_model="numpy")
def place_samples(
    quad, white, blur_px, columns, rows, corner, part, group, noise
):  # pragma: no cover - compiled
    """How many samples lie in the picture; for each its upper left pixel, the part to the
    next ones, and its patch.

    quad : (4, 2) top left, top right, bottom right, bottom left;  white : (n, n) int8, 1
    bright, 0 dark, -1 not used
    columns, rows : of the picture;  corner (k, 2) int32, part (k, 2), group (k,) int32 : filled
    noise (2,) : samples that share their noise, and the share of the contrast that blur
    brings in from other cells"""
    n = len(white)
    turn = 0
    for i in range(4):
        a, b, c = quad[i], quad[(i + 1) % 4], quad[(i + 2) % 4]
        cross = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        turn += 1 if cross > 0 else (-1 if cross < 0 else 0)
    if abs(turn) != 4 or columns < 1 or rows < 1:
        return 0
    # unit square to quadrilateral (Heckbert 1989, eq. 2.10), then cells
    x0, y0, x1, y1, x2, y2, x3, y3 = (
        quad[0, 0],
        quad[0, 1],
        quad[1, 0],
        quad[1, 1],
        quad[2, 0],
        quad[2, 1],
        quad[3, 0],
        quad[3, 1],
    )
    ax, ay, bx, by, sx, sy = (
        x1 - x2,
        y1 - y2,
        x3 - x2,
        y3 - y2,
        x0 - x1 + x2 - x3,
        y0 - y1 + y2 - y3,
    )
    det = ax * by - bx * ay
    g, h = (sx * by - bx * sy) / det, (ax * sy - sx * ay) / det
    ux, vx, uy, vy = x1 - x0 + g * x1, x3 - x0 + h * x3, y1 - y0 + g * y1, y3 - y0 + h * y3
    # how the plane is stretched at the middle
    d = 1 + (g + h) / 2
    mx, my = (x0 + (ux + vx) / 2) / d, (y0 + (uy + vy) / 2) / d
    j00, j01, j10, j11 = (
        (ux - mx * g) / d / n,
        (vx - mx * h) / d / n,
        (uy - my * g) / d / n,
        (vy - my * h) / d / n,
    )
    square, area = j00 * j00 + j01 * j01 + j10 * j10 + j11 * j11, abs(j00 * j11 - j01 * j10)
    gap = np.sqrt(max(square * square - 4 * area * area, 0.0))
    wide_px, cell_px = (
        np.sqrt(max((square + gap) / 2, 0.0)),
        np.sqrt(max((square - gap) / 2, 0.0)),
    )
    margin = min(max(BLURS * blur_px / max(cell_px, 1e-6), MARGIN), MOST_MARGIN)
    k = int(min(max(round((1 - 2 * margin) * cell_px / LEAST_STEP_PX), 1), MOST_SAMPLES))
    per_sample = (1 - 2 * margin) ** 2 * wide_px * cell_px / k**2  # px^2
    noise[0] = max(1.0, SHARED_PX2 / max(per_sample, 1e-6))
    nearest = (margin + (1 - 2 * margin) * 0.5 / k) * cell_px
    noise[1] = math.erfc(nearest / blur_px / np.sqrt(2.0)) if blur_px > 0 else 0.0
    count = 0
    for r in range(n):
        for c in range(n):
            if white[r, c] < 0:
                continue
            colour = 4 if white[r, c] else 0
            for i in range(k):
                v = (r + margin + (1 - 2 * margin) * (i + 0.5) / k) / n
                for j in range(k):
                    u = (c + margin + (1 - 2 * margin) * (j + 0.5) / k) / n
                    d = g * u + h * v + 1
                    x, y = (ux * u + vx * v + x0) / d, (uy * u + vy * v + y0) / d
                    if not (
                        d > 0 and x >= 0 and y >= 0 and x <= columns - 1 and y <= rows - 1
                    ):
                        continue
                    ix, iy = min(int(x), max(columns - 2, 0)), min(int(y), max(rows - 2, 0))
                    corner[count, 0], corner[count, 1] = ix, iy
                    part[count, 0], part[count, 1] = x - ix, y - iy
                    group[count] = colour + (2 if v >= 0.5 else 0) + (1 if u >= 0.5 else 0)
                    count += 1
    return count


@numba.njit(cache=True, nogil=True)
def neighbours(corner, last_x, last_y, out):  # pragma: no cover - compiled
    """out (4 k, 2) int32 = x, y of the four pixels of each sample."""
    for i in range(len(corner)):
        x0, y0 = corner[i, 0], corner[i, 1]
        x1, y1 = min(x0 + 1, last_x), min(y0 + 1, last_y)
        out[4 * i, 0], out[4 * i, 1], out[4 * i + 1, 0], out[4 * i + 1, 1] = x0, y0, x1, y0
        out[4 * i + 2, 0], out[4 * i + 2, 1], out[4 * i + 3, 0], out[4 * i + 3, 1] = (
            x0,
            y1,
            x1,
            y1,
        )


@numba.njit(cache=True, nogil=True)
def _spread_about(x, low, high, middle):  # pragma: no cover - compiled
    """Median distance of the sorted x[low:high] from their median."""
    n = high - low
    i = low
    while i < high and x[i] < middle:
        i += 1
    below, above = i - 1, i
    first, last = (n - 1) // 2, n // 2
    total, d = 0.0, 0.0
    for k in range(last + 1):
        if above >= high or (below >= low and middle - x[below] <= x[above] - middle):
            d = middle - x[below]
            below -= 1
        else:
            d = x[above] - middle
            above += 1
        if k == first:
            total += d
        if k == last:
            total += d
    return total / 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def reduce(
    pixels, part, group, scale, low, high, half_grey, mean, spread, tally
):  # pragma: no cover - compiled
    """Means, deviations (8, 3) and tally (8, 3: used, clipped, all) of the samples of each patch.

    pixels (4 k, 3) of the samples;  scale (k, 3) : factor on each sample
    low, high : linear levels at which any channel of any of the four pixels is clipped"""
    count = len(group)
    values = np.empty((PATCHES, count, 3), np.float64)
    grey, x = np.empty((PATCHES, count)), np.empty(count)
    size = np.zeros(PATCHES, np.int64)
    for i in range(count):
        g, fx, fy = group[i], part[i, 0], part[i, 1]
        tally[g, 2] += 1
        finite, clip, total = True, False, 0.0
        n = size[g]
        for c in range(3):
            a, b, e, f = (
                pixels[4 * i, c],
                pixels[4 * i + 1, c],
                pixels[4 * i + 2, c],
                pixels[4 * i + 3, c],
            )
            finite = (
                finite
                and np.isfinite(a)
                and np.isfinite(b)
                and np.isfinite(e)
                and np.isfinite(f)
            )
            clip = (
                clip
                or min(min(a, b), min(e, f)) <= low
                or max(max(a, b), max(e, f)) >= high
            )
            value = scale[i, c] * (
                (a * (1 - fx) + b * fx) * (1 - fy) + (e * (1 - fx) + f * fx) * fy
            )
            values[g, n, c] = value
            total += value
        if finite and clip:
            tally[g, 1] += 1
        elif finite:
            grey[g, n] = total / 3
            size[g] += 1
    for g in range(PATCHES):
        n = size[g]
        if n == 0:
            continue
        for i in range(n):
            x[i] = grey[g, i]
        sort(x[:n])
        a, b = np.int64(0), n
        centre, width = 0.0, np.inf
        for _ in range(4):
            centre = (x[(a + b - 1) // 2] + x[(a + b) // 2]) / 2
            step = half_grey * max(1 / 12.92, _GAMMA * max(centre, 0.0) ** (1 - 1 / _GAMMA))
            width = OUT * max(1.4826 * _spread_about(x, a, b, centre), step)
            first, last = np.int64(0), n
            while first < n and x[first] < centre - width:
                first += 1
            while last > first and x[last - 1] > centre + width:
                last -= 1
            if last - first == b - a and b - a < n:
                break
            a, b = first, last
        used = 0
        for i in range(n):
            if abs(grey[g, i] - centre) <= width:
                used += 1
                for c in range(3):
                    mean[g, c] += values[g, i, c]
        if used < FEWEST:
            for c in range(3):
                mean[g, c] = 0.0
            continue
        tally[g, 0] = used
        for c in range(3):
            mean[g, c] /= used
        for i in range(n):
            if abs(grey[g, i] - centre) <= width:
                for c in range(3):
                    spread[g, c] += (values[g, i, c] - mean[g, c]) ** 2
        for c in range(3):
            spread[g, c] = np.sqrt(spread[g, c] / max(used - 1, 1))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def uncertainty(
    mean, spread, tally, shared, leak, half_grey, cut, out
):  # pragma: no cover - compiled
    """out (8, 3) = variances of the means: noise, rounding, the share that is cut off, and
    blur from the other cells.

    cut : deviation of a mean over a sample's, for clipped shares in even steps from 0 to 1
    """
    bright, dark, whites, blacks = np.zeros(3), np.zeros(3), 0, 0
    contrast = np.zeros(3)
    for g in range(PATCHES):
        for c in range(3):
            contrast[c] = max(contrast[c], abs(mean[g, c]))
        if tally[g, 0] > 0:
            if g >= PATCHES // 2:
                whites += 1
            else:
                blacks += 1
            for c in range(3):
                (bright if g >= PATCHES // 2 else dark)[c] += mean[g, c]
    if whites and blacks:
        for c in range(3):
            contrast[c] = bright[c] / whites - dark[c] / blacks
    for g in range(PATCHES):
        if not tally[g, 0] > 0:
            continue
        clipped = tally[g, 1] / max(tally[g, 2], 1.0) * (len(cut) - 1)
        i = min(int(clipped), len(cut) - 2)
        lost = cut[i] + (clipped - i) * (cut[i + 1] - cut[i])
        for c in range(3):
            step = (
                2
                * half_grey
                * max(1 / 12.92, _GAMMA * max(mean[g, c], 0.0) ** (1 - 1 / _GAMMA))
            )
            # rounding's error is spread over its step, and is dithered away as the noise's
            # characteristic function says
            rounding = (
                step**2 / 12 * np.exp(-4 * np.pi**2 * min((spread[g, c] / step) ** 2, 2.0))
            )
            out[g, c] = (
                spread[g, c] ** 2 / max(tally[g, 0] / shared, 1e-9)
                + rounding
                + (lost * spread[g, c]) ** 2
                + (leak * contrast[c]) ** 2
            )
