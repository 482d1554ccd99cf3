"""The printed measure of edges on the smoothed picture of half the size, in one pass: a row is halved, smoothed, and measured
while it is still in the cache. A Gaussian of few taps, in steps of a vector unit, takes a third of what cv2.GaussianBlur does.
Borders are replicated. Cost: O(pixels). Source: as edges.py."""

from __future__ import annotations

import cv2
import numba
import numpy as np

from arfx.core.parallel import parallel_rows
from arfx.stages.watercolor.rows import Picture, read_pixels

_FAST = {"contract", "nsz", "arcp"}
_U = np.uint64  # an index of that type is not looked at for a minus: loops stay simple
REACH = 5  # px to each side that the taps go
_RING = 16  # rows in the buffer: more than the taps reach over


def edge_measure(
    picture: Picture, yuv: np.ndarray, alpha: float, beta: float, smooth_px: float
) -> np.ndarray:
    """(3, ceil(h / 2), ceil(w / 2)) float32: the printed measure, and the direction across the edge (x, y).

    yuv : of `yuv_matrix`;  alpha, beta : as there;  smooth_px : of the full picture"""
    sigma = max(smooth_px / 2, 0.3)
    h, w = ((n + 1) // 2 for n in picture.image.shape[:2])
    made, taps = np.empty((3, h, w), np.float32), gaussian_taps(sigma)
    numbers = yuv.astype(np.float32), np.float32(alpha), np.float32(beta)
    if len(taps):
        parallel_rows(lambda a, b: _in_one_pass(picture, taps, *numbers, a, b, made), h)
        return made
    smooth = np.empty((h, 3, w), np.float32)
    parallel_rows(lambda a, b: _halve_rows(picture, a, b, smooth), h)
    for c in range(3):
        plane = np.ascontiguousarray(smooth[:, c])
        smooth[:, c] = cv2.GaussianBlur(plane, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    parallel_rows(lambda a, b: _measure_rows(smooth, *numbers, a, b, made), h)
    return made


@numba.njit(cache=True, nogil=True)
def _in_one_pass(
    picture: Picture, taps, luma, alpha, beta, ya, yb, out
):  # pragma: no cover - compiled
    """Rows ya ... yb - 1 of out (3, h, w)."""
    h, w = out.shape[1:]
    half, ring, smooth = (
        np.empty((1, 3, w), np.float32),
        np.empty((_RING, 3, w), np.float32),
        np.empty((4, 3, w), np.float32),
    )
    lines, both = (
        np.empty((2, 3 * picture.image.shape[1]), np.float32),
        np.empty(3 * picture.image.shape[1], np.float32),
    )
    padded, slope = np.empty(w + 2 * REACH, np.float32), np.empty((6, w), np.float32)
    first, last, how = max(ya - 1, 0), min(yb + 1, h), (luma, alpha, beta)
    to_come = max(first - REACH, 0)
    for y in range(first, last):
        while to_come <= min(y + REACH, h - 1):
            _halve_row(picture, to_come, lines, both, half[0])
            for c in range(3):
                smooth_along(half[0, c], padded, taps, ring[to_come % _RING, c])
            to_come += 1
        for c in range(3):
            smooth_across(ring, c, y, h - 1, taps, smooth[y % 4, c])
        m = y - 1
        if m >= ya:
            _measure_row(
                smooth[max(m - 1, 0) % 4],
                smooth[m % 4],
                smooth[y % 4],
                *how,
                slope,
                out[0, m],
                out[1, m],
                out[2, m],
            )
    if yb == h:
        m = h - 1
        _measure_row(
            smooth[max(m - 1, 0) % 4],
            smooth[m % 4],
            smooth[m % 4],
            *how,
            slope,
            out[0, m],
            out[1, m],
            out[2, m],
        )


@numba.njit(cache=True, nogil=True)
def _halve_rows(picture: Picture, ya, yb, out):  # pragma: no cover - compiled
    lines, both = (
        np.empty((2, 3 * picture.image.shape[1]), np.float32),
        np.empty(3 * picture.image.shape[1], np.float32),
    )
    for y in range(ya, yb):
        _halve_row(picture, y, lines, both, out[y])


@numba.njit(cache=True, nogil=True)
def _measure_rows(smooth, luma, alpha, beta, ya, yb, out):  # pragma: no cover - compiled
    h, w = out.shape[1:]
    slope = np.empty((6, w), np.float32)
    for y in range(ya, yb):
        _measure_row(
            smooth[max(y - 1, 0)],
            smooth[y],
            smooth[min(y + 1, h - 1)],
            luma,
            alpha,
            beta,
            slope,
            out[0, y],
            out[1, y],
            out[2, y],
        )


@numba.njit(cache=True, nogil=True)
def _halve_row(picture: Picture, y, lines, both, out):  # pragma: no cover - compiled
    """out (3, w) : row y of the square roots (near to coded values) of the means of 2 x 2 pixels."""
    image, patch, py, px = picture
    y0, right = 2 * y, px + patch.shape[1]
    y1 = min(y0 + 1, image.shape[0] - 1)  # a row that has none below counts twice
    near = py <= y1 and y0 < py + patch.shape[0]
    if near:
        read_pixels(picture, y0, px, right, lines[0])
        read_pixels(picture, y1, px, right, lines[1])
    _halve(
        image[y0].reshape(-1),
        image[y1].reshape(-1),
        lines[0],
        lines[1],
        px,
        right if near else px,
        both,
        out,
    )


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _halve(
    top, bottom, near_top, near_bottom, left, right, both, out
):  # pragma: no cover - compiled
    """Two rows of the picture, of which pixels left ... right - 1 are near_top and near_bottom. both (3 w,) is written."""
    w, n = top.shape[0] // 3, out.shape[1]
    zero, one, quarter = np.float32(0), np.float32(1), np.float32(0.25)
    for i in range(3 * w):
        both[i] = top[i] + bottom[i]
    for i in range(3 * left, 3 * right):
        both[_U(i)] = near_top[_U(i)] + near_bottom[_U(i)]
    for c in range(3):
        to = out[c]
        for m in range(w // 2):
            a = _U(6) * _U(m) + _U(c)
            to[m] = both[a] + both[a + _U(3)]
        if w % 2:
            to[w // 2] = both[3 * (w - 1) + c] * np.float32(2)
        for m in range(n):
            to[m] = np.sqrt(min(max(to[m] * quarter, zero), one))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _measure_row(
    above, here, below, luma, alpha, beta, slope, measure, across_x, across_y
):  # pragma: no cover - compiled
    """measure (w,) : as printed, from central differences, per px of this grid;  across_x, across_y (w,) : direction across the
    edge. above, here, below (3, w);  slope (6, w) is written: along x and y, of each colour"""
    half, third, one = np.float32(0.5), np.float32(1.0 / 3.0), np.float32(1)
    y0, y1, y2 = luma[0]
    u0, u1, u2 = luma[1]
    v0, v1, v2 = luma[2]
    for c in range(3):
        _slopes(above[c], here[c], below[c], slope[2 * c], slope[2 * c + 1])
    for x in range(here.shape[1]):
        ax, ay, bx, by, cx, cy = (
            slope[0, x],
            slope[1, x],
            slope[2, x],
            slope[3, x],
            slope[4, x],
            slope[5, x],
        )
        a, b, c = np.sqrt(ax * ax + ay * ay), np.sqrt(bx * bx + by * by), np.sqrt(cx * cx + cy * cy)
        yx, yy = y0 * ax + y1 * bx + y2 * cx, y0 * ay + y1 * by + y2 * cy
        ux, uy = u0 * ax + u1 * bx + u2 * cx, u0 * ay + u1 * by + u2 * cy
        vx, vy = v0 * ax + v1 * bx + v2 * cx, v0 * ay + v1 * by + v2 * cy
        of_y, of_u, of_v = (
            np.sqrt(yx * yx + yy * yy),
            np.sqrt(ux * ux + uy * uy),
            np.sqrt(vx * vx + vy * vy),
        )
        of_yuv = (one - alpha) * of_y + alpha * half * (of_u + of_v)
        measure[x] = beta * of_yuv + (one - beta) * third * (a + b + c)
        # across: the strongest channel's
        gx, gy, most = bx if b > a else ax, by if b > a else ay, max(a, b)
        gx, gy = cx if c > most else gx, cy if c > most else gy
        scale = one / max(max(most, c), np.float32(1e-6))
        across_x[x], across_y[x] = gx * scale, gy * scale


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _slopes(above, here, below, dx, dy):  # pragma: no cover - compiled
    w, half, one, two = here.shape[0], np.float32(0.5), np.uint64(1), np.uint64(2)
    for x in range(w):
        dy[x] = (below[x] - above[x]) * half
    for x in range(w - 2):
        dx[np.uint64(x) + one] = (here[np.uint64(x) + two] - here[x]) * half
    dx[0] = (here[min(1, w - 1)] - here[0]) * half
    dx[w - 1] = (here[w - 1] - here[max(w - 2, 0)]) * half


def gaussian_taps(sigma: float) -> np.ndarray:
    """(REACH + 1,) float32 weights of the middle and of what lies 1 ... REACH px off it; empty where sigma is too large."""
    if sigma > REACH / 3:
        return np.zeros(0, np.float32)
    weight = np.exp(-0.5 * (np.arange(REACH + 1) / sigma) ** 2)
    return (weight / (2 * weight.sum() - weight[0])).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def smooth_along(row, padded, taps, out):  # pragma: no cover - compiled
    """out (w,) : a row smoothed along itself. padded (w + 2 REACH,) is written"""
    w = row.shape[0]
    padded[:REACH] = row[0]
    for x in range(w):
        padded[x + REACH] = row[x]
    padded[w + REACH :] = row[w - 1]
    t0, t1, t2, t3, t4, t5 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5]
    for x in range(w):
        i = _U(x)
        s = t0 * padded[i + _U(5)] + t1 * (padded[i + _U(4)] + padded[i + _U(6)])
        s += t2 * (padded[i + _U(3)] + padded[i + _U(7)]) + t3 * (
            padded[i + _U(2)] + padded[i + _U(8)]
        )
        s += t4 * (padded[i + _U(1)] + padded[i + _U(9)]) + t5 * (padded[i] + padded[i + _U(10)])
        out[x] = s


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def smooth_across(ring, c, y, last, taps, out):  # pragma: no cover - compiled
    """out (w,) : row y of plane c, from the rows around it, the last of which is `last`. ring (n, 3, w) : row k is k % n"""
    n = ring.shape[0]
    _set_weighted(ring[y % n, c], taps[0], out)
    for k in range(1, REACH + 1):
        _add_weighted(ring[max(y - k, 0) % n, c], ring[min(y + k, last) % n, c], taps[k], out)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _set_weighted(a, weight, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        out[x] = weight * a[x]


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _add_weighted(a, b, weight, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        out[x] += weight * (a[x] + b[x])
