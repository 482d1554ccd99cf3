"""Kernels of labels.py: what a tile of 8 x 8 pixels does with the sites around it, each loop in steps of a vector unit.

Places are whole numbers of 1/STEPS px, relative to a block's or a tile's middle, so that int32 holds every square and
float32 every packed distance; what is too far or too much for that goes through float64. Source:
docs/methods/watercolor.md#labels."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.stages.watercolor.sites import STEPS

TILE = 8
BLOCK = 2 * TILE
PIXELS = TILE * TILE
MIDDLE = STEPS * (TILE - 1) // 2  # of a tile, from its first pixel, 1/STEPS px
FAR = 15000  # 1/STEPS px; squares of sums of two such distances stay below 2^30
SOLID = 255  # a pixel this far inside its cell takes nothing of its neighbour's colour
STEP = 32  # sites
PACKED = 64  # candidates whose number fits one float32 together with their distance, exactly, ...
PACKED_LIMIT = np.float32((1 << 24) - PACKED)  # ... where that stays below this
_F, _I, _U = np.float32, np.int32, np.uint64  # an index of type uint64 is not looked at for a minus: loops stay simple
_FAST = {"contract", "nsz", "nnan", "ninf"}


class Buckets(NamedTuple):
    """Sites by squares of `side`, (gh, gw) of them. position (3, n + STEP) : x, y from the first square's corner, weight
    start (gh gw + 1), order (n,) : of `labels.bucket_sites`"""

    position: np.ndarray
    order: np.ndarray
    start: np.ndarray
    side: int | float
    gh: int
    gw: int


class LocalSites(NamedTuple):
    """Sites that a block has collected, (n,) each: position, weight, number in the buckets' order"""

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    number: np.ndarray


class Candidates(NamedTuple):
    """Candidates, (PACKED,) each: a px + b py + c as of `pack`, number in the buckets' order"""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    near: np.ndarray


