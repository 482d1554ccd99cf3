"""The surroundings as surfaces of any roughness see them: one cube map, filtered once for
each of a few roughnesses.

A level holds the mean radiance under the lobe of GGX about each direction, seen from along
it, by filtered importance sampling (Křivánek and Colbert 2008). A look-up is linear between
texels, over the faces' edges too, and between levels.
Cost: O(texels x samples) for a new cube, O(1) a look-up. Leaves out: that the lobe is
longer at grazing angles.
Source: Karis 2013 (the split sum's first part), docs/methods/light.md#reflections."""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Sequence
from functools import lru_cache
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, kernel, line_kernel
from arfx.core.cube import bordered, face_directions, resampled
from arfx.core.sampling import GOLDEN_RAD, frame_about
from arfx.core.vectors import mixed, shifted, turned, vector
from arfx.stages.light.planes import halvings

_F = np.float32
ROUGHNESSES = (0.0, 0.2, 0.35, 0.55, 0.75, 1.0)  # of the levels
SIDES = (64, 32, 16, 8, 8, 8)  # texels of a face: about a third of the lobe's width
SAMPLES = (0, 24, 32, 32, 32, 32)  # of a lobe, of each level
_COARSEST_PX = 4  # of a face that samples are taken from


class Environment(NamedTuple):
    """texels (n, 3) float32 : radiance, level by level, face by face, each face with a
    border of one texel sides, starts (levels,) : texels of a face without its border; a
    level's first row of `texels` roughness (levels,) : of each level turn (3, 3) float32 :
    rotation to the cube's axes from the world's"""

    texels: ndarray
    sides: ndarray
    starts: ndarray
    roughness: ndarray
    turn: ndarray


def environment_of(texels: ndarray, cube_from_world: ndarray) -> Environment:
    """texels : of `prefiltered`, or sums of several;  cube_from_world : (3, 3)"""
    roughness = np.array(ROUGHNESSES, np.float32)
    return Environment(
        texels, *layout(SIDES), roughness, cube_from_world.astype(np.float32)
    )


def layout(sides: Sequence[int]) -> tuple[ndarray, ndarray]:
    """(sides, starts) of levels as `Environment` keeps them."""
    count = 6 * (np.array(sides) + 2) ** 2
    return np.array(sides, np.int64), np.cumsum(count) - count


def level_slices() -> list[slice]:
    """The rows of each level's texels."""
    sides, starts = layout(SIDES)
    ends = starts + 6 * (sides + 2) ** 2
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]


def prefiltered(cube: ndarray) -> ndarray:
    """(n, 3) float32 texels of all levels.

    cube : (6, m, m, 3) radiance, faces as core.cube's, m <= 64
    """
    if not cube.any():
        return np.zeros((level_slices()[-1].stop, 3), np.float32)
    finest = resampled(np.asarray(cube, np.float32), SIDES[0])
    halved = halvings(finest, _COARSEST_PX)
    sides = [level.shape[1] for level in halved]
    source = np.concatenate([_packed(level) for level in halved])
    out = [_packed(finest)]
    levels = zip(SIDES, ROUGHNESSES, SAMPLES, strict=True)
    for side, roughness, samples in islice(levels, 1, None):
        directions, details, weight = _lobes(side, roughness, samples)
        light = look_ups(source, *layout(sides), details, directions)
        level = weight @ light.reshape(-1, samples, 3)
        out.append(_packed(level.reshape(6, side, side, 3)))
    return np.concatenate(out)


def _packed(faces: ndarray) -> ndarray:
    return np.ascontiguousarray(bordered(faces).reshape(-1, 3), np.float32)


