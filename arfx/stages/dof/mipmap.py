"""Compiled: blur by an image pyramid, whose levels are mixed by each pixel's blur radius.

Level 1 holds the means over 2 x 2 px, each further one those of 4 x 4 cells of the level before with the weights 1, 3, 3, 1 on
each axis, so that little flickers that moves over the cells. Looked up linearly, level by level down to the picture, level k has
the variance 4^k / 2 - 1 px^2 on each axis, that of a disc of the radius sqrt(2 4^k - 4); between two levels the squared radius
shares. So a pixel costs the same at any radius; a highlight becomes a soft spot and no disc.
Source: pyramidal parametrics (Williams 1983)."""

# mypy: disable-error-code="no-untyped-def, call-arg"
from __future__ import annotations

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.parallel import parallel_rows
from arfx.stages.dof.compositing import BLURRED, SHARP, UNTOUCHED
from arfx.stages.dof.pyramid import SHARP_PX
from arfx.stages.dof.real_pixels import RealPixels
from arfx.stages.dof.splat import OccluderPixels, boosted
from arfx.stages.four import mix_between, put_four, put_mean

_FLAGS = {"contract", "nsz", "arcp"}
_LEAST = 32  # rows of cells below which threads cost more than they save


def squared_radius(level: int) -> float:
    """Of the disc that a level blurs like, px^2; up to level 0's nothing is blurred."""
    return 2 * 4.0**level - 4 if level else SHARP_PX**2


def levels_for(largest_px: float) -> int:
    """Levels that blur up to this radius takes, >= 1."""
    level = 1
    while squared_radius(level) < largest_px**2:
        level += 1
    return level


def reach_px(largest_px: float) -> int:
    """No light goes farther, cells that are partly outside of a rectangle included."""
    return 4 << levels_for(largest_px)


class Mipmap:
    """Of the part `window` of a layer, x0, y0, x1, y1 px from its corner, which lies at `corner` in the frame: cells begin at
    multiples of their size there, so that no pixel depends on the rectangle asked for.

    values : of levels 1.., (h, w, 4) premultiplied colour and weight;  radius : of each, (h, w) px"""

    def __init__(self, corner: tuple[int, int], window: tuple[int, int, int, int], largest_px: float) -> None:
        self.window = window
        x0, y0, x1, y1 = (v + corner[k % 2] for k, v in enumerate(window))
        self.values: list[np.ndarray] = []
        self.radius: list[np.ndarray] = []
        self.odd: list[tuple[int, int]] = []  # of each level, picture included: first row and column at half a coarser cell
        for k in range(levels_for(largest_px)):
            self.odd.append((y0 >> k & 1, x0 >> k & 1))
            size = tuple((b - 1 >> k + 1) - (a >> k + 1) + 1 for a, b in ((y0, y1), (x0, x1)))
            self.values.append(np.empty((*size, 4), np.float32))
            self.radius.append(np.empty(size, np.float32))
            if max(size) == 1:
                break

    def mix(self) -> np.ndarray:
        """From level 1 on, which has been filled: further levels made, then each mixed with what is coarser. Returns level 1."""
        values, radius, odd = self.values, self.radius, self.odd
        for k in range(1, len(values)):
            finer, to = (values[k - 1], radius[k - 1]), (values[k], radius[k])
            parallel_rows(lambda a, b: _halve_cells(a, b, odd[k], *finer, *to), len(values[k]), least=_LEAST)  # noqa: B023
        for k in range(len(values) - 1, 0, -1):
            share = shares(k)
            parallel_rows(
                lambda a, b: _mix_cells(a, b, odd[k], share, radius[k - 1], values[k], values[k - 1]),  # noqa: B023
                len(values[k - 1]), least=_LEAST,
            )  # fmt: skip
        return values[0]

    def fill_real(self, real: RealPixels, radius: np.ndarray, visibility: np.ndarray, boost: np.float32) -> None:
        """Level 1 of the real scene, as `splat.splat_real` takes it."""
        to, odd, flat = (self.values[0], self.radius[0]), self.odd[0], real.flat
        parallel_rows(
            lambda a, b: halve_real(a, b, odd, self.window, flat, radius, visibility, boost, *to), len(to[0]), least=_LEAST
        )

    def fill_occluder(self, pixels: OccluderPixels) -> None:
        """Level 1 of an occluder."""
        to, odd = (self.values[0], self.radius[0]), self.odd[0]
        parallel_rows(lambda a, b: halve_occluder(a, b, odd, pixels, *to), len(to[0]), least=_LEAST)


