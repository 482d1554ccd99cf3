"""How wide a surface mirrors, and how much of what lies about the mirrored direction.

Source: Karis 2013 (split sum); docs/methods/gi.md#gloss."""

import numpy as np
from numpy import ndarray

from arfx.stages.light.split_sum import COSINES, ROUGHNESSES, split_sum

_BEND = 0.5  # normals of neighbours that differ by more lie on two sides of an edge


def mirror_tangent(roughness: ndarray | float) -> ndarray:
    """Tangent of the half-angle of a cone about the mirrored direction that blurs like a
    GGX lobe of width roughness^2.

    Half of the microfacets' normals lie within atan(a) (GGX: D integrates to tan^2 / (a^2 +
    tan^2)); the mirrored direction turns twice as far. Of a cone, half lies within 1 /
    sqrt(2) of its half-angle: so it is that much wider."""
    a = np.clip(np.asarray(roughness, float), 0.0, 1.0) ** 2
    return np.clip(
        np.tan(np.minimum(np.sqrt(8) * np.arctan(a), np.radians(50))), 0.01, None
    )


def gloss_weights(
    roughness: ndarray | float, cosine: ndarray
) -> tuple[ndarray, ndarray]:
    """(a, b), each (n,): F0 x a + b of what lies about the mirrored direction is reflected.

    cosine (n,) : of the view
    """
    from scipy.ndimage import map_coordinates

    row = np.broadcast_to(roughness, cosine.shape) * (ROUGHNESSES - 1)
    places = row, cosine * (COSINES - 1)
    a, b = (
        map_coordinates(part, places, order=1, mode="nearest")
        for part in np.moveaxis(split_sum(), 2, 0)
    )
    return a, b


def widened_roughness(
    roughness: ndarray, coverage: ndarray, normal: ndarray
) -> ndarray:
    """(h, w) roughness whose lobe is as wide as what one pixel of the curved surface
    mirrors, if that is more than its own.

    Neighbours whose normals differ by d mirror directions 2 d apart: half of that is the
    half-angle. Without it a
    mirror's rim shows every n-th pixel of what it squeezes together. roughness, coverage
    (h, w);  normal (h, w, 3)
    """
    most = np.zeros(coverage.shape, np.float32)
    for axis in (0, 1):
        covered, largest = (
            np.moveaxis(coverage, axis, 0) > 0,
            np.moveaxis(most, axis, 0),
        )
        apart = (np.diff(np.moveaxis(normal, axis, 0), axis=0) ** 2).sum(-1)
        apart *= covered[:-1] & covered[1:] & (apart < _BEND * _BEND)
        for either in (largest[:-1], largest[1:]):
            np.maximum(either, apart, out=either)
    # mirror_tangent: about sqrt(8) roughness^2
    return np.maximum(roughness, np.sqrt(0.35355 * np.sqrt(most)))
