"""The nearest face of every pixel and sample, against a plain test of every face with every direction."""

import numpy as np
import pytest

from arfx.core.numerics import EPS_DEPTH_M
from arfx.stages.raster.visibility import nearest_faces, nearest_faces_at

FACES = 40


def triangles(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    middle = np.column_stack([rng.uniform(-0.6, 0.6, (FACES, 2)), rng.uniform(0.8, 3.0, FACES)])
    points = (middle[:, None] + rng.normal(0, 0.35, (FACES, 3, 3))).reshape(-1, 3)
    return points, np.arange(3 * FACES, dtype=np.int32).reshape(-1, 3), rng.random(FACES) < 0.4


def plain(points: np.ndarray, faces: np.ndarray, hidden: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest face and depth along directions (n, 2), face after face."""
    nearest, depth = np.full(len(directions), -1), np.full(len(directions), np.inf, np.float32)
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


@pytest.mark.parametrize("width", [1, 4, 5, 6, 7, 8, 9, 23, 64])
def test_each_pixel_sees_the_nearest_face_in_pictures_of_any_width(width: int) -> None:
    rng = np.random.default_rng(width)
    points, faces, hidden = triangles(rng)
    height = 11
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, width + 2), np.linspace(-0.6, 0.6, height + 2))
    lens = np.stack([x, y], -1).astype(np.float32)
    lens[3, 1] = np.nan  # a pixel that no direction maps to
    x0 = rng.integers(0, width, FACES)
    box = np.stack([x0, np.zeros(FACES, int), rng.integers(x0, width) + 1, np.full(FACES, height)], 1).astype(np.int32)
    box[: FACES // 2] = [0, 0, width, height]
    directions = (lens[1:-1, 1:-1, k].astype(float) for k in range(2))
    *nearest, front = nearest_faces(points, faces, hidden, box, *directions, EPS_DEPTH_M)
    prim, u, v, depth = (a.ravel() for a in nearest)

    column = np.tile(np.arange(width), height)
    expected, far = np.full(width * height, -1), np.full(width * height, np.inf, np.float32)
    for f in range(FACES):
        one, z = plain(points, faces[f : f + 1], hidden[f : f + 1], lens[1:-1, 1:-1].reshape(-1, 2))
        better = (one == 0) & (column >= box[f, 0]) & (column < box[f, 2]) & (z < far)
        expected[better], far[better] = f, z[better]
    assert (expected >= 0).sum() >= min(width, 8)
    np.testing.assert_array_equal(prim, expected)
    np.testing.assert_allclose(depth, far, rtol=1e-6)
    seen = prim >= 0
    assert (u[seen] >= 0).all() and (v[seen] >= 0).all() and (u[seen] + v[seen] <= 1 + 1e-6).all()
    assert front.any() and not front.all()


@pytest.mark.parametrize("per", [1, 3, 4, 8, 9, 16])
@pytest.mark.parametrize("width", [2, 9, 30])
def test_each_sample_sees_the_nearest_face_whatever_their_number(width: int, per: int) -> None:
    rng = np.random.default_rng(100 * width + per)
    points, faces, hidden = triangles(rng)
    height = 3
    asked = np.flatnonzero(rng.random(width * height) < 0.6)
    slot = np.full((height, width), -1, np.int32)
    slot.flat[asked] = np.arange(len(asked))
    samples = rng.uniform(-0.7, 0.7, (len(asked), per, 2)).astype(np.float32)
    box = np.tile(np.array([0, 0, width, height], np.int32), (FACES, 1))
    directions = (np.ascontiguousarray(samples[..., k], float) for k in range(2))
    met = nearest_faces_at(points, faces, hidden, box, slot, *directions, EPS_DEPTH_M)
    prim, _, _, depth = (a.ravel() for a in met)
    expected, far = plain(points, faces, hidden, samples.reshape(-1, 2))
    assert (expected >= 0).any()
    np.testing.assert_array_equal(prim, expected)
    np.testing.assert_allclose(depth, far, rtol=1e-6)