def shares(level: int) -> tuple[np.float32, np.float32]:
    """(a, b): of light of the radius r the fraction a r^2 - b, within 0..1, comes from what is coarser than the level."""
    low, high = squared_radius(level), squared_radius(level + 1)
    return np.float32(1 / (high - low)), np.float32(low / (high - low))


@line_kernel(fastmath=_FLAGS)
def _share(r, share):  # pragma: no cover - compiled
    return min(max(share[0] * r * r - share[1], np.float32(0)), np.float32(1))


@line_kernel(fastmath=_FLAGS)
def _halve_line(odd, line, weight, radius, out, out_radius):  # pragma: no cover - compiled
    """Sums over two rows, colour (3 w,), weight and radius (w,), to the means of cells, out (4 n,), out_radius (n,)."""
    last, quarter, one, three = len(weight) - 1, np.float32(0.25), np.uintp(1), np.uintp(3)
    whole = (last + 1 + odd) // 2  # cells before it have both columns, but for one that is cut at the left
    for i in range(odd, whole):
        a, to = np.uintp(2 * i - odd), np.uintp(4 * i)
        p = three * a
        r, g = line[p] + line[p + three], line[p + one] + line[p + np.uintp(4)]
        b, w = line[p + np.uintp(2)] + line[p + np.uintp(5)], weight[a] + weight[a + one]
        put_four(out, to, r * quarter, g * quarter, b * quarter, w * quarter)
        out_radius[np.uintp(i)] = (radius[a] + radius[a + one]) * quarter
    half = np.float32(0.5)
    for i in range(len(out_radius)):
        if i < odd or i >= whole:  # one column
            k = 0 if i < odd else last
            put_four(out, 4 * i, line[3 * k] * half, line[3 * k + 1] * half, line[3 * k + 2] * half, weight[k] * half)
            out_radius[i] = radius[k] * half


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def halve_real(
    ya, yb, odd, window, real: RealPixels, radius, visibility, boost, out, out_radius
):  # fmt: skip  # pragma: no cover - compiled
    """Rows ya..yb of out (n, m, 4), out_radius (n, m): means over 2 x 2 pixels of the real scene.

    odd : rows and columns by which the window begins within a cell
    real : `flat`;  radius, visibility, boost : of `splat_real`"""
    image, patch, box = real
    x0, y0, x1, y1 = window
    width, whole = x1 - x0, visibility.shape[0] == 0
    line, weight, sums = np.empty(3 * width, np.float32), np.full(width, np.float32(2)), np.empty(width, np.float32)
    left, right = min(max(box[0], x0), x1), min(max(box[2], x0), x1)
    for j in range(ya, yb):
        y, z = max(y0 + 2 * j - odd[0], y0), min(y0 + 2 * j + 1 - odd[0], y1 - 1)
        a, b = (left, right) if box[1] <= y < box[3] else (x1, x1)
        for first, last in ((x0, a), (a, b), (b, x1)):  # beside the patch, of whole tiles, and in it
            light, up, at = (patch, box[1], box[0]) if a == first < b else (image, 0, 0)
            to, p, q = line[3 * (first - x0) : 3 * (last - x0)], 3 * (first - at), 3 * (last - at)
            upper, lower = light[y - up, p:q], light[z - up, p:q]
            if not whole or boost > 0:
                _sum_weighted(first, y, z, upper, lower, visibility, whole, boost, to, weight[first - x0 : last - x0])
                continue
            for n in range(len(to)):
                to[n] = upper[n] + lower[n]
        r, s = radius[y, x0:x1], radius[z, x0:x1]
        for n in range(width):
            sums[n] = r[n] + s[n]
        _halve_line(odd[1], line, weight, sums, out[j].reshape(-1), out_radius[j])


