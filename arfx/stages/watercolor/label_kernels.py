"""Kernels of labels.py: what a tile of pixels does with the sites around it.

Places are whole numbers of 1/STEPS px, relative to the tile's middle: float32 holds them exactly.
So it does distances packed with the number of their site, but for cells of some 90 px and more.
Loops go in steps of a vector unit. Source: docs/methods/watercolor.md#labels."""

# mypy: disable-error-code="call-overload, operator, arg-type"
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import line_kernel
from arfx.stages.watercolor.sites import STEPS

TILE = 16
PIXELS = TILE * TILE
MIDDLE = STEPS * (TILE - 1) // 2  # of a tile, from its first pixel, 1/STEPS px
SOLID = (
    255  # a pixel this far inside its cell takes nothing of its neighbour's colour
)
STEP = 32  # sites
EXACT = np.float32(1 << 24)  # whole numbers below it are float32's
_FAR = np.float32(1e9)  # 1/STEPS px, farther than any site
_NONE = np.float32(1e18)  # larger than any packed number
_MORE = np.float32(1 + 1e-5)  # squares may be rounded
_F = np.float32
_I = np.int32
_U = (
    np.uint64
)  # an index of this type is not looked at for a minus: loops stay simple
_FAST = {"contract", "nsz", "nnan", "ninf"}


class Buckets(NamedTuple):
    """Sites by squares of `side` px, (rows, columns) of them.

    position (3, n + STEP) : x, y from the first square's corner, 1/STEPS px; weight
    start (rows columns + 1), order (n,) : of `labels.bucket_sites`"""

    position: ndarray
    order: ndarray
    start: ndarray
    side: int
    rows: int
    columns: int


class LocalSites(NamedTuple):
    """Sites around a tile, (n,) each: position from its middle, weight, number in the buckets"""

    x: ndarray
    y: ndarray
    weight: ndarray
    number: ndarray


class Candidates(NamedTuple):
    """(n,) each: the packed number of a site at (px, py) is a px + b py + c, see `pack`"""

    a: ndarray
    b: ndarray
    c: ndarray


@line_kernel()
def collect(
    buckets: Buckets, x, y, reach, out: LocalSites
):  # pragma: no cover - compiled
    """Number of sites in the buckets within `reach` of (x, y), up to a multiple of STEP.

    out : these, by number, then some that are far: loops end with whole steps.
    x, y : from the first bucket's corner, 1/STEPS px; buckets at the border hold what is beyond
    """
    position, _, start, side_px, rows, columns = buckets
    lx, ly, lw, number = out
    count, side = 0, _F(side_px * STEPS)
    left = min(max(_I((x - reach) / side), 0), columns - 1)
    right = max(min(_I((x + reach) / side), columns - 1), 0) + 1
    top = min(max(_I((y - reach) / side), 0), rows - 1)
    bottom = max(min(_I((y + reach) / side), rows - 1), 0) + 1
    for i in range(top, bottom):
        first, last = start[i * columns + left], start[i * columns + right]
        for begin in range(first, last, STEP):
            for m in range(STEP):  # what is too much is overwritten by the next row
                k, to = _U(begin) + _U(m), _U(count) + _U(m)
                lx[to], ly[to], lw[to] = (
                    position[0, k] - x,
                    position[1, k] - y,
                    position[2, k],
                )
                number[to] = _I(k)
            count += STEP
        count -= -(last - first) % STEP
    for m in range(STEP):
        lx[_U(count) + _U(m)] = _FAR
    return (count + STEP - 1) // STEP * STEP


