"""Sites of the cells: a nested jittered grid in the coordinates of the thing painted, carried to the picture.

A cell of level k is 2^k cells wide and is parted into four of level k - 1. Its site is the site of one of the four, picked
by a hash of (seed, level, column, row), and so on down: a site is the same point at every level it belongs to, so making
the grid finer adds sites and moves none. The other three appear one by one in a fixed order; while one appears its cell
grows from nothing (the weight of a power diagram), so that nothing pops.
Source: jittered sampling, docs/methods/watercolor.md#sites; nesting and fading replace its fixed grid. Cost: O(sites)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numba
import numpy as np

from arfx.core.parallel import parallel_rows

STEPS = 8  # sites lie on multiples of 1/8 px: squared distances below 500 px are exact in float32
GRID_PX = 32  # pitch of the nodes on which the field is known
FADE = 0.19  # in levels: how long a site takes to appear
# In levels below its parent: at which density the second, third and fourth site of a cell appear
_LATER = np.array([np.log2(1.5) / 2, np.log2(2.5) / 2, np.log2(3.5) / 2])
_FINE = 9  # sites are placed to 2^-9 units
_HIGHEST = 24  # a site of this level is everywhere


@dataclass(frozen=True, eq=False)
class Sites:
    """x, y (n,) float32 in 1/STEPS px of the frame, integers;  weight (n,) float32 <= 0, in 1/STEPS^2 px^2, integers
    key (n,) int64 : which site it is, the same in every frame
    u, v (n,) float32 : position in the coordinates of the thing painted, px"""

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    key: np.ndarray
    u: np.ndarray
    v: np.ndarray

    def __len__(self) -> int:
        return len(self.x)


@dataclass(frozen=True, eq=False)
class SiteField:
    """What lies where. nodes every GRID_PX px from (x0, y0) of the frame.

    u, v (gh, gw) float64 : the node's position in the coordinates of the thing painted, px of its first picture
    size (gh, gw) float64 : wanted size of a cell, px of the frame, > 0"""

    x0: int
    y0: int
    u: np.ndarray
    v: np.ndarray
    size: np.ndarray

    def key(self) -> tuple[int, int, bytes, bytes, bytes]:
        """What its content is known by."""
        return self.x0, self.y0, self.u.tobytes(), self.v.tobytes(), self.size.tobytes()


@lru_cache(maxsize=4)
def still_field(width: int, height: int, size_px: float, pad_px: int) -> SiteField:
    """A picture in which nothing moves, with `pad_px` around it."""
    before = -(-pad_px // GRID_PX)
    across, down = (before + -(-(n + pad_px) // GRID_PX) + 1 for n in (width, height))
    x = (np.arange(across) - before) * float(GRID_PX)
    y = (np.arange(down) - before) * float(GRID_PX)
    u, v = np.meshgrid(x, y)
    return SiteField(-before * GRID_PX, -before * GRID_PX, u, v, np.full(u.shape, float(size_px)))


def make_sites(field: SiteField, seed: int, limit: int, unit_px: float = 8.0) -> Sites:
    """Sites of a field, at most `limit`: where there would be more the grid is made coarser, a level at a time.

    unit_px : size of the cells of level 0: where it is the wanted one the sites are evenest"""
    size = np.clip(field.size, 0.25, None)
    for _ in range(_HIGHEST):
        args = (
            field.u / unit_px,
            field.v / unit_px,
            np.log2(size),
            np.uint64(seed),
            limit,
            float(unit_px),
        )
        make = partial(_enumerate, field.x0, field.y0, *args)
        parts = parallel_rows(make, field.u.shape[0] - 1, least=8)
        made = (
            parts[0]
            if len(parts) == 1
            else tuple(np.concatenate(column) for column in zip(*parts, strict=True))
        )
        if made[0].shape[0] < limit:
            break
        size = size * 2
    return Sites(*(a[:limit] for a in made))


@numba.njit(cache=True, nogil=True, inline="always")
def _mixed(seed, level, i, j):  # pragma: no cover - compiled
    """64 random bits for a cell (splitmix64 finaliser)."""
    z = seed * np.uint64(0x9E3779B97F4A7C15) + np.uint64(level + 64) * np.uint64(0xD1B54A32D192ED03)
    z ^= np.uint64(i) * np.uint64(0xBF58476D1CE4E5B9) + np.uint64(j) * np.uint64(0x94D049BB133111EB)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True, nogil=True)
def _importance(seed, level, i, j):  # pragma: no cover - compiled
    """Coarsest density, as a level, at which the site of a cell is still there; and the bits of its topmost cell."""
    while level < _HIGHEST:
        bits = _mixed(seed, level + 1, i >> 1, j >> 1)
        child = (i & 1) | ((j & 1) << 1)
        chosen = np.int64(bits & np.uint64(3))
        if child != chosen:
            order = (child - chosen + 4) % 4 - 1  # 0, 1, 2 among the other three
            order = (order + np.int64((bits >> np.uint64(2)) & np.uint64(0xFF)) % 3) % 3
            return level + 1 - _LATER[order], _mixed(seed, level, i, j)
        level, i, j = level + 1, i >> 1, j >> 1
    return np.float64(_HIGHEST), _mixed(seed, level, i, j)


@numba.njit(cache=True, nogil=True)
def _refine(seed, level, count, bi, bj):  # pragma: no cover - compiled
    """(i, j) of `count` cells become their chosen quarter, that one's, and so on to 1/512 of a unit. Returns the size there."""
    while level > -_FINE:
        for m in range(count):
            chosen = np.int64(_mixed(seed, level, bi[m], bj[m]) & np.uint64(3))
            bi[m], bj[m] = 2 * bi[m] + (chosen & 1), 2 * bj[m] + (chosen >> 1)
        level -= 1
    return 2.0**level


