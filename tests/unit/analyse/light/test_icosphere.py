"""The icosphere: counts, evenness, and every look-up against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.light.icosphere import Icosphere, icosphere
from arfx.core.numerics import normalise


def interpolated(
    sphere: Icosphere, values: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """(..., *rest) of values (v, *rest) at directions (..., 3), by the weights of `locate`;
    0 where a direction is zero.
    """
    face, w = sphere.locate(directions)
    corners = values[sphere.faces[np.maximum(face, 0)]]
    return np.asarray(
        (w.reshape(*w.shape, *(1,) * (values.ndim - 1)) * corners).sum(face.ndim)
    )


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


@pytest.mark.parametrize("level", [0, 2, 4])
def test_locate_finds_the_face_that_brute_force_finds(level: int) -> None:
    s, d = icosphere(level), directions(1500, 1)
    face, w = s.locate(d)
    all_weights = np.einsum(
        "fij,nj->nfi", np.linalg.inv(np.swapaxes(s.vertices[s.faces], 1, 2)), d
    )
    assert np.array_equal(face, all_weights.min(-1).argmax(1))
    assert w.min() >= 0 and np.abs(w.sum(1) - 1).max() < 1e-12
    point = np.einsum("nk,nki->ni", w, s.vertices[s.faces[face]])
    assert (
        np.abs(normalise(point) - d).max() < 1e-12
    )  # the weights are exact, not merely near


def test_interpolation_is_exact_at_vertices_and_for_linear_fields() -> None:
    s = icosphere(3)
    values = np.random.default_rng(2).normal(size=(len(s.vertices), 2, 3))
    assert np.abs(interpolated(s, values, s.vertices) - values).max() < 1e-9
    d = directions(400, 3)
    face, w = s.locate(d)
    got = interpolated(s, s.vertices @ np.array([1.0, -2, 0.5]), d)
    flat = np.einsum("nk,nki->ni", w, s.vertices[s.faces[face]]) @ [1.0, -2, 0.5]
    assert np.abs(got - flat).max() < 1e-12
    # a smooth field: the error falls with the square of the spacing
    errors = [
        np.abs(
            interpolated(icosphere(k), icosphere(k).vertices[:, 2] ** 2, d) - d[:, 2] ** 2
        ).max()
        for k in (2, 3, 4)
    ]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_zero_and_non_finite_directions_are_marked_and_harmless() -> None:
    s = icosphere(2)
    bad = np.array([[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, 0, 1.0]])
    assert s.nearest(bad).tolist()[:3] == [-1, -1, -1] and s.nearest(bad)[3] >= 0
    face, w = s.locate(bad)
    assert (
        face[:3].tolist() == [-1, -1, -1]
        and not w[:3].any()
        and abs(w[3].sum() - 1) < 1e-12
    )
    assert interpolated(s, np.ones(len(s.vertices)), bad).tolist() == pytest.approx(
        [0, 0, 0, 1]
    )
    with pytest.raises(ValueError, match="level 6"):
        icosphere(6)


def test_centres_are_inside_their_faces() -> None:
    s = icosphere(2)
    assert np.array_equal(s.locate(s.centres)[0], np.arange(len(s.faces)))
