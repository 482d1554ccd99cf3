"""The object's light once for every 2 x 2 pixels, its colour in every pixel: how draft shades.

What a surface sends to the camera is linear in its albedo. So a block's most covered pixel is shaded in white and in black;
both are linear between the middles of covered blocks, and every pixel puts its own albedo between them, its coverage and what it
emits. Blocks lie on the picture's even rows and columns: a crop has those of the whole. Cost: O(covered pixels), a few operations
each, and a quarter of shading's. What it loses: edges of shadows and highlights finer than two pixels, normals of bump maps."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.layers import packed
from arfx.core.rect import Rect
from arfx.stages.four import put_four
from arfx.stages.lightmap.shading import Surface, covered_span

BLOCK_PX = 2
_AROUND_PX = 2  # a pixel's light may come from the next block
_FAST = {"contract", "nsz", "arcp"}
_U = np.uint64  # an index of that type is not looked at for a minus: loops stay simple


def blocks_around(rect: Rect) -> Rect:
    """All pixels of the blocks that those of `rect` are lit by."""
    return rect.pad(_AROUND_PX).align(BLOCK_PX, BLOCK_PX)


def block_surface(surface: Surface, y0: int, x0: int) -> Surface:
    """Of every block its most covered pixel, whole and black; coverage 0 where there is none. y0, x0 : first pixel"""
    h, w = surface.coverage.shape
    top, left = y0 % BLOCK_PX, x0 % BLOCK_PX
    shape = -(-(top + h) // BLOCK_PX), -(-(left + w) // BLOCK_PX)
    coverage, (normal, position, material, nothing) = (
        np.zeros(shape, np.float32),
        np.zeros((4, *shape, 3), np.float32),
    )
    _select(
        surface.coverage,
        surface.normal,
        surface.position,
        surface.material,
        top,
        left,
        coverage,
        normal,
        position,
        material,
    )
    return Surface(coverage, normal, position, nothing, material, nothing)


@line_kernel()
def _select(
    coverage, normal, position, material, top, left, whole, n, p, m
):  # pragma: no cover - compiled
    """whole, n, p, m : of the blocks;  top, left : rows and columns of the first block that lie before the arrays' first"""
    rows, columns = coverage.shape
    none, one = np.float32(0), np.float32(1)
    for j in range(whole.shape[0]):
        y0, y1 = _U(max(2 * j - top, 0)), _U(min(2 * j - top + 1, rows - 1))
        for i in range(whole.shape[1]):
            x0, x1 = _U(max(2 * i - left, 0)), _U(min(2 * i - left + 1, columns - 1))
            best, y, x = coverage[y0, x0], y0, x0
            if not best >= one:
                if coverage[y0, x1] > best:
                    best, x = coverage[y0, x1], x1
                if coverage[y1, x0] > best:
                    best, y, x = coverage[y1, x0], y1, x0
                if coverage[y1, x1] > best:
                    best, y, x = coverage[y1, x1], y1, x1
                if not best > none:
                    continue
            v, u = _U(j), _U(i)
            whole[v, u] = one
            n[v, u, 0], n[v, u, 1], n[v, u, 2] = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            p[v, u, 0], p[v, u, 1], p[v, u, 2] = (
                position[y, x, 0],
                position[y, x, 1],
                position[y, x, 2],
            )
            m[v, u, 0], m[v, u, 1], m[v, u, 2] = (
                material[y, x, 0],
                material[y, x, 1],
                material[y, x, 2],
            )


def colour(
    surface: Surface, y0: int, x0: int, whole: np.ndarray, white: np.ndarray, black: np.ndarray
) -> np.ndarray:
    """(h, w, 3) float32 radiance, premultiplied by the coverage.

    whole (rows, columns) : coverage of the blocks, 0 or 1;  white, black (rows, columns, 3) : radiance of such surfaces there"""
    out = np.zeros((*surface.coverage.shape, 3), np.float32)
    coverage, albedo, emissive = (
        packed(a) for a in (surface.coverage, surface.albedo, surface.emissive)
    )
    _colour(
        coverage, albedo, emissive, y0 % BLOCK_PX, x0 % BLOCK_PX, whole, white - black, black, out
    )
    return out


