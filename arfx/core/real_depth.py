"""Measured depth of the real scene: in one frame, as the facts carry it, and the planes
that were found in it.

The pixels are `Layer.REAL_DEPTH`; what the planner needs to know of them before any pixel
is read is here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy import ndarray

from arfx.core.codec import Document, Packed
from arfx.core.pose import Pose

TILE_PX = 64
TYPICAL_NOISE = 0.007  # of depth cameras, fraction of the distance


@dataclass(frozen=True, eq=False)
class RealDepth(Document):
    """map : number of the depth map;  scale : metres of it to true ones;  digest : of the
    map's file
    tiles : (2, th, tw) float32, least and greatest dioptre, 1/m, in every TILE_PX-th tile
    of the frame
    noise : standard deviation of a pixel on the prints, fraction of its distance; the
    typical one without prints
    """

    map: int
    scale: float
    digest: str
    tiles: Annotated[ndarray, Packed("<f2", "f4")]
    noise: float = TYPICAL_NOISE

    @staticmethod
    def of(
        map: int,
        scale: float,
        digest: str,
        tiles: ndarray,
        noise: float = TYPICAL_NOISE,
    ) -> RealDepth:
        """tiles : of `tile_ranges`, which are made a little wider, to what float16 can hold"""
        ends = np.array([0, np.inf], np.float16)[:, None, None]
        wider = np.nextafter(tiles.astype(np.float16), ends)
        wider = np.minimum(wider, np.finfo(np.float16).max).astype(np.float32)
        return RealDepth(map, scale, digest, wider, noise)

    @property
    def dioptre_range(self) -> tuple[float, float]:
        return float(self.tiles[0].min()), float(self.tiles[1].max())


def tile_ranges(depth_m: ndarray, size: tuple[int, int]) -> ndarray:
    """(2, th, tw) float32, least and greatest dioptre in every tile of a frame of `size`
    (width, height).
    depth_m : (h, w), any size of the same shape as the frame; not finite or <= 0 = unknown.
    A tile that holds an unknown
    pixel has the range of the whole map, since it may be filled from anywhere.
    Raises ValueError where nothing is known."""
    with np.errstate(all="ignore"):
        known = np.isfinite(depth_m) & (depth_m > 0)
        dioptre = np.where(known, 1.0 / depth_m, 0.0)
    if not known.any():
        raise ValueError("no pixel of the map is known")
    # one pixel more on each side: the map is resampled to the frame
    rows, columns = (
        [
            slice(
                max(i * TILE_PX * n // of - 1, 0), -(-(i + 1) * TILE_PX * n // of) + 1
            )
            for i in range(-(-of // TILE_PX))
        ]
        for n, of in zip(depth_m.shape, size[::-1], strict=True)
    )

    def tiles(values: ndarray, reduce: np.ufunc) -> ndarray:
        bands = np.stack([reduce.reduce(values[part]) for part in rows])
        return np.stack([reduce.reduce(bands[:, part], 1) for part in columns], 1)

    least = np.where(known, dioptre, dioptre[known].min())
    most = np.where(known, dioptre, dioptre[known].max())
    ranges = tiles(least, np.minimum), tiles(most, np.maximum)
    return np.stack(ranges).astype("f4")


@dataclass(frozen=True, eq=False)
class RealPlane(Document):
    """world_from_plane : z out of the plane, towards the room, origin in the middle of what
    was seen of it
    extent_m : (x0, y0, x1, y1) of what was seen, plane axes;  area_m2 : of it, holes left out
    ends : for each of its four sides, whether the plane was seen to end there, or the
    picture did (False)
    residual_mm : root mean square of its points' distances;  points : how many;  frames :
    in how many maps it was found
    """

    world_from_plane: Pose
    extent_m: tuple[float, float, float, float]
    area_m2: float
    residual_mm: float
    points: int
    frames: int = 1
    ends: tuple[bool, bool, bool, bool] = (False, False, False, False)
