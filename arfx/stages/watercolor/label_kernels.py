"""Kernels of labels.py: what a tile of pixels does with the sites around it, each loop in steps of a vector unit.

Places are whole numbers of 1/STEPS px, relative to the tile's middle: float32 holds them exactly, and mostly all packed
distances; else float64 does. Source: docs/methods/watercolor.md#labels."""

# mypy: disable-error-code="call-overload, operator, arg-type"
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arfx.core.compiled import line_kernel
from arfx.stages.watercolor.sites import STEPS

TILE = 16
PIXELS = TILE * TILE
MIDDLE = STEPS * (TILE - 1) // 2  # of a tile, from its first pixel, 1/STEPS px
SOLID = 255  # a pixel this far inside its cell takes nothing of its neighbour's colour
STEP = 32  # sites
EXACT = np.float32(1 << 24)  # whole numbers below it are float32's
_FAR, _NONE = (
    np.float32(1e9),
    np.float32(1e18),
)  # 1/STEPS px, farther than any site; of a packed number
_MORE = np.float32(1 + 1e-5)  # squares may be rounded
_F, _I, _U = (
    np.float32,
    np.int32,
    np.uint64,
)  # an index of type uint64 is not looked at for a minus: loops stay simple
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
    """Sites around a tile, (n,) each: position from its middle, weight, number in the buckets' order"""

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    number: np.ndarray


class Candidates(NamedTuple):
    """Candidates, (n,) each: a px + b py + c as of `pack`"""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


@line_kernel()
def collect(buckets: Buckets, x, y, rx, ry, out: LocalSites):  # pragma: no cover - compiled
    """How many sites lie in the buckets within (rx, ry) of (x, y); these, by number, and some that are far up to a multiple of
    STEP: loops end with whole steps.

    Places from the first bucket's corner, 1/STEPS px; buckets at the border hold what lies beyond it."""
    position, _, start, side_px, gh, gw = buckets
    lx, ly, lw, number = out
    count, side = 0, _F(side_px * STEPS)
    left, right = (
        min(max(_I((x - rx) / side), 0), gw - 1),
        max(min(_I((x + rx) / side), gw - 1), 0) + 1,
    )
    for i in range(
        min(max(_I((y - ry) / side), 0), gh - 1), max(min(_I((y + ry) / side), gh - 1), 0) + 1
    ):
        a, b = start[i * gw + left], start[i * gw + right]
        for at in range(a, b, STEP):
            for m in range(
                STEP
            ):  # of fixed length; what is too much is overwritten by the next row
                k, to = _U(at) + _U(m), _U(count) + _U(m)
                lx[to], ly[to], lw[to] = position[0, k] - x, position[1, k] - y, position[2, k]
                number[to] = _I(k)
            count += STEP
        count -= -(b - a) % STEP
    for m in range(STEP):
        lx[_U(count) + _U(m)] = _FAR
    return (count + STEP - 1) // STEP * STEP


@line_kernel(fastmath=_FAST, error_model="numpy")
def bound(sites: LocalSites, count, box, best):  # pragma: no cover - compiled
    """A distance, squared, that no position in a box (middle, half sides) has to its nearest site: of each quarter that of
    its farthest position to its best site. best (4, STEP) : scratch, of the quarters"""
    lx, ly, lw, _ = sites
    mx, my, hx, hy = box
    best[:] = _NONE
    # the quarters' middles lie (wx, wy) off the box's; so do their own corners of them
    wx, wy = hx * _F(0.5), hy * _F(0.5)
    for at in range(0, count, STEP):
        for m in range(STEP):
            k = _U(at) + _U(m)
            ex, ey, weight = lx[k] - mx, ly[k] - my, lw[k]
            near_x, far_x, near_y, far_y = (
                abs(ex + wx) + wx,
                abs(ex - wx) + wx,
                abs(ey + wy) + wy,
                abs(ey - wy) + wy,
            )
            near_x, far_x, near_y, far_y = (
                near_x * near_x,
                far_x * far_x,
                near_y * near_y - weight,
                far_y * far_y - weight,
            )
            best[0, m], best[1, m] = (
                min(best[0, m], near_x + near_y),
                min(best[1, m], far_x + near_y),
            )
            best[2, m], best[3, m] = min(best[2, m], near_x + far_y), min(best[3, m], far_x + far_y)
    farthest = _F(0)
    for quarter in range(4):
        least = _NONE
        for m in range(STEP):
            least = min(least, best[quarter, m])
        farthest = max(farthest, least)
    return farthest


