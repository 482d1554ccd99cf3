"""What real planes do to each other's light: a wall stands before a part of the floor's sky, and the object's shadow on the
floor is missing from the floor's light on the wall.

Only where there are several planes. Gathered coarsely (COARSE texels a side: it is soft) by the planes' own cones, as the
planes with the object's change less the planes without. Cost: O(planes x COARSE^2 x cones), once per light.
"""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.numerics import divide
from arfx.stages.gi.surroundings import Behind, Planes, behind_many

COARSE = 48


def coarse_places(places: np.ndarray) -> np.ndarray:
    """(c, c, 3) of the places (side, side, 3) of a plane's texels: of every so many, c = COARSE at most."""
    step = max(places.shape[0] // COARSE, 1)
    return np.asarray(places[step // 2 :: step, step // 2 :: step])


def light_between(
    planes: Planes, places: np.ndarray, directions: np.ndarray, weights: np.ndarray, left: np.ndarray, tan_half: float,
    changed: Behind, unchanged: Behind,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(p, side, side, 3) radiance of white planes that they gain (or lose) because the other planes are changed, and the share
    of the environment's light that they have with the other planes in it.

    places (p, side, side, 3);  directions (p, k, 3), weights (k,) : of each plane's cones;  left (p, c, c, k) : what the object
    lets through of them
    """
    side = places.shape[1]
    gained, share = np.zeros((len(places), side, side, 3), np.float32), np.ones((len(places), side, side, 3), np.float32)
    half_deg = np.float32(np.degrees(np.arctan(tan_half)))
    bare = unchanged._replace(axes=unchanged.axes[:0])
    for k in range(len(places)):
        at = coarse_places(places[k])
        c, count = at.shape[0], directions.shape[1]
        points = np.ascontiguousarray(np.repeat(at.reshape(-1, 3), count, 0), np.float32)
        around = np.ascontiguousarray(np.tile(directions[k], (c * c, 1)), np.float32)
        seen = [behind_many(points, around, k, np.float32(tan_half), half_deg, a) for a in (changed, unchanged, bare)]
        more, with_planes, without = (v.reshape(c, c, count, 3) * weights[:, None] for v in (seen[0] - seen[1], *seen[1:]))
        gained[k] = _enlarged((more * left[k][..., None]).sum(2), side)
        share[k] = _enlarged(divide(with_planes.sum(2), without.sum(2), where_zero=1.0), side)
    return gained, share


def _enlarged(texture: np.ndarray, side: int) -> np.ndarray:
    return np.asarray(cv2.resize(texture.astype(np.float32), (side, side), interpolation=cv2.INTER_LINEAR))
