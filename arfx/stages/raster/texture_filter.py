"""A texture as a sample sees it: the mean of bilinear taps spread over the sample's parallelogram,
with its variance, in the level of the texture's pyramid in which they lie _APART to two texels
apart."""

# mypy: disable-error-code="no-untyped-def, call-arg, arg-type, assignment"
import numpy as np

from arfx.core.compiled import FAST, kernel, line_kernel
from arfx.stages.raster import textures

_F = np.float32
_APART = 0.6  # texels between taps at least: farther apart, hard stripes show more than 1.3 levels


@kernel(inline="always")
def _wrapped(t, mode):  # pragma: no cover - compiled
    """A texture coordinate within 0..1."""
    if mode == textures.REPEATS:
        return t - np.floor(t)
    if mode == textures.CLAMPS:
        return min(max(t, _F(0)), _F(1))
    return abs(t - _F(2) * np.floor(_F(0.5) * t + _F(0.5)))


@kernel(inline="always")
def _between(texels, p, q, share):  # pragma: no cover - compiled
    """Four channels between texels p and q."""
    p0, p1, p2, p3 = (
        _F(texels[p, 0]),
        _F(texels[p, 1]),
        _F(texels[p, 2]),
        _F(texels[p, 3]),
    )
    q0, q1, q2, q3 = (
        _F(texels[q, 0]),
        _F(texels[q, 1]),
        _F(texels[q, 2]),
        _F(texels[q, 3]),
    )
    return (
        p0 + share * (q0 - p0),
        p1 + share * (q1 - p1),
        p2 + share * (q2 - p2),
        p3 + share * (q3 - p3),
    )


@line_kernel(error_model="numpy", fastmath=FAST)
def filtered(
    texels, table, t, place, across, down, taps
):  # pragma: no cover - compiled
    """Four channels of texture t, 0..1: mean over a parallelogram.

    place : u, v of its middle;  across, down : its sides in u, v
    taps : along the short side, at most; twice as many along the long one"""
    width, height = _F(table[t, textures.WIDTH]), _F(table[t, textures.HEIGHT])
    ax, ay, bx, by = (
        across[0] * width,
        across[1] * height,
        down[0] * width,
        down[1] * height,
    )
    wide, high = np.sqrt(ax * ax + ay * ay), np.sqrt(bx * bx + by * by)
    finest = max(min(wide, high) / _F(taps), max(wide, high) / _F(2 * taps))
    level = np.int32(0)
    if finest > _F(2):
        level = np.int32(np.log2(finest))
        level = min(level, np.int32(table[t, textures.LEVELS] - 1))
    least = np.int32(1)
    n, m = least, least
    if max(wide, high) > _F(1):  # else one tap is enough
        spacing = max(finest, _F(_APART))
        n = max(np.int32(wide / spacing + _F(0.99)), least)
        m = max(np.int32(high / spacing + _F(0.99)), least)
    w, h = max(np.int32(width) >> level, least), max(np.int32(height) >> level, least)
    start = np.int32(table[t, textures.OFFSETS + level])
    wrap_u, wrap_v = table[t, textures.WRAP_U], table[t, textures.WRAP_V]
    before_u = w - least if wrap_u == textures.REPEATS else np.int32(0)
    before_v = h - least if wrap_v == textures.REPEATS else np.int32(0)
    # spread so that the variance of their places is that of the side
    step = _F(1) / np.sqrt(max(_F(n * n - 1), _F(1)))
    row = _F(1) / np.sqrt(max(_F(m * m - 1), _F(1)))
    step_u, step_v = across[0] * step, across[1] * step
    row_u, row_v = down[0] * row, down[1] * row
    along, under = _F(0.5) * _F(n - 1), _F(0.5) * _F(m - 1)
    first_u = place[0] - along * step_u - under * row_u
    first_v = place[1] - along * step_v - under * row_v
    nearest = table[t, textures.NEAREST] != 0 and level == 0
    t0, t1, t2, t3 = _F(0), _F(0), _F(0), _F(0)
    for j in range(m):
        for i in range(n):
            u = first_u + _F(i) * step_u + _F(j) * row_u
            v = first_v + _F(i) * step_v + _F(j) * row_v
            if u < _F(0) or u >= _F(1):
                u = _wrapped(u, wrap_u)
            if v < _F(0) or v >= _F(1):
                v = _wrapped(v, wrap_v)
            x, y = u * _F(w) - _F(0.5), v * _F(h) - _F(0.5)
            left, top = np.floor(x), np.floor(y)
            fx, fy = x - left, y - top
            if nearest:
                fx, fy = _F(fx >= _F(0.5)), _F(fy >= _F(0.5))
            x0, y0 = np.int32(left), np.int32(top)
            x1, y1 = np.int32(x0 + least), np.int32(y0 + least)
            x0, x1 = (
                x0 if x0 >= 0 else before_u,
                x1 if x1 < w else w - least - before_u,
            )
            y0, y1 = (
                y0 if y0 >= 0 else before_v,
                y1 if y1 < h else h - least - before_v,
            )
            upper, lower = start + y0 * w, start + y1 * w
            p, q = np.uintp(upper + x0), np.uintp(upper + x1)
            r, s = np.uintp(lower + x0), np.uintp(lower + x1)
            c0, c1, c2, c3 = _between(texels, p, q, fx)
            d0, d1, d2, d3 = _between(texels, r, s, fx)
            t0 += c0 + fy * (d0 - c0)
            t1 += c1 + fy * (d1 - c1)
            t2 += c2 + fy * (d2 - c2)
            t3 += c3 + fy * (d3 - c3)
    share = _F(1 / textures.FULL) / _F(n * m)
    return t0 * share, t1 * share, t2 * share, t3 * share
