"""The surroundings as surfaces of any roughness see them: one cube map, filtered once for each of a few roughnesses.

A level holds the mean radiance under the lobe of GGX about each direction, seen from along it, by filtered importance
sampling (Křivánek and Colbert 2008). A look-up is linear between texels, over the faces' edges too, and between levels.
Cost: O(texels x samples) for a new cube, O(1) a look-up. Leaves out: that the lobe is longer at grazing angles.
Source: Karis 2013 (the split sum's first part), docs/methods/light.md#reflections."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.compiled import line_kernel
from arfx.core.cube import bordered, face_directions, resampled

ROUGHNESSES = (0.0, 0.2, 0.35, 0.55, 0.75, 1.0)  # of the levels
SIDES = (64, 32, 16, 8, 8, 8)  # texels of a face: about a third of the lobe's width
_SAMPLES = 32  # of a lobe
_GOLDEN_RAD = np.pi * (3 - np.sqrt(5))
_FAST = {"contract", "nsz", "arcp"}


class Environment(NamedTuple):
    """texels (n, 3) float32 : radiance, level by level, face by face, each face with a border of one texel
    sides, starts (levels,) : texels of a face without its border; a level's first row of `texels`
    roughness (levels,) : of each level
    turn (3, 3) float32 : rotation to the cube's axes from the world's"""

    texels: np.ndarray
    sides: np.ndarray
    starts: np.ndarray
    roughness: np.ndarray
    turn: np.ndarray


def environment_of(texels: np.ndarray, cube_from_world: np.ndarray) -> Environment:
    """texels : of `prefiltered`, or sums of several;  cube_from_world : (3, 3)"""
    roughness = np.array(ROUGHNESSES, np.float32)
    return Environment(texels, *layout(SIDES), roughness, cube_from_world.astype(np.float32))


def layout(sides: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(sides, starts) of levels as `Environment` keeps them."""
    count = 6 * (np.array(sides) + 2) ** 2
    return np.array(sides, np.int64), np.concatenate([[0], np.cumsum(count)[:-1]]).astype(np.int64)


def level_slices() -> list[slice]:
    """The rows of each level's texels."""
    ends = np.append(layout(SIDES)[1][1:], 6 * (SIDES[-1] + 2) ** 2 + layout(SIDES)[1][-1])
    return [slice(int(a), int(b)) for a, b in zip(layout(SIDES)[1], ends, strict=True)]