@numba.njit(cache=True, nogil=True)
def collect(buckets: Buckets, y0, x0, y1, x1, mx, my, out: LocalSites):  # pragma: no cover - compiled
    """How many sites lie in the buckets that (x0, y0) ... (x1, y1) touches; these, relative to (mx, my), by number.

    Places from the first bucket's corner, 1/STEPS px; buckets at the border hold what lies beyond it."""
    position, _, start, side_px, gh, gw = buckets
    lx, ly, lw, number = out
    count, side = 0, side_px * STEPS
    left, right = min(max(x0 // side, 0), gw - 1), max(min(x1 // side, gw - 1), 0) + 1
    for i in range(min(max(y0 // side, 0), gh - 1), max(min(y1 // side, gh - 1), 0) + 1):
        a, b = start[i * gw + left], start[i * gw + right]
        for at in range(a, b, STEP):
            for m in range(STEP):  # of fixed length; what is too much is overwritten by the next row
                k, to = _U(at) + _U(m), _U(count) + _U(m)
                lx[to] = min(max(_I(position[0, k] - mx), _I(-FAR)), _I(FAR))
                ly[to] = min(max(_I(position[1, k] - my), _I(-FAR)), _I(FAR))
                lw[to] = position[2, k]
                number[to] = _I(k)
            count += STEP
        count -= -(b - a) % STEP
    return count


@numba.njit(cache=True, nogil=True)
def compact(count, found, sites: LocalSites):  # pragma: no cover - compiled
    """Only those found (count,), ascending."""
    lx, ly, lw, number = sites
    for m in range(count):
        k = _U(found[m])
        lx[m], ly[m], lw[m], number[m] = lx[k], ly[k], lw[k], number[k]


@numba.njit(cache=True, nogil=True)
def pad_far(count, sites: LocalSites):  # pragma: no cover - compiled
    """The next multiple of STEP, up to which sites follow that are too far to matter: loops end with whole steps."""
    lx, ly, lw, _ = sites
    for m in range(STEP):
        to = _U(count) + _U(m)
        lx[to], ly[to], lw[to] = FAR, FAR, 0
    return (count + STEP - 1) // STEP * STEP


@numba.njit(cache=True, nogil=True)
def sort_by_label(order, count, sites: LocalSites, spare):  # pragma: no cover - compiled
    """Sort them by the number that they have outside."""
    for m in range(count):
        spare[m] = order[sites.number[m]]
    by = np.argsort(spare[:count])
    for a in sites:
        ordered = a[:count][by]
        for m in range(count):
            a[m] = ordered[m]


@numba.njit(cache=True, nogil=True)
def bound(sites: LocalSites, count, mx, my, hx, hy):  # pragma: no cover - compiled
    """A distance, squared, that no position in a box (middle, half sides) has to its nearest site: of each quarter that of
    its farthest position to its best site."""
    lx, ly, lw, _ = sites
    b0 = b1 = b2 = b3 = _I(1 << 30)
    # the quarters' middles lie (wx, wy) off the box's; so do their own corners of them
    wx, wy = _I((hx + 1) // 2), _I((hy + 1) // 2)
    for m in range(count):
        ex, ey, weight = _I(lx[m] - mx), _I(ly[m] - my), lw[m]
        near_x, far_x = _I(abs(ex + wx) + wx), _I(abs(ex - wx) + wx)
        near_y, far_y = _I(abs(ey + wy) + wy), _I(abs(ey - wy) + wy)
        near_x, far_x = _I(near_x * near_x), _I(far_x * far_x)
        near_y, far_y = _I(near_y * near_y - weight), _I(far_y * far_y - weight)
        b0, b1 = min(b0, _I(near_x + near_y)), min(b1, _I(far_x + near_y))
        b2, b3 = min(b2, _I(near_x + far_y)), min(b3, _I(far_x + far_y))
    return max(max(b0, b1), max(b2, b3))


@numba.njit(cache=True, nogil=True)
def prune(sites: LocalSites, count, mx, my, hx, hy, limit, away, found):  # pragma: no cover - compiled
    """How many sites come to the box as near as `limit`, squared; found : which."""
    lx, ly, lw, _ = sites
    for m in range(count):
        dx, dy = max(_I(abs(_I(lx[m] - mx)) - hx), _I(0)), max(_I(abs(_I(ly[m] - my)) - hy), _I(0))
        away[m] = _I(dx * dx) + _I(dy * dy) - lw[m]
    n = np.uint64(0)
    for m in range(count):
        found[n] = m
        n += np.uint64(away[m] <= limit)
    return np.int64(n)


@numba.njit(cache=True, nogil=True)
def pack(sites: LocalSites, found, n, mx, my, reach, out: Candidates):  # pragma: no cover - compiled
    """|p - s|^2 - |p|^2 - weight and the candidate's index in the list as one number that is linear in p: ca px + cb py + cc.
    Returns the largest that comes about. p : relative to (mx, my), no farther than `reach`"""
    lx, ly, lw, number = sites
    ca, cb, cc, near = out
    limit = _F(0)
    for m in range(n):
        k = _U(found[m])
        near[m] = number[k]
        ex, ey, weight = _F(lx[k] - mx), _F(ly[k] - my), _F(lw[k])
        ca[m], cb[m] = _F(-2 * PACKED) * ex, _F(-2 * PACKED) * ey
        cc[m] = _F(PACKED) * (ex * ex + ey * ey - weight) + _F(m)
        limit = max(limit, (abs(ca[m]) + abs(cb[m])) * reach + cc[m])
    return limit


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def label_tile(candidates: Candidates, x, y, n, positions, at, k1, first, top, left):  # pragma: no cover - compiled
    """Nearest site of each pixel of a whole tile, by its label in the picture. Its positions, from `at` on, relative to (x, y).
    The lesser packed number is the nearer site, or the one of lower number."""
    ca, cb, cc, near = candidates
    own, down = _U(at), _U(at + PIXELS)
    for q in range(PIXELS):
        k1[q] = PACKED_LIMIT
    m = 0
    while m < n:  # five at a time; the last ones twice
        m0, m1, m2, m3, m4 = m, min(m + 1, n - 1), min(m + 2, n - 1), min(m + 3, n - 1), min(m + 4, n - 1)
        a0, b0, a1, b1, a2, b2 = ca[m0], cb[m0], ca[m1], cb[m1], ca[m2], cb[m2]
        a3, b3, a4, b4 = ca[m3], cb[m3], ca[m4], cb[m4]
        c0, c1, c2 = cc[m0] + (a0 * x + b0 * y), cc[m1] + (a1 * x + b1 * y), cc[m2] + (a2 * x + b2 * y)
        c3, c4 = cc[m3] + (a3 * x + b3 * y), cc[m4] + (a4 * x + b4 * y)
        for q in range(PIXELS):
            px, py = positions[own + _U(q)], positions[down + _U(q)]
            k = min(k1[q], a0 * px + (b0 * py + c0))
            k = min(k, min(a1 * px + (b1 * py + c1), a2 * px + (b2 * py + c2)))
            k1[q] = min(k, min(a3 * px + (b3 * py + c3), a4 * px + (b4 * py + c4)))
        m += 5
    for i in range(TILE):
        row = first[top + i]
        for j in range(TILE):
            row[_U(left) + _U(j)] = near[_U(_I(k1[_U(i * TILE) + _U(j)]) & (PACKED - 1))]


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def nearest_two(candidates: Candidates, n, p, k1, k2):  # pragma: no cover - compiled
    """k1, k2 : packed numbers of the nearest two. Three candidates at a time: a third of the loads and stores."""
    ca, cb, cc, _ = candidates
    for q in range(PIXELS):
        k1[q], k2[q] = PACKED_LIMIT, PACKED_LIMIT
    for m in range(0, n - 2, 3):
        a0, b0, c0, a1, b1, c1 = ca[m], cb[m], cc[m], ca[m + 1], cb[m + 1], cc[m + 1]
        a2, b2, c2 = ca[m + 2], cb[m + 2], cc[m + 2]
        for q in range(PIXELS):
            x, y, r, s = p[0, q], p[1, q], k1[q], k2[q]
            k = a0 * x + (b0 * y + c0)
            s = min(s, max(r, k))
            r = min(r, k)
            k = a1 * x + (b1 * y + c1)
            s = min(s, max(r, k))
            r = min(r, k)
            k = a2 * x + (b2 * y + c2)
            s = min(s, max(r, k))
            k1[q], k2[q] = min(r, k), s
    for m in range(n // 3 * 3, n):
        a, b, c = ca[m], cb[m], cc[m]
        for q in range(PIXELS):
            k, r = a * p[0, q] + (b * p[1, q] + c), k1[q]
            k2[q] = min(k2[q], max(r, k))
            k1[q] = min(r, k)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def border_insets(p, k1, k2, blend, n1, n2, inset):  # pragma: no cover - compiled
    """How much farther the next site is than the nearest, 0..SOLID: SOLID is 2 blend. Half of it is about the way to the
    border between the two."""
    factor = _F(SOLID) / (_F(2) * blend)
    for q in range(PIXELS):
        a, b = _I(k1[q]), _I(k2[q])
        own = p[0, q] * p[0, q] + p[1, q] * p[1, q]
        s = _I(min((np.sqrt(_F(b >> 6) + own) - np.sqrt(_F(a >> 6) + own)) * factor, _F(SOLID)))
        n1[q] = a & (PACKED - 1)
        n2[q] = (b if s < SOLID else a) & (PACKED - 1)
        inset[q] = s


@numba.njit(cache=True, nogil=True)
def renumber(n, near):  # pragma: no cover - compiled
    """Candidates' indices in the list become their numbers."""
    for q in range(PIXELS):
        n[q] = near[_U(n[q])]


@numba.njit(cache=True, nogil=True)
def nearest_float64(buckets: Buckets, which, n, x0, y0, p, blend, n1, n2, inset):  # pragma: no cover - compiled
    """All of that for many candidates or far ones, in float64. which (n,) : of the buckets;  x0, y0 : the tile's middle."""
    position, order = buckets.position, buckets.order
    d1, d2 = np.full(PIXELS, np.inf), np.full(PIXELS, np.inf)
    for m in range(n):
        k = which[m]
        cx, cy, weight = np.float64(position[0, k]) - x0, np.float64(position[1, k]) - y0, np.float64(position[2, k])
        if m == 0:
            n1[:] = k
            n2[:] = k
        for q in range(PIXELS):
            ex, ey = p[0, q] - cx, p[1, q] - cy
            d = ex * ex + ey * ey - weight
            # of equal distances the lower number: where the list is not sorted by it
            if d < d1[q] or (d == d1[q] and order[k] < order[n1[q]]):
                d1[q], n1[q], d2[q], n2[q] = d, k, d1[q], n1[q]
            elif d < d2[q] or (d == d2[q] and order[k] < order[n2[q]]):
                d2[q], n2[q] = d, k
    if blend > 0:
        factor = SOLID / (2.0 * blend)
        for q in range(PIXELS):
            s = (np.sqrt(d2[q]) - np.sqrt(d1[q])) * factor if n > 1 else np.float64(SOLID)
            inset[q] = np.uint8(min(s, np.float64(SOLID)))
            n2[q] = n2[q] if inset[q] < SOLID else n1[q]