@line_kernel()
def prune(sites: LocalSites, count, box, limit, away, found):  # pragma: no cover - compiled
    """How many sites come to the box as near as `limit`, squared; found : which."""
    lx, ly, lw, _ = sites
    mx, my, hx, hy = box
    most = limit * _MORE + _F(1)
    for m in range(count):
        dx, dy = max(abs(lx[m] - mx) - hx, _F(0)), max(abs(ly[m] - my) - hy, _F(0))
        away[m] = dx * dx + dy * dy - lw[m]
    n = np.uint64(0)
    for m in range(count):
        found[n] = m
        n += np.uint64(away[m] <= most)
    return np.int64(n)


@line_kernel(fastmath=_FAST, error_model="numpy")
def pack(sites: LocalSites, found, n, reach, out: Candidates):  # pragma: no cover - compiled
    """|p - s|^2 - |p|^2 - weight and the candidate's index in the list as one number that is linear in p: ca px + cb py + cc.
    Returns what it counts distances in, a power of 2, and the largest number that comes about. reach : of p, from the tile's
    middle"""
    lx, ly, lw, _ = sites
    ca, cb, cc = out
    unit, most = _F(1), _F(0)
    while unit < n:
        unit *= _F(2)
    for m in range(n):
        k = _U(found[m])
        ca[m], cb[m], cc[m] = lx[k], ly[k], lw[k]  # of its type from here on
        x, y = ca[m], cb[m]
        ca[m], cb[m], cc[m] = (
            _F(-2) * unit * x,
            _F(-2) * unit * y,
            unit * (x * x + y * y - cc[m]) + _F(m),
        )
        most = max(most, _F(abs(ca[m]) + abs(cb[m])) * reach + _F(cc[m]))
    return unit, most


@line_kernel(fastmath=_FAST, error_model="numpy")
def nearest(candidates: Candidates, n, unit, p, k1, n1):  # pragma: no cover - compiled
    """n1 : the nearest candidate of each of a tile's positions. The lesser packed number is the nearer site, or the one of lower
    number."""
    ca, cb, cc = candidates
    k1[:] = _NONE
    for m in range(0, n, 5):  # five at a time; the last one up to five times
        m0, m1, m2, m3, m4 = (
            m,
            min(m + 1, n - 1),
            min(m + 2, n - 1),
            min(m + 3, n - 1),
            min(m + 4, n - 1),
        )
        a0, b0, c0, a1, b1, c1 = ca[m0], cb[m0], cc[m0], ca[m1], cb[m1], cc[m1]
        a2, b2, c2, a3, b3, c3 = ca[m2], cb[m2], cc[m2], ca[m3], cb[m3], cc[m3]
        a4, b4, c4 = ca[m4], cb[m4], cc[m4]
        for q in range(PIXELS):
            x, y = p[0, q], p[1, q]
            k = min(k1[q], a0 * x + (b0 * y + c0))
            k = min(k, min(a1 * x + (b1 * y + c1), a2 * x + (b2 * y + c2)))
            k1[q] = min(k, min(a3 * x + (b3 * y + c3), a4 * x + (b4 * y + c4)))
    for q in range(PIXELS):
        n1[q] = _I(k1[q] - np.floor(k1[q] / unit) * unit)


@line_kernel(fastmath=_FAST, error_model="numpy")
def nearest_two(candidates: Candidates, n, p, k1, k2):  # pragma: no cover - compiled
    """k1, k2 : packed numbers of the nearest two. Three candidates at a time: a third of the loads and stores."""
    ca, cb, cc = candidates
    k1[:], k2[:] = _NONE, _NONE
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


@line_kernel(fastmath=_FAST, error_model="numpy")
def border_insets(p, unit, k1, k2, blend, n1, n2, inset):  # pragma: no cover - compiled
    """How much farther the next site is than the nearest, 0..SOLID: SOLID is 2 blend. Half of it is about the way to the
    border between the two."""
    factor = _F(SOLID) / (_F(2) * blend)
    for q in range(PIXELS):
        a, b, own = (
            np.floor(k1[q] / unit),
            np.floor(k2[q] / unit),
            p[0, q] * p[0, q] + p[1, q] * p[1, q],
        )
        s = _I(min((np.sqrt(b + own) - np.sqrt(a + own)) * factor, _F(SOLID)))
        n1[q] = _I(k1[q] - a * unit)
        n2[q] = _I(k2[q] - b * unit) if s < SOLID else n1[q]
        inset[q] = s


@line_kernel()
def nearest_sites(
    candidates: Candidates, n, unit, p, blend, packed, n1, n2, inset
):  # pragma: no cover - compiled
    """Of a tile's positions p (2, PIXELS) the nearest candidate; with a `blend` the next one as well, where it is near, and
    how far inside its cell a pixel lies. packed (2, PIXELS) : scratch"""
    if blend > 0:
        nearest_two(candidates, n, p, packed[0], packed[1])
        border_insets(p, unit, packed[0], packed[1], blend, n1, n2, inset)
    else:
        nearest(candidates, n, unit, p, packed[0], n1)