def prefiltered(cube: np.ndarray) -> np.ndarray:
    """(n, 3) float32 texels of all levels.

    cube : (6, m, m, 3) radiance, faces as core.cube's, any m >= 1"""
    finest = _sized(np.asarray(cube, np.float32), SIDES[0])
    halved, sides = [finest], [SIDES[0]]
    while sides[-1] > 4:
        sides.append(sides[-1] // 2)
        halved.append(halved[-1].reshape(6, sides[-1], 2, sides[-1], 2, 3).mean((2, 4)))
    source = np.concatenate([_packed(level) for level in halved])
    where = layout(tuple(sides))
    out = [_packed(finest)]
    for side, roughness in zip(SIDES[1:], ROUGHNESSES[1:], strict=True):
        lobe, detail = _lobe(roughness, SIDES[0])
        directions = face_directions(side).reshape(-1, 3).astype(np.float32)
        level = _filtered(source, *where, directions, lobe, detail)
        out.append(_packed(level.reshape(6, side, side, 3)))
    return np.concatenate(out)


def _sized(cube: np.ndarray, side: int) -> np.ndarray:
    """(6, side, side, 3): means of whole texels where it has more of them, linear between them where fewer."""
    n = cube.shape[1]
    if n > side and n % side == 0:
        return np.asarray(cube.reshape(6, side, n // side, side, n // side, 3).mean((2, 4)))
    return cube if n == side else resampled(cube, side)


def _packed(faces: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(bordered(faces).reshape(-1, 3), np.float32)


def _lobe(roughness: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """((k, 4) directions about +z and weights that sum to 1, (k,) which halving of a cube has texels as large as a sample)."""
    u = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    phi = np.arange(_SAMPLES) * _GOLDEN_RAD
    a2 = roughness**4
    half2 = (1 - u) / (
        1 + (a2 - 1) * u
    )  # squared cosine of the microfacet's normal, as GGX spreads it
    z = 2 * half2 - 1
    across = np.sqrt(np.clip(1 - z * z, 0, None))
    density = a2 / (np.pi * (half2 * (a2 - 1) + 1) ** 2) / 4
    texel_sr = 4 * np.pi / (6 * side * side)
    detail = 0.5 * np.log2(1 / (_SAMPLES * density * texel_sr)) + 0.5
    weight = np.clip(z, 0, None)
    rows = np.column_stack([across * np.cos(phi), across * np.sin(phi), z, weight / weight.sum()])
    on = weight > 0
    return rows[on].astype(np.float32), np.clip(detail[on], 0, None).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _filtered(source, sides, starts, directions, lobe, detail):  # pragma: no cover - compiled
    """(n, 3) means of the source about each of directions (n, 3)."""
    out = np.zeros((directions.shape[0], 3), np.float32)
    one = np.float32(1)
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        sign = one if z >= 0 else -one
        a = -one / (sign + z)
        b = x * y * a
        ux, uy, uz = one + sign * x * x * a, sign * b, -sign * x
        vx, vy, vz = b, sign + y * y * a, -y
        for k in range(lobe.shape[0]):
            p, q, s, weight = lobe[k, 0], lobe[k, 1], lobe[k, 2], lobe[k, 3]
            dx = p * ux + q * vx + s * x
            dy = p * uy + q * vy + s * y
            dz = p * uz + q * vz + s * z
            r, g, b_ = look_up(source, sides, starts, detail[k], dx, dy, dz)
            out[i, 0] += weight * r
            out[i, 1] += weight * g
            out[i, 2] += weight * b_
    return out


@line_kernel(fastmath=_FAST, error_model="numpy")
def radiance(environment: Environment, dx, dy, dz, roughness):  # pragma: no cover - compiled
    """(r, g, b) about a direction (of any length, WORLD axes), as a surface of that roughness mirrors it."""
    texels, sides, starts, levels, turn = environment
    x = turn[0, 0] * dx + turn[0, 1] * dy + turn[0, 2] * dz
    y = turn[1, 0] * dx + turn[1, 1] * dy + turn[1, 2] * dz
    z = turn[2, 0] * dx + turn[2, 1] * dy + turn[2, 2] * dz
    k = 0
    while k < levels.shape[0] - 2 and roughness > levels[k + 1]:
        k += 1
    part = (roughness - levels[k]) / (levels[k + 1] - levels[k])
    return look_up(texels, sides, starts, np.float32(k) + part, x, y, z)


@line_kernel(fastmath=_FAST, error_model="numpy")
def look_up(texels, sides, starts, level, x, y, z):  # pragma: no cover - compiled
    """(r, g, b) in a direction of any length, the cube's axes; linear between levels, the last beyond them."""
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        s = one / max(ax, np.float32(1e-20))
        face, u, v = 0 if x > zero else 1, -z * s, y * s
    elif ay >= az:
        s = one / max(ay, np.float32(1e-20))
        face, u, v = 2 if y > zero else 3, x * s, -z * s
    else:
        s = one / max(az, np.float32(1e-20))
        face, u, v = 4 if z > zero else 5, x * s, y * s
    last = np.float32(sides.shape[0] - 1)
    level = min(max(level, zero), last)
    first = min(int(level), sides.shape[0] - 2)
    part = level - np.float32(first)
    r, g, b = zero, zero, zero
    for q in range(2):
        share = part if q else one - part
        if share <= zero:
            continue
        side, start = sides[first + q], starts[first + q]
        scale = half * np.float32(side)
        column, row = (u + one) * scale + half, (v + one) * scale + half
        i, j = min(max(int(column), 0), side), min(max(int(row), 0), side)
        fc, fr = column - np.float32(i), row - np.float32(j)
        near = np.uintp(start + (face * (side + 2) + j) * (side + 2) + i)
        below = near + np.uintp(side + 2)
        r += share * _between(texels, near, below, fc, fr, 0)
        g += share * _between(texels, near, below, fc, fr, 1)
        b += share * _between(texels, near, below, fc, fr, 2)
    return r, g, b


@line_kernel(fastmath=_FAST)
def _between(texels, near, below, fc, fr, channel):  # pragma: no cover - compiled
    """One channel between four texels: those at `near` and `below`, and those to their right."""
    right, across = near + np.uintp(1), below + np.uintp(1)
    top = texels[near, channel] + fc * (texels[right, channel] - texels[near, channel])
    low = texels[below, channel] + fc * (texels[across, channel] - texels[below, channel])
    return top + fr * (low - top)