@line_kernel(fastmath=_FAST, error_model="numpy")
def bound(sites: LocalSites, count, box, best):  # pragma: no cover - compiled
    """A distance, squared, that no position in a box has to its nearest site.

    box : middle, half sides. Of each of its quarters the distance of the farthest position to its
    best site;  best (STEP,) : scratch"""
    middle_x, middle_y, half_x, half_y = box
    # the quarters' middles lie so far off the box's; so do their own corners of them
    wx = half_x * _F(0.5)
    wy = half_y * _F(0.5)
    farthest = _F(0)
    for quarter in range(4):
        x = middle_x + (wx if quarter % 2 else -wx)
        y = middle_y + (wy if quarter // 2 else -wy)
        best[:] = _NONE
        for begin in range(0, count, STEP):
            for m in range(STEP):
                k = _U(begin) + _U(m)
                dx = abs(sites.x[k] - x) + wx
                dy = abs(sites.y[k] - y) + wy
                best[m] = min(best[m], dx * dx + dy * dy - sites.weight[k])
        least = _NONE
        for m in range(STEP):
            least = min(least, best[m])
        farthest = max(farthest, least)
    return farthest


@line_kernel()
def prune(
    sites: LocalSites, count, box, limit, away, found
):  # pragma: no cover - compiled
    """Number of sites that come to the box as near as `limit`, squared; found : which."""
    middle_x, middle_y, half_x, half_y = box
    most = limit * _MORE + _F(1)
    for m in range(count):
        dx = max(abs(sites.x[m] - middle_x) - half_x, _F(0))
        dy = max(abs(sites.y[m] - middle_y) - half_y, _F(0))
        away[m] = dx * dx + dy * dy - sites.weight[m]
    n = np.uint64(0)
    for m in range(count):
        found[n] = m
        n += np.uint64(away[m] <= most)
    return np.int64(n)


@line_kernel(fastmath=_FAST, error_model="numpy")
def pack(
    sites: LocalSites, found, n, reach, out: Candidates
):  # pragma: no cover - compiled
    """(unit, largest packed number): |p - s|^2 - |p|^2 - weight, in units, plus the index.

    The index is the candidate's in `found`, the unit a power of 2 above it; the number is linear
    in p. reach : of p, from the tile's middle"""
    unit = _F(1)
    most = _F(0)
    while unit < n:
        unit *= _F(2)
    for m in range(n):
        k = _U(found[m])
        x = sites.x[k]
        y = sites.y[k]
        out.a[m] = _F(-2) * unit * x
        out.b[m] = _F(-2) * unit * y
        out.c[m] = unit * (x * x + y * y - sites.weight[k]) + _F(m)
        most = max(most, _F(abs(out.a[m]) + abs(out.b[m])) * reach + _F(out.c[m]))
    return unit, most


@line_kernel(fastmath=_FAST, error_model="numpy")
def nearest(
    candidates: Candidates, n, unit, p, k1, n1
):  # pragma: no cover - compiled
    """n1 : the nearest candidate of each of a tile's positions p (2, PIXELS).

    The lesser packed number is the nearer site, or the one of lower number. k1 : scratch"""
    k1[:] = _NONE
    for m in range(0, n, 2):  # of an odd number the last one twice
        one, other = _U(m), _U(min(m + 1, n - 1))
        a, b, c = candidates.a[one], candidates.b[one], candidates.c[one]
        d, e, f = candidates.a[other], candidates.b[other], candidates.c[other]
        for q in range(PIXELS):
            x = p[0, q]
            y = p[1, q]
            # two in turn: what is kept or replaced by one alone becomes a masked store, three
            # times as slow
            less = min(k1[q], a * x + (b * y + c))
            k1[q] = min(less, d * x + (e * y + f))
    for q in range(PIXELS):
        n1[q] = _I(k1[q] - np.floor(k1[q] / unit) * unit)


@line_kernel(fastmath=_FAST, error_model="numpy")
def nearest_two(
    candidates: Candidates, n, unit, p, blend, keys, n1, n2, inset
):  # pragma: no cover - compiled
    """The nearest two candidates; inset : how much farther the second is, 0..SOLID at 2 blend.

    Half of it is about the way to the border between the two; where it is SOLID n2 is n1.
    blend : 1/STEPS px;  keys (2, PIXELS) : scratch"""
    k1 = keys[0]
    k2 = keys[1]
    k1[:] = _NONE
    k2[:] = _NONE
    for m in range(n):
        a = candidates.a[m]
        b = candidates.b[m]
        c = candidates.c[m]
        for q in range(PIXELS):
            k = a * p[0, q] + (b * p[1, q] + c)
            r = k1[q]
            k1[q] = min(r, k)
            k2[q] = min(k2[q], max(r, k))
    factor = _F(SOLID) / (_F(2) * blend)
    for q in range(PIXELS):
        first = np.floor(k1[q] / unit)
        second = np.floor(k2[q] / unit)
        own = p[0, q] * p[0, q] + p[1, q] * p[1, q]
        farther = np.sqrt(second + own) - np.sqrt(first + own)
        inside = _I(min(farther * factor, _F(SOLID)))
        n1[q] = _I(k1[q] - first * unit)
        n2[q] = _I(k2[q] - second * unit) if inside < SOLID else n1[q]
        inset[q] = inside


@line_kernel()
def nearest_of_far(
    sites: LocalSites, found, n, p, blend, n1, n2, inset
):  # pragma: no cover
    """The same one by one, where packed numbers would be too large. blend 0 : no borders"""
    factor = SOLID / max(2.0 * blend, 1e-9)
    for q in range(PIXELS):
        d1 = np.inf
        d2 = np.inf
        m1 = 0
        m2 = 0
        for m in range(n):
            k = found[m]
            dx = np.float64(sites.x[k]) - p[0, q]
            dy = np.float64(sites.y[k]) - p[1, q]
            d = dx * dx + dy * dy - sites.weight[k]
            if d < d1:
                d1, m1, d2, m2 = d, m, d1, m1
            elif d < d2:
                d2 = d
                m2 = m
        inside = _I(min((np.sqrt(d2) - np.sqrt(d1)) * factor, np.float64(SOLID)))
        n1[q] = m1
        n2[q] = m2 if inside < SOLID else m1
        inset[q] = inside
