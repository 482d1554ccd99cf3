"""The nearest face of every pixel and sample, against a plain test of every face with every
direction.
"""

import numpy as np
import pytest

from arfx.core.numerics import EPS_DEPTH_M
from arfx.stages.raster.visible import (
    Projection,
    depths_along,
    nearest_faces,
    nearest_faces_at,
)

FACES = 40


def triangles(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    middle = np.column_stack(
        [rng.uniform(-0.6, 0.6, (FACES, 2)), rng.uniform(0.8, 3.0, FACES)]
    )
    points = (middle[:, None] + rng.normal(0, 0.35, (FACES, 3, 3))).reshape(-1, 3)
    return (
        points,
        np.arange(3 * FACES, dtype=np.int32).reshape(-1, 3),
        rng.random(FACES) < 0.4,
    )


def plain(
    points: np.ndarray, faces: np.ndarray, hidden: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest face and depth along directions (n, 2), face after face."""
    nearest, depth = (
        np.full(len(directions), -1),
        np.full(len(directions), np.inf, np.float32),
    )
    d = np.column_stack([directions.astype(float), np.ones(len(directions))])
    for f, (a, b, c) in enumerate(points[faces]):
        planes = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
        volume = a @ planes[0]
        if volume > 0 and hidden[f]:
            continue
        sides = np.sign(volume) * (d @ planes.T)
        with np.errstate(invalid="ignore", divide="ignore"):
            z = (abs(volume) / sides.sum(1)).astype(np.float32)
            closer = (sides >= 0).all(1) & (z > EPS_DEPTH_M) & (z < depth)
        nearest[closer], depth[closer] = f, z[closer]
    return nearest, depth


@pytest.mark.parametrize("width", [1, 4, 7, 8, 9, 23, 64])
@pytest.mark.parametrize("projected", [True, False])
def test_each_pixel_sees_the_nearest_face_in_pictures_of_any_width(
    width: int, projected: bool
) -> None:
    rng = np.random.default_rng(width)
    points, faces, hidden = triangles(rng)
    height, focal = 11, np.array([width / 1.6, 8.0])
    centre = (np.array([width, height]) - 1) / 2
    x, y = np.meshgrid(
        *(
            (np.arange(n) - c) / f
            for n, c, f in zip((width, height), centre, focal, strict=True)
        )
    )
    x[2, 0] = np.nan  # a pixel that no direction maps to
    pixels = points[:, :2] / points[:, 2:] * focal + centre
    pixels[(points[:, 2] <= EPS_DEPTH_M) | (not projected)] = np.nan
    prim, depth = nearest_faces(Projection(pixels, points, faces, hidden, 0.0), x, y)
    expected, far = plain(
        points, faces, hidden, np.column_stack([x.ravel(), y.ravel()])
    )
    assert (expected >= 0).sum() >= min(width, 8)
    np.testing.assert_array_equal(prim.ravel(), expected)
    np.testing.assert_allclose(depth.ravel(), far, rtol=1e-6)
    again = depths_along(points, faces, prim.ravel(), x.ravel(), y.ravel())
    np.testing.assert_allclose(again, far, rtol=1e-6)


@pytest.mark.parametrize("per", [1, 3, 8, 9])
@pytest.mark.parametrize("width", [2, 9, 30])
def test_each_sample_sees_the_nearest_face_whatever_their_number(
    width: int, per: int
) -> None:
    rng = np.random.default_rng(100 * width + per)
    points, faces, hidden = triangles(rng)
    height = 3
    asked = np.flatnonzero(rng.random(width * height) < 0.6)
    slot = np.full((height, width), -1, np.int32)
    slot.flat[asked] = np.arange(len(asked))
    x, y = rng.uniform(-0.7, 0.7, (2, len(asked), per))
    projection = Projection(
        np.full((len(points), 2), np.nan), points, faces, hidden, 0.0
    )
    prim, depth = nearest_faces_at(projection, slot, x, y)
    expected, far = plain(
        points, faces, hidden, np.column_stack([x.ravel(), y.ravel()])
    )
    assert (expected >= 0).any()
    np.testing.assert_array_equal(prim.ravel(), expected)
    np.testing.assert_allclose(depth.ravel(), far, rtol=1e-6)
