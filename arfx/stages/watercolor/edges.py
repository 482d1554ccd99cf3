"""Lines: the printed measure of edges in RGB and Y'UV (papers/s3_watercolor.py), as soft thin lines that hold still.

The measure is taken on a smoothed picture of half the size, only its ridges (line width in px), faded in between two
thresholds, kept where a line is strong somewhere (hysteresis). Edges of the virtual object also come from its coverage,
normals and depth. Cost: O(pixels). Source: docs/methods/watercolor.md#edges."""

from __future__ import annotations

import cv2
import numba
import numpy as np

from arfx.core.colour import LUMA_COEFFICIENTS
from arfx.core.layers import packed
from arfx.core.parallel import BANDS, parallel_rows

_FAST = {"contract", "nsz", "arcp"}


def yuv_matrix(name: str = "bt601") -> np.ndarray:
    """(3, 3) float64 analogue Y'UV of R'G'B': U = .492 (B' - Y'), V = .877 (R' - Y')."""
    kr, kb = LUMA_COEFFICIENTS[name]
    y = np.array([kr, 1 - kr - kb, kb])
    return np.stack([y, 0.492 * (np.array([0.0, 0, 1]) - y), 0.877 * (np.array([1.0, 0, 0]) - y)])


def trace_lines(
    made: np.ndarray,
    low: float,
    high: float,
    width_px: float,
    virtual: np.ndarray | None = None,
    at: tuple[int, int] = (0, 0),
) -> np.ndarray:
    """(ceil(h / 2), ceil(w / 2)) float32 strength of lines, 0..1, of what was `edge_measure`, which is changed where the object's
    own edges are.

    low, high : of the printed measure per px of the full picture: below low there is no line, a line that nowhere reaches
    high fades out;  width_px : of the full picture;  virtual : of `virtual_edges`, on the same grid, its first pixel at
    (row, column) `at`"""
    measure, dx, dy = made
    h, w = measure.shape
    if virtual is not None and virtual.size:
        y, x = at
        part = made[:, y : y + virtual.shape[0], x : x + virtual.shape[1]]
        _add_virtual(part[0], part[1], part[2], virtual, np.float32(high))
    line = np.zeros((h, w), np.float32)
    weak = np.zeros((h, w), np.uint8)
    offset = np.float32(max(width_px / 2, 0.75))
    parallel_rows(
        lambda a, b: _ridge(
            measure, dx, dy, offset, np.float32(low), np.float32(high), a, b, line, weak
        ),
        h,
    )
    count, parts = cv2.connectedComponents(weak, connectivity=8, ltype=cv2.CV_32S)
    strongest = np.zeros((BANDS, count), np.float32)
    rows = -(-h // BANDS)
    parallel_rows(lambda a, b: _strongest(measure, parts, a, b, strongest[a // rows]), h)
    most = strongest.max(0)
    most[0] = 0
    parallel_rows(
        lambda a, b: _hysteresis(most, parts, np.float32(low), np.float32(high), a, b, line), h
    )
    return line


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _ridge(measure, dx, dy, offset, low, high, ya, yb, line, weak):  # pragma: no cover - compiled
    """Strength of lines before hysteresis: high where the measure is larger than `offset` px to both sides."""
    _h, w = measure.shape
    one, zero = np.float32(1), np.float32(0)
    for y in range(ya, yb):
        for x in range(w):
            e = measure[y, x]
            if e <= low:
                continue
            ox, oy = dx[y, x] * offset, dy[y, x] * offset
            other = max(_at(measure, x + ox, y + oy), _at(measure, x - ox, y - oy))
            ridge = min(max(np.float32(0.8) + (e - other) / (np.float32(0.35) * e), zero), one)
            t = min((e - low) / max(high - low, np.float32(1e-6)), one)
            line[y, x] = ridge * t * t * (np.float32(3) - np.float32(2) * t)
            weak[y, x] = ridge > np.float32(0.25)


@numba.njit(cache=True, nogil=True, inline="always")
def _at(a, x, y):  # pragma: no cover - compiled
    h, w = a.shape
    x, y = (
        min(max(x, np.float32(0)), np.float32(w - 1)),
        min(max(y, np.float32(0)), np.float32(h - 1)),
    )
    i, j = np.int32(x), np.int32(y)
    s, t = x - np.float32(i), y - np.float32(j)
    k, m = min(i + 1, w - 1), min(j + 1, h - 1)
    top = a[j, i] + s * (a[j, k] - a[j, i])
    bottom = a[m, i] + s * (a[m, k] - a[m, i])
    return top + t * (bottom - top)


@numba.njit(cache=True, nogil=True)
def _strongest(measure, parts, ya, yb, most):  # pragma: no cover - compiled
    """most (count,) : of each connected line, over some rows."""
    for y in range(ya, yb):
        for x in range(measure.shape[1]):
            k = parts[y, x]
            if k > 0:
                most[k] = max(most[k], measure[y, x])


@numba.njit(cache=True, nogil=True)
def _hysteresis(most, parts, low, high, ya, yb, line):  # pragma: no cover - compiled
    """Fade each connected line by how far its strongest point gets from low to high."""
    for y in range(ya, yb):
        for x in range(line.shape[1]):
            if line[y, x] > 0:
                t = (most[parts[y, x]] - low) / max(high - low, np.float32(1e-6))
                t = min(max(t, np.float32(0)), np.float32(1))
                line[y, x] *= t * t * (np.float32(3) - np.float32(2) * t)


def virtual_edges(
    coverage: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    opacity: float,
    at: tuple[int, int] = (0, 0),
    shape: tuple[int, int] | None = None,
    every: int = 1,
) -> np.ndarray:
    """(ceil(h / 2), ceil(w / 2)) float32, 0..1: silhouettes from coverage and depth, creases from normals.

    coverage (bh, bw), normal (bh, bw, 3), depth (bh, bw) metres; a depth that is not finite is none
    shape (h, w) : of the part of the picture looked at, in which the arrays begin at (row, column) `at`, around them nothing
    every : one in so many of its pixels along x and y is looked at, and h, w are their numbers"""
    h, w = (-(-n // every) for n in shape or coverage.shape)
    out = np.zeros(((h + 1) // 2, (w + 1) // 2), np.float32)
    if opacity > 0 and coverage.any():
        last_y, last_x = every * (h - 1), every * (w - 1)
        layers = packed(coverage), packed(normal), packed(depth)
        _virtual(*layers, np.float32(opacity), *at, last_y, last_x, 2 * every, out)
    return out


@numba.njit(cache=True, nogil=True)
def _virtual(
    coverage, normal, depth, opacity, top, left, last_y, last_x, pitch, out
):  # pragma: no cover - compiled
    bh, bw = coverage.shape
    zero, one = np.float32(0), np.float32(1)
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            y, x = pitch * j - top, pitch * i - left
            here = 0 <= y < bh and 0 <= x < bw
            best = zero
            for m in range(2):
                y2, x2 = (
                    (y, min(x + pitch, last_x - left))
                    if m == 0
                    else (min(y + pitch, last_y - top), x)
                )
                a = coverage[y, x] if here else zero
                b = coverage[y2, x2] if 0 <= y2 < bh and 0 <= x2 < bw else zero
                if a <= zero and b <= zero:
                    continue
                e = abs(a - b)
                if a > zero and b > zero:
                    dot = zero
                    for c in range(3):
                        dot += normal[y, x, c] * normal[y2, x2, c]
                    # a crease of 60 degrees counts as a whole edge
                    e = max(
                        e,
                        min(max((np.float32(0.95) - dot) * np.float32(2.2), zero), one) * min(a, b),
                    )
                    za, zb = depth[y, x], depth[y2, x2]
                    if np.isfinite(za) and np.isfinite(zb) and za > 0 and zb > 0:
                        jump = abs(za - zb) / min(za, zb)
                        e = max(
                            e,
                            min(max((jump - np.float32(0.03)) * np.float32(20), zero), one)
                            * min(a, b),
                        )
                best = max(best, e)
            out[j, i] = min(best * opacity, one)


@numba.njit(cache=True, nogil=True)
def _add_virtual(measure, dx, dy, virtual, high):  # pragma: no cover - compiled
    """Let edges of the object count as lines of strength `high`, across their own gradient."""
    h, w = measure.shape
    for y in range(h):
        for x in range(w):
            e = virtual[y, x] * high * np.float32(1.5)
            if e > measure[y, x]:
                gx = virtual[y, min(x + 1, w - 1)] - virtual[y, max(x - 1, 0)]
                gy = virtual[min(y + 1, h - 1), x] - virtual[max(y - 1, 0), x]
                n = np.sqrt(gx * gx + gy * gy)
                if n > np.float32(1e-3):
                    dx[y, x], dy[y, x] = gx / n, gy / n
                measure[y, x] = e