@line_kernel(fastmath=_FLAGS)
def _sum_weighted(first, y, z, upper, lower, visibility, whole, boost, to, weight):  # pragma: no cover - compiled
    """upper + lower (3 n,), of rows y and z from column `first`, each times what is visible, highlights boosted."""
    one, zero = np.float32(1), np.float32(0)
    for n in range(len(weight)):
        v, w = (one, one) if whole else (visibility[y, first + n], visibility[z, first + n])
        weight[n] = v + w
        if boost > zero:
            v *= boosted(upper[3 * n], upper[3 * n + 1], upper[3 * n + 2], boost)
            w *= boosted(lower[3 * n], lower[3 * n + 1], lower[3 * n + 2], boost)
        for c in range(3):
            to[3 * n + c] = v * upper[3 * n + c] + w * lower[3 * n + c]


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def halve_occluder(ya, yb, odd, occluder: OccluderPixels, out, out_radius):  # pragma: no cover - compiled
    """As `halve_real`, of an occluder; where it has no radius that is 0."""
    radius, colour, coverage, opacity = occluder
    height, width = radius.shape
    line, weight, sums = np.empty(3 * width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for j in range(ya, yb):
        a, b = max(2 * j - odd[0], 0), min(2 * j + 1 - odd[0], height - 1)
        for x in range(width):
            n, i = np.uintp(x), np.uintp(3 * x)
            covered, also = coverage[a, n], coverage[b, n]
            weight[n] = (covered + also) * opacity
            sums[n] = max(radius[a, n], np.float32(0)) + max(radius[b, n], np.float32(0))
            for c in range(3):  # colour is set only near what is covered
                k = np.uintp(c)
                v = colour[a, n, k] if covered > 0 else np.float32(0)
                line[i + k] = (v + (colour[b, n, k] if also > 0 else np.float32(0))) * opacity
        _halve_line(odd[1], line, weight, sums, out[j].reshape(-1), out_radius[j])


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _halve_cells(ya, yb, odd, values, radius, out, out_radius):  # pragma: no cover - compiled
    """Rows ya..yb of the next level, from values (h, w, 4) and radius (h, w)."""
    height, width = radius.shape
    near, far = np.float32(3 / 8), np.float32(1 / 8)
    line, sums = np.empty(4 * width, np.float32), np.empty(width, np.float32)
    for j in range(ya, yb):
        y, z = max(2 * j - odd[0], 0), min(2 * j + 1 - odd[0], height - 1)
        upper, lower = values[y].reshape(-1), values[z].reshape(-1)
        above, below = values[max(y - 1, 0)].reshape(-1), values[min(z + 1, height - 1)].reshape(-1)
        for n in range(4 * width):
            line[n] = (upper[n] + lower[n]) * near + (above[n] + below[n]) * far
        for n in range(width):
            sums[n] = radius[y, n] + radius[z, n]
        to = out[j].reshape(-1)
        for i in range(out_radius.shape[1]):
            a, b = max(2 * i - odd[1], 0), min(2 * i + 1 - odd[1], width - 1)
            put_mean(to, i, line, (max(a - 1, 0), a, b, min(b + 1, width - 1)), near, far)
            out_radius[j, i] = (sums[a] + sums[b]) * np.float32(0.25)


@line_kernel(fastmath=_FLAGS)
def _between_rows(y, odd, coarse, out):  # pragma: no cover - compiled
    """out (4 n,) = row y of the finer level, between rows of coarse (m, n, 4)."""
    u = y + odd
    t = np.float32(0.25) if u & 1 else np.float32(0.75)
    a, b = min(max((u - 1) >> 1, 0), coarse.shape[0] - 1), min((u + 1) >> 1, coarse.shape[0] - 1)
    upper, lower = coarse[a].reshape(-1), coarse[b].reshape(-1)
    for n in range(len(out)):
        out[n] = upper[n] + (lower[n] - upper[n]) * t


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def _mix_cells(ya, yb, odd, share, radius, coarse, out):  # pragma: no cover - compiled
    """Rows ya..yb of out (h, w, 4), a level, with what is coarser (m, n, 4) mixed in by radius (h, w). In place."""
    last = coarse.shape[1] - 1
    line = np.empty(4 * (last + 1), np.float32)
    for y in range(ya, yb):
        _between_rows(y, odd[0], coarse, line)
        to, r = out[y].reshape(-1), radius[y]
        for x in range(len(r)):
            u = x + odd[1]
            t = np.float32(0.25) if u & 1 else np.float32(0.75)
            mix_between(to, x, line, min(max((u - 1) >> 1, 0), last), min((u + 1) >> 1, last), t, _share(r[x], share))


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def composite_real(
    out, state, columns, at, odd, share, coarse, radius, real: RealPixels, visibility
):  # fmt: skip  # pragma: no cover - compiled
    """Columns of out (rows, w, 3) = the real scene from its row at[0], blurred where its radius (h, w) asks for it, there state
    (rows, w) = BLURRED.

    columns : first and behind the last; those between which anything is blurred
    at : row that out begins with, corner x, y of the window of which coarse (m, n, 4) is level 1"""
    image, patch, box = real
    (begin, end, lo, hi), (top, left, first_row) = columns, at
    line, part = np.empty(4 * coarse.shape[1], np.float32), np.empty(out.shape[1], np.float32)
    turn = odd[1] - left  # column 0, from the middle of a cell on
    for j in range(out.shape[0]):
        y = top + j
        r, to, sharp = radius[y, lo:hi], out[j].reshape(-1), image[y].reshape(-1)
        if lo < hi:
            _between_rows(y - first_row, odd[0], coarse, line)
            _shares(r, share, part[lo:hi], state[j, lo:hi])
        a, b = (min(max(box[0], begin), end), min(max(box[2], begin), end)) if box[1] <= y < box[3] else (end, end)
        behind = patch[y - box[1]].reshape(-1) if a < b else sharp
        for first, last, source, shift in ((begin, a, sharp, 0), (a, b, behind, box[0]), (b, end, sharp, 0)):
            p, q = min(max(lo, first), last), min(max(hi, first), last)
            to[3 * first : 3 * p] = source[3 * (first - shift) : 3 * (p - shift)]
            to[3 * q : 3 * last] = source[3 * (q - shift) : 3 * (last - shift)]
            if visibility.shape[0] > 0:
                _mix_visible(to, p, q, part, line, turn, source, shift, visibility[y])
                continue
            one = min(p + 1 - (p + turn & 1), q)  # from here by twos, between the middles of two cells
            cell = one + turn >> 1
            two = one + 2 * max(min((q - one) // 2, coarse.shape[1] - 1 - cell), 0)
            pairs = source[3 * (one - shift) : 3 * (two - shift)]
            _mix_pairs(to[3 * one : 3 * two], pairs, part[one:two], line[4 * cell :])
            _mix_single(to, p, one, part, line, turn, source, shift)
            _mix_single(to, two, q, part, line, turn, source, shift)


@line_kernel(fastmath=_FLAGS)
def _shares(radius, share, part, state):  # pragma: no cover - compiled
    """part (n,) of light from what is coarser, by radius (n,); state (n,) = BLURRED where there is any."""
    for x in range(len(part)):
        part[x] = _share(radius[x], share)
    for x in range(len(part)):
        state[x] = BLURRED if part[x] > 0 else UNTOUCHED


@line_kernel(fastmath=_FLAGS)
def _mix_pairs(out, sharp, part, line):  # pragma: no cover - compiled
    """out = sharp + part (line - sharp), of pixels by twos between the middles of cells (4 n,), the first two between the first
    two. out, sharp : (3 w,);  part : (w,)"""
    near, far = np.float32(0.25), np.float32(0.75)
    one, two, three, four, five = np.uintp(1), np.uintp(2), np.uintp(3), np.uintp(4), np.uintp(5)
    for i in range(len(part) // 2):
        k, x, n = np.uintp(4 * i), np.uintp(6 * i), np.uintp(2 * i)
        f, g = part[n], part[n + one]
        a, b, c = line[k], line[k + one], line[k + two]
        d, e, h = line[k + four] - a, line[k + five] - b, line[k + np.uintp(6)] - c
        r, s, t, u, v, w = sharp[x], sharp[x + one], sharp[x + two], sharp[x + three], sharp[x + four], sharp[x + five]
        r, s, t = r + (a + d * near - r) * f, s + (b + e * near - s) * f, t + (c + h * near - t) * f
        u, v, w = u + (a + d * far - u) * g, v + (b + e * far - v) * g, w + (c + h * far - w) * g
        out[x], out[x + one], out[x + two], out[x + three], out[x + four], out[x + five] = r, s, t, u, v, w


@line_kernel(fastmath=_FLAGS)
def _mix_single(out, first, last, part, line, shift, sharp, left):  # pragma: no cover - compiled
    """As `_mix_pairs`, columns first..last, of which column 0 lies at `shift` from that of half a cell."""
    cells = len(line) // 4 - 1
    for x in range(first, last):
        u = x + shift
        p, q = 4 * min(max((u - 1) >> 1, 0), cells), 4 * min((u + 1) >> 1, cells)
        t, s = np.float32(0.25) if u & 1 else np.float32(0.75), part[x]
        for c in range(3):
            v = line[p + c]
            v += (line[q + c] - v) * t
            out[3 * x + c] = sharp[3 * (x - left) + c] + (v - sharp[3 * (x - left) + c]) * s


@line_kernel(fastmath=_FLAGS)
def _mix_visible(out, first, last, part, line, shift, sharp, left, visible):  # pragma: no cover - compiled
    """As `_mix_single`, where light has weight: of what is sharp the fraction that is visible."""
    cells = len(line) // 4 - 1
    for x in range(first, last):
        u = x + shift
        p, q = 4 * min(max((u - 1) >> 1, 0), cells), 4 * min((u + 1) >> 1, cells)
        t, s = np.float32(0.25) if u & 1 else np.float32(0.75), part[x]
        own = (np.float32(1) - s) * visible[x]
        weight = own + s * (line[p + 3] + (line[q + 3] - line[p + 3]) * t)
        for c in range(3):
            v, light = line[p + c] + (line[q + c] - line[p + c]) * t, sharp[3 * (x - left) + c]
            out[3 * x + c] = (light * own + v * s) / weight if weight > 0 and s > 0 else light


@numba.njit(cache=True, nogil=True, fastmath=_FLAGS)
def composite_occluder(
    out, state, columns, at, odd, share, coarse, pixels: OccluderPixels
):  # fmt: skip  # pragma: no cover - compiled
    """Columns (begin, end) of rows of an occluder over out (rows, w, 3).

    at : the rows begin at row `first` of the layer, its column 0 is `left` of out's
    state : set BLURRED where any of it is blurred, else SHARP; returns whether any is set SHARP"""
    radius, colour, coverage, opacity = pixels
    (begin, end), (first, left), last, any_sharp = columns, at, coarse.shape[1] - 1, False
    line, light = np.empty(4 * coarse.shape[1], np.float32), np.empty(4, np.float32)
    for j in range(out.shape[0]):
        y = first + j
        _between_rows(y, odd[0], coarse, line)
        for x in range(begin, end):
            s, covered = _share(max(radius[y, x], np.float32(0)), share), coverage[y, x]
            light[0], light[1], light[2], light[3] = 0, 0, 0, covered * opacity
            if covered > 0:
                for c in range(3):
                    light[c] = colour[y, x, c] * opacity
            if s > 0:
                u = x + odd[1]
                t = np.float32(0.25) if u & 1 else np.float32(0.75)
                mix_between(light, 0, line, min(max((u - 1) >> 1, 0), last), min((u + 1) >> 1, last), t, s)
            if light[3] <= 0:
                continue
            if s > 0:
                state[j, left + x] = BLURRED
            elif state[j, left + x] == UNTOUCHED:
                state[j, left + x], any_sharp = SHARP, True
            for c in range(3):
                out[j, left + x, c] = out[j, left + x, c] * (np.float32(1) - light[3]) + light[c]
    return any_sharp