@numba.njit(cache=True, nogil=True)
def _candidates(
    seed, level, pj, box, least, oi, oj, importance, key
):  # pragma: no cover - compiled
    """How many of the cells in box (i0 ... i1, j0 ... j1), row pj of their parents, are at least that important; which (oi, oj).
    key : 0 where it is still to be made"""
    i0, i1, j0, j1 = box
    n = 0
    for pi in range(i0 >> 1, (i1 >> 1) + 1):
        bits = _mixed(seed, level + 1, pi, pj)
        chosen, turn = (
            np.int64(bits & np.uint64(3)),
            np.int64((bits >> np.uint64(2)) & np.uint64(0xFF)) % 3,
        )
        for child in range(4):
            i, j = 2 * pi + (child & 1), 2 * pj + (child >> 1)
            if i < i0 or i > i1 or j < j0 or j > j1:
                continue
            oi[n], oj[n], key[n] = i, j, np.uint64(0)
            if child != chosen:
                order = (child - chosen + 4) % 4 - 1  # 0, 1, 2 among the other three
                importance[n] = level + 1 - _LATER[(order + turn) % 3]
            elif level + 1 > _HIGHEST:
                importance[n] = np.float64(_HIGHEST)
            else:
                importance[n], key[n] = _importance(seed, level + 1, pi, pj)
            n += importance[n] >= least
    return n


