"""What the parts of this stage hand to one another: named tuples of arrays that belong together.

Compiled loops take them, and are compiled again for each mix of types: dtypes and order are fixed.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.layers import Layer

# Columns of a pixel's sums, each weighted by how much of the pixel it is.
COVERED, MET, ALBEDO, NORMAL, MATERIAL, EMISSIVE = 0, 1, 2, 5, 8, 11
PLAIN_COLUMNS = 14
# Of models that have them.
OCCLUSION, COAT, SHEEN, SMOOTH = 14, 15, 17, 21
ALL_COLUMNS = 24


class GBuffer(NamedTuple):
    """The layers that this stage always writes, over one rectangle."""

    coverage: ndarray
    depth: ndarray
    normal: ndarray
    position: ndarray
    albedo: ndarray
    material: ndarray
    emissive: ndarray
    object_id: ndarray


OUTPUTS = tuple(Layer(name) for name in GBuffer._fields)
# Written where the model has them: layer -> its columns of the sums.
EXTRA_OUTPUTS = {
    Layer.OCCLUSION: OCCLUSION,
    Layer.COAT: slice(COAT, COAT + 2),
    Layer.SHEEN: slice(SHEEN, SHEEN + 4),
    Layer.SMOOTH_NORMAL: slice(SMOOTH, SMOOTH + 3),
}


class View(NamedTuple):
    """How the pixels of one rectangle look at the model.

    x, y : (h, w) float64, their directions, z = 1, with MARGIN pixels on each side; NaN = none
    points : (n, 3) float64, the mesh's vertices, camera axes;  rotation : (3, 3), camera from world
    eye : (3,) float64, world;  pixel : side of a pixel at depth 1
    taps : of a texture along the short side of a sample, at most"""

    x: ndarray
    y: ndarray
    points: ndarray
    rotation: ndarray
    eye: ndarray
    pixel: float
    taps: int


MARGIN = 2


def bounds_of(view: View) -> tuple[ndarray, ndarray]:
    """The least and the greatest x and y (2,) of the directions; inf, -inf without any."""
    low, high = (
        np.array([bound(a, initial=start) for a in (view.x, view.y)])
        for bound, start in ((np.nanmin, np.inf), (np.nanmax, -np.inf))
    )
    return low, high


class Rays(NamedTuple):
    """Rays through pixels, those of one pixel one after the other.

    pixel : (k,) int64, row of the sums that a ray belongs to;  face : (k,) int32, -1 = none
    x, y : (k,) float64 directions, z = 1;  share : (k,) float32, of the pixel, sides as its root
    clear : (k,) float32, light of what is behind that passes through all that the ray met
    reached : (k,) float32, depth of the last surface met, metres
    depth : (k,) float32, of the first surface that shows, inf = none
    part : (k,) int32, its part, -1 = none"""

    pixel: ndarray
    face: ndarray
    x: ndarray
    y: ndarray
    share: ndarray
    clear: ndarray
    reached: ndarray
    depth: ndarray
    part: ndarray


def rays_through(
    pixel: ndarray,
    face: ndarray,
    x: ndarray,
    y: ndarray,
    share: ndarray,
) -> Rays:
    """Rays that have met nothing yet."""
    count = len(face)
    return Rays(
        pixel,
        face,
        x,
        y,
        share,
        np.ones(count, np.float32),
        np.zeros(count, np.float32),
        np.full(count, np.inf, np.float32),
        np.full(count, -1, np.int32),
    )


# Face, -1 = none, and depth along directions x, y: (h, w) of the rectangle's pixels, or (n, s) of
# the samples of pixels (n,), which are numbered within it.
NearestFaces = Callable[..., tuple[ndarray, ndarray]]
