"""Sites of the cells: a nested jittered grid in the coordinates of the thing painted, carried to
the picture.

A cell of level k is 2^k cells wide and is parted into four of level k - 1. Its site is the site of
one of the four, picked by a hash of (seed, level, column, row), and so on down: a site is the same
point at every level it belongs to, so making the grid finer adds sites and moves none. The other
three appear one by one in a fixed order; while one appears its cell grows from nothing (the weight
of a power diagram), so that nothing pops. Source: jittered sampling,
docs/methods/watercolor.md#sites; nesting and fading replace its fixed grid. Cost: O(sites).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.parallel import parallel_rows

STEPS = 8  # sites lie on multiples of 1/8 px: squared distances below 500 px are exact in float32
GRID_PX = 32  # pitch of the nodes on which the field is known
FADE = 0.19  # in levels: how long a site takes to appear
# In levels below its parent: at which density the second, third and fourth site of a cell appear
_LATER = np.array([np.log2(1.5) / 2, np.log2(2.5) / 2, np.log2(3.5) / 2])
_FINE = 9  # sites are placed to 2^-9 units
_HIGHEST = 24  # a site of this level is everywhere
Place = tuple[
    float, float
]  # x, y in a pixel from its middle, px, in whole 1/STEPS px


@dataclass(frozen=True, eq=False)
class Sites:
    """x, y (n,) float32 in 1/STEPS px of the frame, integers;  weight (n,) float32 <= 0, in
    1/STEPS^2 px^2, integers
    key (n,) int64 : which site it is, the same in every frame
    u, v (n,) float32 : position in the coordinates of the thing painted, px"""

    x: ndarray
    y: ndarray
    weight: ndarray
    key: ndarray
    u: ndarray
    v: ndarray

    def __len__(self) -> int:
        return len(self.x)

    def seen_from(self, place: Place) -> Sites:
        """As they lie about another place in the pixels than their middles."""
        x, y = (np.float32(STEPS * along) for along in place)
        return replace(self, x=self.x - x, y=self.y - y)


@dataclass(frozen=True, eq=False)
class SiteField:
    """What lies where. nodes every GRID_PX px from (x0, y0) of the frame.

    u, v (gh, gw) float64 : the node's position in the coordinates of the thing painted, px of its
        first picture
    size (gh, gw) float64 : wanted size of a cell, px of the frame, > 0"""

    x0: int
    y0: int
    u: ndarray
    v: ndarray
    size: ndarray

    def nodes(self) -> tuple[ndarray, ndarray]:
        """Columns (gw,) and rows (gh, 1) px of the frame at which they are."""
        rows, columns = self.u.shape
        y = self.y0 + GRID_PX * np.arange(rows)[:, None]
        return self.x0 + GRID_PX * np.arange(columns), y

    def key(self) -> Hashable:
        """What its content is known by."""
        return (
            self.x0,
            self.y0,
            self.u.tobytes(),
            self.v.tobytes(),
            self.size.tobytes(),
        )


@lru_cache(maxsize=4)
def still_field(width: int, height: int, size_px: float, pad_px: int) -> SiteField:
    """A picture in which nothing moves, with `pad_px` around it."""
    before = -(-pad_px // GRID_PX)
    across, down = (before + -(-(n + pad_px) // GRID_PX) + 1 for n in (width, height))
    x = (np.arange(across) - before) * float(GRID_PX)
    y = (np.arange(down) - before) * float(GRID_PX)
    u, v = np.meshgrid(x, y)
    return SiteField(
        -before * GRID_PX, -before * GRID_PX, u, v, np.full(u.shape, float(size_px))
    )


def make_sites(
    field: SiteField, seed: int, limit: int, unit_px: float = 8.0
) -> Sites:
    """Sites of a field, at most `limit`: where there would be more the grid is made coarser, a
    level at a time.

    unit_px : size of the cells of level 0: where it is the wanted one the sites are evenest
    """
    u = field.u / unit_px
    v = field.v / unit_px
    level = np.log2(np.clip(field.size, 0.25, None))
    for _ in range(_HIGHEST):
        nodes = field.x0, field.y0, u, v, level
        make = partial(_enumerate, nodes, np.uint64(seed), limit, float(unit_px))
        parts = parallel_rows(make, u.shape[0] - 1, least=8)
        columns = [
            np.concatenate(column)[:limit] for column in zip(*parts, strict=True)
        ]
        if len(columns[0]) < limit:
            break
        level = level + 1
    return Sites(*columns)


@kernel(inline="always")
def _mixed(seed, level, i, j):  # pragma: no cover - compiled
    """64 random bits for a cell (splitmix64 finaliser)."""
    z = seed * np.uint64(0x9E3779B97F4A7C15) + np.uint64(level + 64) * np.uint64(
        0xD1B54A32D192ED03
    )
    z ^= np.uint64(i) * np.uint64(0xBF58476D1CE4E5B9) + np.uint64(j) * np.uint64(
        0x94D049BB133111EB
    )
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel()
def _importance(seed, level, i, j):  # pragma: no cover - compiled
    """(coarsest density, as a level, at which the site of a cell is still there; its topmost cell:
    level, i, j)."""
    while level < _HIGHEST:
        bits = _mixed(seed, level + 1, i >> 1, j >> 1)
        child = (i & 1) | ((j & 1) << 1)
        chosen = np.int64(bits & np.uint64(3))
        if child != chosen:
            order = (child - chosen + 4) % 4 - 1  # 0, 1, 2 among the other three
            turn = np.int64((bits >> np.uint64(2)) & np.uint64(0xFF)) % 3
            return level + 1 - _LATER[(order + turn) % 3], level, i, j
        level, i, j = level + 1, i >> 1, j >> 1
    return np.float64(_HIGHEST), level, i, j


@kernel()
def _refine(seed, level, i, j):  # pragma: no cover - compiled
    """(u, v) of a cell's site, in units: that of its chosen quarter, and so on to 2^-_FINE."""
    while level > -_FINE:
        chosen = np.int64(_mixed(seed, level, i, j) & np.uint64(3))
        i = 2 * i + (chosen & 1)
        j = 2 * j + (chosen >> 1)
        level -= 1
    fine = 2.0**level
    return (i + 0.5) * fine, (j + 0.5) * fine


