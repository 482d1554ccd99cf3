"""Lights as the paper finds them: peaks of each frame's light map, on the hemisphere that the markers face.

What the lights at its peaks give is taken out of the map M, so that a surface with everything in its light shows M. The
rest is written as a cube, for shading, and as its harmonics of degree 2, for what knows nothing of maps. Directions that no
marker faced (M is near 0 there as printed, for ever) have the harmonics' light in the cube too.
The paper states no brightness of a light: here M at the peak less its smallest value where something was seen.
Source: Tan, Chen, Sun 2009, eq. (7) to (9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from arfx.analyse.light import light_map
from arfx.analyse.light.fit import paper_lights
from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.params import LightParams
from arfx.core.cube import face_directions
from arfx.core.light import DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import normalise

CUBE = {2: 8, 3: 16, 4: 32, 5: 48}  # side of a face by the map's level
_SEEN = 1e4  # a vertex's variance over the least, up to which it was faced: weight 1 %
_RIDGE = 1e-3  # of the harmonics' own weight: directions that no marker faced say nothing


def paper_lights_of(
    seen: Sequence[light_map.Observation], map_params: light_map.Params, params: LightParams
) -> tuple[list[Light], list[np.ndarray]]:  # fmt: skip
    """One light per observation, and the map beside its lamps as a cube (6, n, n, 3), in the axes of the normals.

    The hemisphere's axis is the mean of all normals.
    """
    up = normalise(np.concatenate([o.normals for o in seen]).sum(0))
    turn = _upright(up)
    sphere = icosphere(map_params.level)
    rows = [light_map.Observation(o.time_s, o.normals @ turn.T, o.irradiance, o.variance) for o in seen]
    basis = harmonics(sphere.vertices)
    size = CUBE[map_params.level]
    texels = face_directions(size).reshape(-1, 3)
    face, share = sphere.locate(texels @ turn.T)
    corners = sphere.faces[face]
    out, cubes = [], []
    for value, variance in light_map.smooth(rows, map_params):
        known = (variance < light_map.UNKNOWN).all(1) & (value.max(1) > 0)
        brightest = float(value[sphere.faces].mean((1, 2)).max())
        peaks = paper_lights(value, map_params.level, params.peak * brightest, params.peak_apart_deg)
        least = value[known].min(0) if known.any() else np.zeros(3)
        lamps, rest = [], value.copy()
        for d in peaks[:2]:
            rgb = np.clip(sphere.interpolate(value, d) - least, 0, None)
            towards = turn.T @ d
            lamps.append(DirectionalLight(triple(towards), triple(rgb), 0.0))
            rest -= np.clip(sphere.vertices @ d, 0, None)[:, None] * rgb
        weight = known.astype(float)
        normal = basis.T @ (basis * weight[:, None]) + _RIDGE * max(weight.sum(), 1.0) * np.eye(9)
        soft = np.linalg.solve(normal, basis.T @ (rest * weight[:, None]))
        faced = known & (variance <= _SEEN * np.where(known[:, None], variance, np.inf).min(0)).all(1)
        filled = np.where(faced[:, None], rest, basis @ soft)
        cubes.append((share[..., None] * filled[corners]).sum(1).reshape(6, size, size, 3))
        light = Light.of_soft(soft, (), "marker").turned(turn.T)
        out.append(replace(light, lights=tuple(lamps)))
    return out, cubes


def _upright(up: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that turns `up` into z."""
    across = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0.0, 1, 0])
    x = normalise(across - (across @ up) * up)
    return np.stack([x, np.cross(up, x), up])