@numba.njit(cache=True, nogil=True)
def _colour(
    coverage, albedo, emissive, top, left, whole, slope, black, out
):  # pragma: no cover - compiled
    """slope : what albedo 1 adds"""
    rows, columns = coverage.shape
    n = whole.shape[1]
    # lines in threes, with one block more at both ends, which counts for nothing
    share, side = np.zeros(3 * n + 6, np.float32), np.zeros(3 * n + 10, np.float32)
    middle, halves = np.zeros(3 * n + 6, np.float32), np.empty((2, 3 * n + 6), np.float32)
    lines, cover = np.empty((2, 6 * n + 8), np.float32), np.empty(3 * columns + 4, np.float32)
    for y in range(rows):
        first, last = covered_span(coverage[y])
        if last < first:
            continue
        j, lower = (y + top) // 2, (y + top) % 2
        k = min(max(j + 2 * lower - 1, 0), whole.shape[0] - 1)
        a, b = max((first + left) // 2 - 1, 0), min((last + left) // 2 + 2, n)
        _thrice(whole[k, a:b], np.float32(0.25), share)
        side[:3] = 0
        _thrice(whole[j, a:b], np.float32(0.25), side[3:])
        side[3 + 3 * (b - a) : 6 + 3 * (b - a)] = 0
        for source, line in ((slope, lines[0]), (black, lines[1])):
            own, other = source[j, a:b].reshape(-1), source[k, a:b].reshape(-1)
            _between(own, other, share, middle[3:])
            _sides(middle, side, 3 * (b - a), halves[0], halves[1])
            _interleave(halves[0], halves[1], b - a, line)
        s = 3 * (first + left - 2 * a)
        _thrice(coverage[y, first : last + 1], np.float32(1), cover)
        to = out[y, first : last + 1].reshape(-1)
        _combine(albedo[y, first : last + 1].reshape(-1), lines[0, s:], lines[1, s:], to)
        _finish(emissive[y, first : last + 1].reshape(-1), cover, to)


@numba.njit(cache=True, nogil=True)
def _thrice(a, factor, out):  # pragma: no cover - compiled
    for x in range(a.shape[0]):
        v = factor * a[_U(x)]
        put_four(out, 3 * x, v, v, v, v)


@line_kernel(fastmath=_FAST, error_model="numpy")
def _between(own, other, share, out):  # pragma: no cover - compiled
    for i in range(own.shape[0]):
        out[i] = own[i] + share[i] * (other[i] - own[i])


@line_kernel(fastmath=_FAST, error_model="numpy")
def _sides(middle, side, n, left, right):  # pragma: no cover - compiled
    """The left and the right pixel of blocks. middle, side : of the blocks and one more at both ends"""
    before, own, after = middle[0:n], middle[3 : n + 3], middle[6 : n + 6]
    first, last = side[0:n], side[6 : n + 6]
    for i in range(n):
        left[i] = own[i] + first[i] * (before[i] - own[i])
    for i in range(n):
        right[i] = own[i] + last[i] * (after[i] - own[i])


@numba.njit(cache=True, nogil=True)
def _interleave(left, right, n, out):  # pragma: no cover - compiled
    for i in range(n):
        at = _U(3) * _U(i)
        put_four(out, 6 * i, left[at], left[at + _U(1)], left[at + _U(2)], np.float32(0))
        put_four(out, 6 * i + 3, right[at], right[at + _U(1)], right[at + _U(2)], np.float32(0))


@line_kernel(fastmath=_FAST, error_model="numpy")
def _combine(albedo, slope, black, out):  # pragma: no cover - compiled
    for i in range(out.shape[0]):
        out[i] = albedo[i] * slope[i] + black[i]


@line_kernel(fastmath=_FAST, error_model="numpy")
def _finish(glow, cover, out):  # pragma: no cover - compiled
    for i in range(out.shape[0]):
        out[i] = cover[i] * (out[i] + glow[i])
