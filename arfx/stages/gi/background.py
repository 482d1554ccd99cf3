"""What lies behind the object: the real planes with the picture on them, else the environment.

A lobe that is mirrored meets the planes in its cone, the nearest first, and the environment
with what is left. Planes carry the picture's radiance as a texture with a mip chain, denser
in the middle, where the object stands.
Cost: O(rays x planes). Source: docs/methods/gi.md#gloss. Leaves out: real things that are no plane.
"""

# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.vectors import dot, minus, mixed, shifted, vector
from arfx.stages.gi.gloss import mirror_tangent
from arfx.stages.light.environment import Environment, radiance
from arfx.stages.light.planes import BEHIND, WARP

_OUTER = np.float32(
    3
)  # levels from the coarsest: an eighth of a side, beyond four radii of the object
_EDGE = np.float32(0.03)  # of half_m: softness of a plane's end, at least


class Background(NamedTuple):
    """axes (p, 4, 3) : of `Planes`;  extents (p, 5) : half_m and bounds
    textures (p, texels, 3) : mips of all levels in one row;  mips (levels, 2) : offset, side
    environment : with the turn from the anchor's axes"""

    axes: ndarray
    extents: ndarray
    textures: ndarray
    mips: ndarray
    environment: Environment


def behind_object(
    background: Background,
    places: ndarray,
    directions: ndarray,
    roughness: ndarray,
) -> ndarray:
    """(m, 3) radiance from places (m, 3), metres, about unit directions (m, 3), as surfaces
    of roughness (m,) mirror it.
    """
    places, directions, roughness = (
        np.ascontiguousarray(a, np.float32) for a in (places, directions, roughness)
    )
    tangents = mirror_tangent(roughness).astype(np.float32)
    out = np.zeros(places.shape, np.float32)
    _add_radiances(out, background, places, directions, roughness, tangents)
    return out


@line_kernel(fastmath=FAST, error_model="numpy")
def _add_radiances(
    out, background: Background, places, directions, roughness, tangents
):  # pragma: no cover - compiled
    """A cone that lies across a plane's horizon sees it with the part of its width that is
    under it, and the environment with the rest, about the middle of that and narrower.
    Beyond a plane's end the next one shows. tangents (m,) : of the cones"""
    axes, extents, textures, mips, environment = background
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    for i in range(places.shape[0]):
        place, d, tangent = vector(places[i]), vector(directions[i]), tangents[i]
        reach = tangent / np.sqrt(one + tangent * tangent)
        # direction of what is over the horizons, and how much of the cone's width
        up, over, light = d, one, (zero, zero, zero)
        left, beyond = one, np.float32(-1)
        for _ in range(axes.shape[0]):
            p, distance, down = _next_plane(axes, extents, place, d, reach, beyond)
            if p < 0:
                break
            beyond, normal = distance, vector(axes[p, 3])
            sink = max(half * (down + reach) - down, zero)
            met = shifted(place, distance, shifted(d, -sink, normal))
            met = minus(met, axes[p, 0])
            a, b = dot(met, axes[p, 1]), dot(met, axes[p, 2])
            first, last = min(a - extents[p, 1], b - extents[p, 2]), extents[p, 3] - a
            inside = min(first, min(last, extents[p, 4] - b))
            size = extents[p, 0]
            soft = max(distance * tangent, _EDGE * size)
            within = min(max(half + half * inside / soft, zero), one)
            share = left * within * min(max(half + half * down / reach, zero), one)
            if share <= zero:
                continue
            footprint = distance * tangent / size
            seen = _plane_radiance(textures[p], mips, a / size, b / size, footprint)
            light = shifted(light, share, seen)
            left -= share
            if abs(down) < reach:
                rise = half * within * (down + reach)
                up = shifted(up, rise, normal)
                over *= one - half * rise / reach
            if left <= np.float32(1e-3):
                break
        if left > np.float32(1e-3):
            # the half-angle of a lobe grows as the square of its roughness
            around = radiance(environment, up, roughness[i] * np.sqrt(over))
            light = shifted(light, left, around)
        out[i, 0], out[i, 1], out[i, 2] = light


@line_kernel(fastmath=FAST, error_model="numpy")
def _next_plane(
    axes, extents, place, direction, reach, beyond
):  # pragma: no cover - compiled
    """(plane, distance, sine by which the cone's middle points down to it) of the nearest
    farther than `beyond`; -1 = none.

    reach : sine of the cone's half-angle"""
    half, zero = np.float32(0.5), np.float32(0)
    nearest, plane, sine = np.float32(1e30), -1, zero
    for p in range(axes.shape[0]):
        down = -dot(direction, axes[p, 3])
        height = dot(minus(place, axes[p, 0]), axes[p, 3])
        if down <= -reach or height < -np.float32(BEHIND) * extents[p, 0]:
            continue
        # middle of the part of the cone that is under the horizon
        middle = max(down, half * (down + reach))
        distance = max(height, zero) / max(middle, np.float32(1e-4))
        if distance > beyond and distance < nearest:
            nearest, plane, sine = distance, p, down
    return plane, nearest, sine


@line_kernel(fastmath=FAST, error_model="numpy")
def _plane_radiance(texture, mips, a, b, footprint):  # pragma: no cover - compiled
    """(r, g, b) of one plane's texture at a, b (in half sides from its middle), mean over
    `footprint` half sides.
    """
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    far = max(abs(a), abs(b))
    # the warp's slope is WARP / (1 + (WARP - 1) |x|)^2
    slope = one + (WARP - one) * far
    texels = footprint * WARP / (slope * slope) * np.float32(mips[0, 1])
    last = np.float32(mips.shape[0] - 1)
    # beyond the texture the plane looks as its outer parts do on average: not as near the
    # object, with its shadow
    outer = max(last - _OUTER, zero) * min(
        max((far - one) * np.float32(2), zero), one
    )
    level = min(max(np.log2(max(texels, one)), outer), last)
    first = int(level)
    u = min(max(WARP * a / (one + (WARP - one) * abs(a)), -one), one)
    v = min(max(WARP * b / (one + (WARP - one) * abs(b)), -one), one)
    light = zero, zero, zero
    for q in range(2):
        share = abs(np.float32(1 - q) - (level - np.float32(first)))
        if share <= zero:
            continue
        start, side = mips[first + q, 0], mips[first + q, 1]
        most = np.float32(side - 1)
        column = min(max((u + one) * half * np.float32(side) - half, zero), most)
        row = min(max((v + one) * half * np.float32(side) - half, zero), most)
        i, j = int(column), int(row)
        right, below = min(i + 1, side - 1), min(j + 1, side - 1)
        fi, fj = column - np.float32(i), row - np.float32(j)
        above, under = start + j * side, start + below * side
        top = mixed(texture[above + i], texture[above + right], fi)
        low = mixed(texture[under + i], texture[under + right], fi)
        light = shifted(light, share, mixed(top, low, fj))
    return light
