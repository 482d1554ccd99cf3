"""SHADOW of every pixel: where its viewing ray meets the plane, each light's picture of the plane is looked up there.

Cost: O(pixels x lights), of each GRID_PX lines only from the first to the last pixels that something is taken from. The
lens is followed by viewing directions at every GRID_PX-th pixel, linear between; places on the plane are linear there, too, where
perspective bends them by less than .02 px."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.lightmap.plane import PlaneTexture
from arfx.stages.viewing import GRID_PX

_NOWHERE = np.float32(1e9)  # on the plane, metres: as far from every picture as can be
_CURVATURE = np.float32(0.01)  # relative change of distance over a run: places are off by up to a quarter of it times the run
_UNSEEN = 0.001  # share of the light: of white, less than half a step of 10 bits
_STRIDE = 2  # runs that are tested at once


class Pictures(NamedTuple):
    """Of the plane, one after the other. texels : all of them;  meta (t, 3) : offset into `texels`, rows, columns
    affine (t, 2, 3) : texels from metres;  dark_columns : of `_dark_columns`"""

    texels: np.ndarray
    meta: np.ndarray
    affine: np.ndarray
    dark_columns: np.ndarray


class _Dimming(NamedTuple):
    """How pictures dim the light. weights (t, 1 or 3);  blocked : the last picture is of what is blocked already
    faint, strength : of `shadow_ratio`;  rise : over faint, of what is kept of a darkening"""

    weights: np.ndarray
    blocked: bool
    faint: np.float32
    rise: np.float32
    strength: np.float32


class _Scratch(NamedTuple):
    """Borders of runs (3, 6, n): of a line, of the lines above and below;  lines (6 + c, n), cell (n,) : of a line's pixels
    spans (t, 2) : runs of each picture"""

    borders: np.ndarray
    lines: np.ndarray
    cell: np.ndarray
    spans: np.ndarray


def shadow_ratio(
    rect: Rect, grid: np.ndarray, anchor_from_camera: Pose, textures: Sequence[PlaneTexture], weights: np.ndarray,
    blocked: PlaneTexture | None, faint: float, strength: float,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float32 ratio of the light that the object leaves the plane; 1 where it leaves all. Read-only, and one value
    for three channels where every light has one.

    grid (gh, gw, 3) : float32 viewing directions as `direction_grid` makes them
    textures, weights (t, 3) : the ambient light first, then the directional ones; each one's part of the plane's light
    blocked : share of every directional light that something real takes already
    faint : darkening under it is left out, over 3 times as much kept whole, faded between;  strength : 0..1
    Where less than _UNSEEN of the only light is taken, nothing is looked up."""
    every = (*textures, blocked) if blocked is not None else tuple(textures)
    alone = _shows_from(faint, strength) / max(float(weights.max()), 1e-6) if len(every) == 1 else 0.0
    pictures = _packed(every, alone)
    grey = bool((weights == weights[:, :1]).all())
    # of the whole grid only the nodes around the rectangle
    gx, gy = rect.x0 // GRID_PX, rect.y0 // GRID_PX
    near = grid[gy : (rect.y1 - 1) // GRID_PX + 2, gx : (rect.x1 - 1) // GRID_PX + 2]
    nodes = anchor_from_camera.rotation.astype(np.float32) @ near.reshape(-1, 3).T
    ratio = _look_up(
        rect.x0 - gx * GRID_PX, rect.y0 - gy * GRID_PX, rect.width, rect.height, nodes.reshape(3, *near.shape[:2]),
        anchor_from_camera.translation_m.astype(np.float32), pictures,
        _Dimming(
            weights[:, : 1 if grey else 3].astype(np.float32), blocked is not None, np.float32(faint),
            np.float32(0.5 / max(faint, 1e-6)), np.float32(strength),
        ),
    )  # fmt: skip
    return np.broadcast_to(ratio, (rect.height, rect.width, 3))


def coarse_shadow_ratio(rect: Rect, picture: Rect, grid: np.ndarray, *what: Any) -> np.ndarray:
    """`shadow_ratio`, looked up once for every 2 x 2 pixels and linear between their middles.

    picture : the whole frame;  grid : of pixels twice as large;  what : the rest of `shadow_ratio`'s"""
    across, down = (picture.width + 1) // 2, (picture.height + 1) // 2
    around = Rect((rect.x0 - 1) // 2, (rect.y0 - 1) // 2, rect.x1 // 2 + 1, rect.y1 // 2 + 1).clip(Rect(0, 0, across, down))
    small = shadow_ratio(around, grid, *what)
    own = np.array(small[..., :1] if small.strides[2] == 0 else small)
    made = _doubled(own, around.x0, around.y0, rect.x0, rect.y0, rect.height, rect.width)
    return np.broadcast_to(made, (rect.height, rect.width, 3))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _doubled(small, left, top, x0, y0, height, width):  # pragma: no cover - compiled
    """(height, width, c) from (h, w, c), whose first pixel covers (2 left, 2 top) and three neighbours."""
    rows, columns, channels = small.shape
    out = np.empty((height, width, channels), np.float32)
    near, far = np.float32(0.75), np.float32(0.25)
    line, wide = np.empty(columns + 2, np.float32), np.empty((columns, 2), np.float32)  # a line has its ends twice
    for y in range(height):
        i = (y0 + y) // 2 - top
        k = min(max(i + 2 * ((y0 + y) % 2) - 1, 0), rows - 1)
        for c in range(channels):
            for x in range(columns):
                line[x + 1] = near * small[i, x, c] + far * small[k, x, c]
            line[0], line[columns + 1] = line[1], line[columns]
            for x in range(columns):
                middle = near * line[x + 1]
                wide[x, 0], wide[x, 1] = middle + far * line[x], middle + far * line[x + 2]
            flat = wide.reshape(-1)[x0 - 2 * left : x0 - 2 * left + width]
            if channels == 1:
                out[y].reshape(-1)[:] = flat
            else:
                for x in range(width):
                    out[y, x, c] = flat[x]
    return out


@lru_cache(maxsize=4)
def _shows_from(faint: float, strength: float) -> float:
    """The least darkening of which, faded as in `shadow_ratio`, more remains than _UNSEEN."""
    t = np.linspace(0, 1, 200)
    dark = faint * (1 + 2 * t)
    return float(np.interp(_UNSEEN, strength * dark * t * t * (3 - 2 * t), dark))


@lru_cache(maxsize=4)
def _packed(every: tuple[PlaneTexture, ...], faint: float) -> Pictures:
    """Cached: looked up in every frame while the light stays the same."""
    sizes = np.array([[t.dark.size, *t.dark.shape] for t in every], np.int64)
    meta = np.column_stack([np.cumsum(sizes[:, 0]) - sizes[:, 0], sizes[:, 1:]])
    texels = every[0].dark.ravel() if len(every) == 1 else np.concatenate([t.dark.ravel() for t in every])
    affine = np.array([t.texel_from_m for t in every], np.float32)
    return Pictures(texels, meta, affine, _dark_columns(every, faint))


def _dark_columns(every: tuple[PlaneTexture, ...], faint: float) -> np.ndarray:
    """(t, rows, 2) int32: columns of each row of each picture that a value above `faint` may be read from, half open."""
    out = np.zeros((len(every), max(len(t.dark) for t in every), 2), np.int32)
    for columns, picture in zip(out, every, strict=True):
        shows = picture.dark > np.float32(faint)
        rows, width = shows.shape
        first, after = shows.argmax(1), width - shows[:, ::-1].argmax(1)
        columns[:rows] = np.where(shows.any(1), [first, after], width).T
    return out


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _look_up(
    x0, y0, width, height, nodes, origin, pictures: Pictures, dimming: _Dimming
):  # fmt: skip  # pragma: no cover - compiled
    """(h, w, c)"""
    channels = dimming.weights.shape[1]
    out = np.empty((height, width, channels), np.float32)
    runs = (x0 + width - 1) // GRID_PX + 1 - x0 // GRID_PX
    borders, lines = np.empty((3, 6, runs + 1), np.float32), np.empty((6 + channels, (runs + 1) * GRID_PX), np.float32)
    cell, spans = np.empty((runs + 1) * GRID_PX, np.int32), np.zeros((pictures.meta.shape[0], 2), np.int64)
    _look_up_lines(x0, y0, nodes, origin, pictures, dimming, _Scratch(borders, lines, cell, spans), out)
    return out


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _look_up_lines(
    x0, y0, nodes, origin, pictures: Pictures, dimming: _Dimming, scratch: _Scratch, out
):  # fmt: skip  # pragma: no cover - compiled
    texels, meta, affine, dark_columns = pictures
    weights, blocked, faint, rise, strength = dimming
    borders, lines, cell, spans = scratch
    ends, above, below = borders[0], borders[1], borders[2]
    px, py, fu, fv, dark, visibility, darkening = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5], lines[6:]
    height, width, channels = out.shape
    zero, one = np.float32(0), np.float32(1)
    step, count = np.float32(1.0 / GRID_PX), weights.shape[0]
    g0 = x0 // GRID_PX
    runs, lead = (x0 + width - 1) // GRID_PX + 1 - g0, x0 - g0 * GRID_PX
    first, last = runs, np.int64(0)
    for j in range(height):
        iy = (y0 + j) // GRID_PX
        if j == 0 or (y0 + j) % GRID_PX == 0:  # the next GRID_PX lines
            _ends(nodes, origin, iy, zero, g0, above)
            _ends(nodes, origin, iy, one, g0, below)
            first, last = runs, np.int64(0)
            for k in range(count):
                spans[k, 0], spans[k, 1] = _dark_runs(above[3:], below[3:], affine[k], dark_columns[k], meta[k, 2])
                if spans[k, 0] < spans[k, 1]:
                    first, last = min(first, spans[k, 0]), max(last, spans[k, 1])
            if meta.shape[0] > count:
                spans[count, 0], spans[count, 1] = first, last
        if first >= last:
            out[j] = one
            continue
        _ends(nodes, origin, iy, np.float32((y0 + j) % GRID_PX) * step, g0, ends)
        _plane_points(ends, origin, first, last, px, py)
        start, stop = max(first * GRID_PX - lead, 0), min(last * GRID_PX - lead, width)
        out[j, :start], out[j, stop:] = one, one
        darkening[:, start:stop] = zero
        visibility[start:stop] = one
        for m in range(meta.shape[0]):
            k = meta.shape[0] - 1 - m  # what is blocked comes last in the list and first here
            rows, columns = meta[k, 1], meta[k, 2]
            part = texels[meta[k, 0] : meta[k, 0] + rows * columns]
            i0, i1 = max(spans[k, 0] * GRID_PX - lead, 0), min(spans[k, 1] * GRID_PX - lead, width)
            n = max(i1 - i0, 0)
            _cells(px[lead + i0 : lead + i0 + n], py[lead + i0 : lead + i0 + n], affine[k], rows, columns, cell, fu, fv)
            _bilinear(part, np.int32(columns), cell[:n], fu, fv, dark)
            seen = visibility[i0 : i0 + n]
            if k == count:
                for i in range(n):
                    seen[i] = one - dark[i]
                continue
            if blocked and k > 0:
                for i in range(n):
                    dark[i] *= seen[i]
            for channel in range(channels):
                _add(darkening[channel, i0 : i0 + n], dark, weights[k, channel])
        if blocked:  # what is there already is less than the whole light
            for channel in range(channels):
                ambient = weights[0, channel]
                for i in range(start, stop):
                    darkening[channel, i] /= max(ambient + (one - ambient) * visibility[i], np.float32(1e-6))
        n = stop - start
        r, g, b = darkening[0, start:stop], darkening[channels // 2, start:stop], darkening[channels - 1, start:stop]
        for i in range(n):
            t = min(max((max(max(r[i], g[i]), b[i]) - faint) * rise, zero), one)
            dark[i] = strength * t * t * (np.float32(3) - t - t)
        if channels == 1:
            line = out[j].reshape(-1)[start:stop]
            for i in range(n):
                line[i] = one - min(dark[i] * r[i], one)
            continue
        for i in range(n):
            out[j, start + i, 0] = one - min(dark[i] * r[i], one)
            out[j, start + i, 1] = one - min(dark[i] * g[i], one)
            out[j, start + i, 2] = one - min(dark[i] * b[i], one)


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _cells(xs, ys, affine, rows, columns, cell, fu, fv):  # pragma: no cover - compiled
    """Of plane places xs, ys (n,) the texel at the cell's low corner, by number, and how far in the cell they lie."""
    zero = np.float32(0)
    last_u, last_v, across = np.float32(columns - 1.01), np.float32(rows - 1.01), np.int32(columns)
    ux, uy, u0 = affine[0, 0], affine[0, 1], affine[0, 2]
    wx, wy, w0 = affine[1, 0], affine[1, 1], affine[1, 2]
    for i in range(xs.shape[0]):
        u = min(max(ux * xs[i] + uy * ys[i] + u0, zero), last_u)
        v = min(max(wx * xs[i] + wy * ys[i] + w0, zero), last_v)
        iu, iv = np.int32(u), np.int32(v)
        fu[i], fv[i] = u - np.float32(iu), v - np.float32(iv)
        cell[i] = iv * across + iu


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _bilinear(part, across, cell, fu, fv, dark):  # pragma: no cover - compiled
    """dark (n,) : bilinear value of the picture `part` in those cells."""
    one = np.uintp(1)
    for i in range(cell.shape[0]):
        a = np.uintp(cell[i])
        c = np.uintp(cell[i] + across)
        e = part[a] + fu[i] * (part[a + one] - part[a])
        f = part[c] + fu[i] * (part[c + one] - part[c])
        dark[i] = e + fv[i] * (f - e)


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _add(out, dark, weight):  # pragma: no cover - compiled
    for i in range(out.shape[0]):
        out[i] += weight * dark[i]


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _ends(nodes, origin, iy, fy, g0, ends):  # pragma: no cover - compiled
    """ends (6, n) : of the runs of GRID_PX pixels of one line, from node g0 on: direction, distance along it (0 = does not
    meet the plane), plane x and y."""
    n = ends.shape[1]
    for c in range(3):
        above, below, out = nodes[c, iy, g0 : g0 + n], nodes[c, iy + 1, g0 : g0 + n], ends[c]
        for i in range(n):
            out[i] = above[i] + fy * (below[i] - above[i])
    _meet(ends[0], ends[1], ends[2], origin[0], origin[1], origin[2], ends[3], ends[4], ends[5])


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _meet(dx, dy, dz, ox, oy, oz, far, x, y):  # pragma: no cover - compiled
    """Where rays (n,) from o meet the plane: distance and place. Without branches, of which the compiler makes vector code."""
    for i in range(dx.shape[0]):
        towards = dz[i] < np.float32(0)
        s = -oz / dz[i]
        u, v = ox + s * dx[i], oy + s * dy[i]
        far[i] = s if towards else np.float32(0)
        x[i] = u if towards else _NOWHERE
        y[i] = v if towards else _NOWHERE


@line_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _plane_points(ends, origin, first, last, px, py):  # pragma: no cover - compiled
    """px, py : where the pixels of the runs first ... last - 1 see the plane; as far from every picture as can be if nowhere."""
    step = np.float32(1.0 / GRID_PX)
    far, x, y = ends[3], ends[4], ends[5]
    for q in range(first, last):
        at = q * GRID_PX
        s, t = far[q], far[q + 1]
        if min(s, t) > np.float32(0) and abs(t - s) <= _CURVATURE * min(s, t):
            x0, y0, first_px = x[q], y[q], np.uintp(at)
            dx, dy = (x[q + 1] - x0) * step, (y[q + 1] - y0) * step
            for i in range(GRID_PX):
                px[first_px + np.uintp(i)] = x0 + np.float32(i) * dx
            for i in range(GRID_PX):
                py[first_px + np.uintp(i)] = y0 + np.float32(i) * dy
            continue
        for i in range(GRID_PX):
            f = np.float32(i) * step
            vz = ends[2, q] + f * (ends[2, q + 1] - ends[2, q])
            s = -origin[2] / vz
            meets = vz < np.float32(0)
            px[at + i] = origin[0] + s * (ends[0, q] + f * (ends[0, q + 1] - ends[0, q])) if meets else _NOWHERE
            py[at + i] = origin[1] + s * (ends[1, q] + f * (ends[1, q + 1] - ends[1, q])) if meets else _NOWHERE


@line_kernel(error_model="numpy")
def _dark_runs(above, below, affine, dark_columns, columns):  # pragma: no cover - compiled
    """Half-open range of runs of GRID_PX lines outside which a picture has nothing dark. above, below (3, n) : their borders,
    distance, plane x and y"""
    runs = above.shape[1] - 1
    first, last = np.int64(0), runs
    while first < last and not _may_be_dark(above, below, first, min(first + _STRIDE, runs), affine, dark_columns, columns):
        first += _STRIDE
    while last > first and not _may_be_dark(above, below, max(last - _STRIDE, 0), last, affine, dark_columns, columns):
        last -= _STRIDE
    return first, max(last, first)


@line_kernel(error_model="numpy")
def _may_be_dark(above, below, a, b, affine, dark_columns, columns):  # pragma: no cover - compiled
    """Whether pixels between the ends a and b of runs may see something dark. dark_columns (rows, 2), one picture's"""
    meets = (above[0, a] > 0) + (above[0, b] > 0) + (below[0, a] > 0) + (below[0, b] > 0)
    if meets < 4:
        return meets > 0  # the horizon lies between
    least_u, most_u, least_v, most_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(4):
        side, k = above if i < 2 else below, a if i % 2 == 0 else b
        u, v = _at(affine[0], side[1, k], side[2, k]), _at(affine[1], side[1, k], side[2, k])
        least_u, most_u, least_v, most_v = min(least_u, u), max(most_u, u), min(least_v, v), max(most_v, v)
    # a texel more on each side: the lens bends what is straight, and a value is read between two texels
    left, right, top, bottom = least_u - 1, most_u + 3, max(least_v - 1, 0.0), min(most_v + 3, float(dark_columns.shape[0]))
    if not (top < bottom and left < columns and right > 0):
        return False
    for row in range(int(top), int(bottom)):
        if dark_columns[row, 0] < right and dark_columns[row, 1] > left and dark_columns[row, 0] < dark_columns[row, 1]:
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _at(row, x, y):  # pragma: no cover - compiled
    return row[0] * x + row[1] * y + row[2]
