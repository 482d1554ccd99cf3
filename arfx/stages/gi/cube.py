"""Directions and solid angles of a cube map's texels; faces +x, -x, +y, -y, +z, -z, as the analysis folds them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from arfx.core.numerics import normalise


@lru_cache(maxsize=4)
def texel_directions(size: int) -> np.ndarray:
    """(6, size, size, 3) unit. A face's rows and columns run along the other two axes, the last of them towards -z on the
    sides and towards +z's y on front and back: the layout of analyse.environment."""
    t = (np.arange(size) + 0.5) / size * 2 - 1
    v, u = np.meshgrid(t, t, indexing="ij")
    one = np.ones_like(u)
    faces = [(one, v, -u), (-one, v, -u), (u, one, -v), (u, -one, -v), (u, v, one), (u, v, -one)]
    out = normalise(np.stack([np.stack(f, -1) for f in faces]))
    out.setflags(write=False)
    return out


@lru_cache(maxsize=4)
def texel_solid_angles(size: int) -> np.ndarray:
    """(size, size) steradians; six faces make 4 pi."""
    t = np.arange(size + 1) / size * 2 - 1
    v, u = np.meshgrid(t, t, indexing="ij")
    corner = np.arctan2(u * v, np.sqrt(u * u + v * v + 1))
    out: np.ndarray = corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]
    out.setflags(write=False)
    return out


def mip_level(half_angle_rad: float, size: int) -> float:
    """Level of a cube's mip chain whose texels are as large as a cone: half log2 of the ratio of solid angles, >= 0."""
    cone = 2 * np.pi * (1 - np.cos(half_angle_rad))
    return float(max(0.5 * np.log2(max(cone / (4 * np.pi / (6 * size * size)), 1e-12)), 0.0))
