"""The icosphere: counts, evenness, and every look-up against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.light.icosphere import icosphere
from arfx.core.numerics import normalise


def directions(n: int, seed: int = 0) -> np.ndarray:
    return normalise(np.random.default_rng(seed).normal(size=(n, 3)))


@pytest.mark.parametrize("level", [2, 3, 4, 5])
def test_counts_unit_length_orientation_and_spacing(level: int) -> None:
    s = icosphere(level)
    assert s.vertices.shape == (10 * 4**level + 2, 3) and s.faces.shape == (
        20 * 4**level,
        3,
    )
    assert np.abs(np.linalg.norm(s.vertices, axis=1) - 1).max() < 1e-15
    assert len(np.unique(s.vertices.round(9), axis=0)) == len(s.vertices)
    a, b, c = s.vertices[s.faces].transpose(1, 0, 2)
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a) > 0).all()  # outwards
    # closed: every edge is used once in either direction
    edges = {
        (i, j) for f in s.faces.tolist() for i, j in zip(f, f[1:] + f[:1], strict=True)
    }
    assert len(edges) == 3 * len(s.faces) and all((j, i) in edges for i, j in edges)
    sides = np.degrees(np.arccos(np.clip(np.einsum("fi,fi->f", a, b), -1, 1)))
    assert sides.max() < 78 / 2**level and sides.min() > 50 / 2**level
    assert ((b - a) * (c - a)).sum(1).min() > 0  # acute at the corner that starts a face


@pytest.mark.parametrize("level", [2, 5])
def test_nearest_is_the_nearest_of_all(level: int) -> None:
    s, d = icosphere(level), directions(2000)
    assert np.array_equal(s.nearest(d), (d @ s.vertices.T).argmax(1))
    assert np.array_equal(s.nearest(7 * d.reshape(40, 50, 3)), s.nearest(d).reshape(40, 50))


def test_zero_and_non_finite_directions_are_marked_and_harmless() -> None:
    s = icosphere(2)
    bad = np.array([[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, 0, 1.0]])
    assert s.nearest(bad).tolist()[:3] == [-1, -1, -1] and s.nearest(bad)[3] >= 0


def test_centres_are_inside_their_faces() -> None:
    s = icosphere(2)
    weights = np.linalg.solve(np.swapaxes(s.vertices[s.faces], 1, 2), s.centres[..., None])
    assert weights.min() > 0
