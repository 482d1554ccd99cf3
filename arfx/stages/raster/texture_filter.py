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
    if _F(0) <= t < _F(1):
        return t
    if mode == textures.REPEATS:
        return t - np.floor(t)
    if mode == textures.CLAMPS:
        return min(max(t, _F(0)), _F(1))
    return abs(t - _F(2) * np.floor(_F(0.5) * t + _F(0.5)))


@kernel(inline="always")
def _texel(texels, p):  # pragma: no cover - compiled
    a, b, c, d = texels[p, 0], texels[p, 1], texels[p, 2], texels[p, 3]
    return _F(a), _F(b), _F(c), _F(d)


@kernel(inline="always")
def _mixed(a, b, share):  # pragma: no cover - compiled
    """Four channels: a where the share is 0, b where it is 1."""
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        a[3] + share * (b[3] - a[3]),
    )


@kernel(inline="always")
def _spread(side, length, spacing):  # pragma: no cover - compiled
    """How many taps along a side (u, v), and the step between them: the variance of their places
    is that of the side."""
    if length <= spacing:
        return 1, side[0], side[1]
    count = int(length / spacing + _F(0.99))
    step = _F(1) / np.sqrt(max(_F(count * count - 1), _F(1)))
    return count, step * side[0], step * side[1]


@kernel(inline="always")
def _length(side, width, height):  # pragma: no cover - compiled
    """Of a side (u, v), in texels."""
    x, y = side[0] * width, side[1] * height
    return np.sqrt(x * x + y * y)


@line_kernel(error_model="numpy", fastmath=FAST)
def filtered(
    texels, table, t, place, across, down, taps
):  # pragma: no cover - compiled
    """Four channels of texture t, 0..1: mean over a parallelogram.

    place : u, v of its middle;  across, down : its sides in u, v
    taps : along the short side, at most; twice as many along the long one"""
    half, width, height = _F(0.5), table[t, textures.WIDTH], table[t, textures.HEIGHT]
    wide, high = (
        _length(across, _F(width), _F(height)),
        _length(down, _F(width), _F(height)),
    )
    finest = max(min(wide, high) / _F(taps), max(wide, high) / _F(2 * taps))
    level = 0
    if finest > _F(2):
        level = min(int(np.log2(finest)), table[t, textures.LEVELS] - 1)
    # one tap is enough where a sample is no larger than a texel
    spacing = max(finest, _F(_APART)) if max(wide, high) > _F(1) else _F(1)
    n, step_u, step_v = _spread(across, wide, spacing)
    m, row_u, row_v = _spread(down, high, spacing)
    along, under = half * _F(n - 1), half * _F(m - 1)
    first_u = place[0] - along * step_u - under * row_u
    first_v = place[1] - along * step_v - under * row_v
    w, h = max(width >> level, 1), max(height >> level, 1)
    start, line = table[t, textures.OFFSETS + level], np.uintp(w + 2)
    wrap_u, wrap_v = table[t, textures.WRAP_U], table[t, textures.WRAP_V]
    nearest = table[t, textures.NEAREST] != 0 and level == 0
    t0, t1, t2, t3 = _F(0), _F(0), _F(0), _F(0)
    for j in range(m):
        for i in range(n):
            u = _wrapped(first_u + _F(i) * step_u + _F(j) * row_u, wrap_u)
            v = _wrapped(first_v + _F(i) * step_v + _F(j) * row_v, wrap_v)
            # from the border's first texel
            x, y = u * _F(w) + half, v * _F(h) + half
            left, top = np.floor(x), np.floor(y)
            fx, fy = x - left, y - top
            if nearest:
                fx, fy = _F(fx >= half), _F(fy >= half)
            p = np.uintp(start + np.int32(top) * (w + 2) + np.int32(left))
            r, one = p + line, np.uintp(1)
            upper = _mixed(_texel(texels, p), _texel(texels, p + one), fx)
            lower = _mixed(_texel(texels, r), _texel(texels, r + one), fx)
            c0, c1, c2, c3 = _mixed(upper, lower, fy)
            t0 += c0
            t1 += c1
            t2 += c2
            t3 += c3
    share = _F(1 / textures.FULL) / _F(n * m)
    return t0 * share, t1 * share, t2 * share, t3 * share