@kernel()
def _enumerate(nodes, seed, limit, unit, row, end):  # pragma: no cover - compiled
    """All sites of the field's triangles in rows row ... end - 1 of quads, as columns of Sites.

    nodes : x0, y0; u, v in units of the cells of level 0; log2 of the cell size, px of the frame
    """
    x0, y0, u, v, wanted = nodes
    places = np.empty((5, limit), np.float32)  # x, y, weight, u, v
    keys = np.empty(limit, np.int64)
    scale = np.zeros(2)
    n = 0
    for gy in range(row, end):
        for gx in range(u.shape[1] - 1):
            # its two triangles: (0, 0) (1, 0) (0, 1) and (1, 1) (0, 1) (1, 0)
            quad_u = u[gy : gy + 2, gx : gx + 2]
            quad_v = v[gy : gy + 2, gx : gx + 2]
            least = np.inf
            for half in range(2):
                _, _, area = _edges(quad_u, quad_v, half)
                if area > 1e-9:
                    scale[half] = 0.5 * np.log2(area / (GRID_PX * GRID_PX))
                    finest = wanted[gy : gy + 2, gx : gx + 2].min()
                    least = min(least, finest + scale[half])
            if not (least < np.inf):
                continue  # folded over: what lies there is hidden
            level = np.int64(np.floor(least + 0.19))
            cell = 2.0**level
            i0 = np.int64(np.floor(quad_u.min() / cell))
            i1 = np.int64(np.floor(quad_u.max() / cell))
            j0 = np.int64(np.floor(quad_v.min() / cell))
            j1 = np.int64(np.floor(quad_v.max() / cell))
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    importance, top, top_i, top_j = _importance(seed, level, i, j)
                    if importance < least - 0.5 * FADE:
                        continue
                    pu, pv = _refine(seed, level, i, j)
                    for half in range(2):
                        (e1u, e1v), (e2u, e2v), area = _edges(quad_u, quad_v, half)
                        if not (area > 1e-9):
                            continue
                        du = pu - quad_u[half, half]
                        dv = pv - quad_v[half, half]
                        s = (du * e2v - dv * e2u) / area
                        t = (dv * e1u - du * e1v) / area
                        if s < 0 or t < 0 or s + t > 1 or (half == 1 and s + t == 1):
                            continue
                        la = wanted[gy + half, gx + half]
                        lb = wanted[gy + half, gx + 1 - half]
                        lc = wanted[gy + 1 - half, gx + half]
                        size = la + s * (lb - la) + t * (lc - la)
                        fade = (importance - size - scale[half]) / FADE + 0.5
                        if fade <= 0:
                            continue
                        if n == limit:
                            return _columns(places, keys, n)
                        side = 1 - 2 * half
                        places[0, n] = np.rint(
                            (x0 + GRID_PX * (gx + half + side * s)) * STEPS
                        )
                        places[1, n] = np.rint(
                            (y0 + GRID_PX * (gy + half + side * t)) * STEPS
                        )
                        grown = (1.2 * 2.0**size * STEPS) ** 2
                        places[2, n] = -np.rint(max(1 - fade, 0.0) * grown)
                        places[3, n] = pu * unit
                        places[4, n] = pv * unit
                        bits = _mixed(seed, top, top_i, top_j)
                        keys[n] = np.int64(bits & np.uint64(0x7FFFFFFFFFFFFFFF))
                        n += 1
    return _columns(places, keys, n)


@kernel(inline="always")
def _edges(u, v, half):  # pragma: no cover - compiled
    """(u, v) of both edges of a quad's triangle from its corner, and twice its area."""
    rest = 1 - half
    first = u[half, rest] - u[half, half], v[half, rest] - v[half, half]
    second = u[rest, half] - u[half, half], v[rest, half] - v[half, half]
    return first, second, first[0] * second[1] - first[1] * second[0]


@kernel(inline="always")
def _columns(places, keys, n):  # pragma: no cover - compiled
    """The first n, in the order of Sites."""
    x, y, weight, u, v = places[:, :n].copy()
    return x, y, weight, keys[:n].copy(), u, v