@numba.njit(cache=True, nogil=True)
def _enumerate(x0, y0, u, v, wanted, seed, limit, unit, row, end):  # pragma: no cover - compiled
    """All sites of the field's triangles in rows row ... end - 1 of quads.

    u, v : in units of the cells of level 0;  wanted (gh, gw) : log2 of the cell size, px of the frame"""
    gw = u.shape[1]
    sx, sy, sw = (
        np.empty(limit, np.float32),
        np.empty(limit, np.float32),
        np.empty(limit, np.float32),
    )
    su, sv, sk = np.empty(limit, np.float32), np.empty(limit, np.float32), np.empty(limit, np.int64)
    e1u, e1v, e2u, e2v = np.empty(2), np.empty(2), np.empty(2), np.empty(2)
    det, scale, per = np.empty(2), np.zeros(2), np.zeros(2)
    scratch = np.empty((4, 64), np.int64)
    oi, oj, bi, bj = scratch[0], scratch[1], scratch[2], scratch[3]
    importance, key = np.empty(64, np.float64), np.empty(64, np.uint64)
    n = 0
    for gy in range(row, end):
        for gx in range(gw - 1):
            # its two triangles: (0, 0) (1, 0) (0, 1) and (1, 1) (0, 1) (1, 0)
            lo_u, hi_u, lo_v, hi_v, least = u[gy, gx], u[gy, gx], v[gy, gx], v[gy, gx], np.inf
            for half in range(2):
                corner_u, corner_v = u[gy + half, gx + half], v[gy + half, gx + half]
                e1u[half], e1v[half] = (
                    u[gy + half, gx + 1 - half] - corner_u,
                    v[gy + half, gx + 1 - half] - corner_v,
                )
                e2u[half], e2v[half] = (
                    u[gy + 1 - half, gx + half] - corner_u,
                    v[gy + 1 - half, gx + half] - corner_v,
                )
                det[half] = e1u[half] * e2v[half] - e1v[half] * e2u[half]
                for x in range(2):
                    lo_u, hi_u = min(lo_u, u[gy + half, gx + x]), max(hi_u, u[gy + half, gx + x])
                    lo_v, hi_v = min(lo_v, v[gy + half, gx + x]), max(hi_v, v[gy + half, gx + x])
                if det[half] > 1e-9:
                    # how many units of the thing lie in one px of the picture
                    per[half] = 1.0 / det[half]
                    scale[half] = 0.5 * np.log2(det[half] / (GRID_PX * GRID_PX))
                    for x in range(2):
                        least = min(
                            least, min(wanted[gy, gx + x], wanted[gy + 1, gx + x]) + scale[half]
                        )
            if not (least < np.inf):
                continue  # folded over: what lies there is hidden
            level = np.int64(np.floor(least + 0.19))
            cell = 2.0**level
            i0, i1 = np.int64(np.floor(lo_u / cell)), np.int64(np.floor(hi_u / cell))
            j0, j1 = np.int64(np.floor(lo_v / cell)), np.int64(np.floor(hi_v / cell))
            if 4 * ((i1 - i0) // 2 + 2) > oi.shape[0]:
                capacity = 8 * ((i1 - i0) // 2 + 2)
                scratch = np.empty((4, capacity), np.int64)
                oi, oj, bi, bj = scratch[0], scratch[1], scratch[2], scratch[3]
                importance, key = np.empty(capacity, np.float64), np.empty(capacity, np.uint64)
            for pj in range(j0 >> 1, (j1 >> 1) + 1):
                count = _candidates(
                    seed, level, pj, (i0, i1, j0, j1), least - 0.5 * FADE, oi, oj, importance, key
                )
                for m in range(count):
                    bi[m], bj[m] = oi[m], oj[m]
                fine = _refine(seed, level, count, bi, bj)
                for m in range(count):
                    pu, pv = (bi[m] + 0.5) * fine, (bj[m] + 0.5) * fine
                    for half in range(2):
                        if not (det[half] > 1e-9):
                            continue
                        du, dv = pu - u[gy + half, gx + half], pv - v[gy + half, gx + half]
                        s, t = (
                            (du * e2v[half] - dv * e2u[half]) * per[half],
                            (dv * e1u[half] - du * e1v[half]) * per[half],
                        )
                        if s < 0 or t < 0 or s + t > 1 or (half == 1 and s + t == 1):
                            continue
                        la = wanted[gy + half, gx + half]
                        lb, lc = wanted[gy + half, gx + 1 - half], wanted[gy + 1 - half, gx + half]
                        size = la + s * (lb - la) + t * (lc - la)
                        fade = (importance[m] - size - scale[half]) / FADE + 0.5
                        if fade <= 0:
                            continue
                        if n == limit:
                            return sx, sy, sw, sk, su, sv
                        sx[n] = np.rint((x0 + GRID_PX * (gx + (half + (1 - 2 * half) * s))) * STEPS)
                        sy[n] = np.rint((y0 + GRID_PX * (gy + (half + (1 - 2 * half) * t))) * STEPS)
                        sw[n] = (
                            0.0
                            if fade >= 1
                            else -np.rint((1 - fade) * (1.2 * 2.0**size * STEPS) ** 2)
                        )
                        bits = key[m] if key[m] else _mixed(seed, level, oi[m], oj[m])
                        sk[n] = np.int64(bits & np.uint64(0x7FFFFFFFFFFFFFFF))
                        su[n], sv[n] = pu * unit, pv * unit
                        n += 1
    return sx[:n].copy(), sy[:n].copy(), sw[:n].copy(), sk[:n].copy(), su[:n].copy(), sv[:n].copy()
