"""Point sequences that fill a disc, a square, a hemisphere or a sphere evenly, and axes about
a normal."""

import numpy as np
from numpy import ndarray

GOLDEN_RAD = float(np.pi * (3 - np.sqrt(5)))
# its powers give sequences of low discrepancy (Roberts 2018)
_PLASTIC = 1.32471795724474602596


def disc(n: int) -> ndarray:
    """(n, 2) points of equal area on the unit disc (Vogel's spiral)."""
    i = np.arange(n) + 0.5
    r, phi = np.sqrt(i / n), i * GOLDEN_RAD
    return np.stack([r * np.cos(phi), r * np.sin(phi)], -1)


def hemisphere(n: int) -> ndarray:
    """(n, 3) unit directions around +z whose mean visibility is the cosine-weighted one.

    Source: Malley's method, a disc lifted to the hemisphere."""
    return np.column_stack([disc(n), np.sqrt(1 - (np.arange(n) + 0.5) / n)])


def sphere(n: int) -> ndarray:
    """(n, 3) unit directions all around, on a Fibonacci spiral.

    Source: Gonzalez 2010, Measurement of areas on a sphere using Fibonacci lattices."""
    k = np.arange(n) + 0.5
    z, phi = 1 - 2 * k / n, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def r2(n: int) -> ndarray:
    """(n, 2) points within 0..1 that fill a square evenly (R2 sequence, Roberts 2018)."""
    i = np.arange(1, n + 1)[:, None]
    return np.mod(0.5 + i * np.array([1 / _PLASTIC, 1 / _PLASTIC**2]), 1)


def frame_about(normals: ndarray) -> tuple[ndarray, ndarray]:
    """Two unit axes (..., 3) across unit normals (..., 3), continuous but at -z.

    Source: Duff et al. 2017, "Building an orthonormal basis, revisited"."""
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    return first, np.stack([b, sign + y * y * a, -y], -1)