@lru_cache(maxsize=len(SIDES))
def _lobes(
    side: int, roughness: float, samples: int
) -> tuple[ndarray, ndarray, ndarray]:
    """(directions (n, 3) of all samples of the lobes about a level's texels; (n,) the halving
    whose texels are as large as a sample; weights (samples,) of sum 1)."""
    u = (np.arange(samples) + 0.5) / samples
    phi = np.arange(samples) * GOLDEN_RAD
    alpha2 = roughness**4
    # squared cosine of the microfacet's normal, as GGX spreads it
    half2 = (1 - u) / (1 + (alpha2 - 1) * u)
    z = 2 * half2 - 1
    across = np.sqrt(np.clip(1 - z * z, 0, None))
    density = alpha2 / (4 * np.pi * (half2 * (alpha2 - 1) + 1) ** 2)
    texel_sr = 4 * np.pi / (6 * SIDES[0] ** 2)
    detail = np.clip(0.5 * np.log2(2 / (samples * density * texel_sr)), 0, None)
    weight = np.clip(z, 0, None)
    lobe = np.stack([across * np.cos(phi), across * np.sin(phi), z], -1)
    axes = face_directions(side).reshape(-1, 3)
    directions = (lobe @ np.stack([*frame_about(axes), axes], 1)).astype(np.float32)
    details = np.tile(detail.astype(np.float32), len(axes))
    return (
        directions.reshape(-1, 3),
        details,
        (weight / weight.sum()).astype(np.float32),
    )


@kernel(fastmath=FAST, error_model="numpy")
def look_ups(texels, sides, starts, level, directions):  # pragma: no cover - compiled
    """(n, 3) of `look_up` at levels (n,) in directions (n, 3)."""
    out = np.empty((directions.shape[0], 3), np.float32)
    for i in range(directions.shape[0]):
        light = look_up(texels, sides, starts, level[i], vector(directions[i]))
        out[i, 0], out[i, 1], out[i, 2] = light
    return out


@line_kernel(fastmath=FAST, error_model="numpy")
def radiance(
    environment: Environment, direction, roughness
):  # pragma: no cover - compiled
    """(r, g, b) about a direction (of any length, WORLD axes), as a surface of that
    roughness mirrors it.
    """
    texels, sides, starts, levels, turn = environment
    k = 0
    while k < levels.shape[0] - 2 and roughness > levels[k + 1]:
        k += 1
    # a lobe's half-angle grows as the square of its roughness
    low = levels[k] * levels[k]
    part = (roughness * roughness - low) / (levels[k + 1] * levels[k + 1] - low)
    in_cube = turned(turn, direction)
    return look_up(texels, sides, starts, _F(k) + part, in_cube)


@line_kernel(fastmath=FAST, error_model="numpy")
def look_up(texels, sides, starts, level, direction):  # pragma: no cover - compiled
    """(r, g, b) in a direction of any length, the cube's axes; linear between levels, the
    last beyond them.
    """
    zero, one, half = _F(0), _F(1), _F(0.5)
    x, y, z = direction
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        s = one / max(ax, _F(1e-20))
        face, u, v = 0 if x > zero else 1, -z * s, y * s
    elif ay >= az:
        s = one / max(ay, _F(1e-20))
        face, u, v = 2 if y > zero else 3, x * s, -z * s
    else:
        s = one / max(az, _F(1e-20))
        face, u, v = 4 if z > zero else 5, x * s, y * s
    last = _F(sides.shape[0] - 1)
    level = min(max(level, zero), last)
    first = min(int(level), sides.shape[0] - 2)
    part = level - _F(first)
    light = zero, zero, zero
    for q in range(2):
        share = part if q else one - part
        if share <= zero:
            continue
        side, start = sides[first + q], starts[first + q]
        scale = half * _F(side)
        column, row = (u + one) * scale + half, (v + one) * scale + half
        i, j = min(max(int(column), 0), side), min(max(int(row), 0), side)
        fc, fr = column - _F(i), row - _F(j)
        near = np.uintp(start + (face * (side + 2) + j) * (side + 2) + i)
        below = near + np.uintp(side + 2)
        top = mixed(texels[near], texels[near + np.uintp(1)], fc)
        low = mixed(texels[below], texels[below + np.uintp(1)], fc)
        light = shifted(light, share, mixed(top, low, fr))
    return light
