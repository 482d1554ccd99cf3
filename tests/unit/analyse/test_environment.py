"""The cube folded out of a picture, and the soft light that it gives."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.environment import Surroundings, face_directions, fold, scaled_to, soft_light, solid_angles
from arfx.core.light import Light, harmonics

GREY = np.full((90, 120, 3), [0.2, 0.4, 0.6])


def test_solid_angles_make_the_sphere() -> None:
    assert 6 * solid_angles(16).sum() == pytest.approx(4 * np.pi, abs=1e-12)


def test_a_constant_picture_gives_constant_surroundings() -> None:
    faces = fold(GREY)
    assert np.abs(faces - [0.2, 0.4, 0.6]).max() < 1e-6
    soft = soft_light(faces, np.eye(3))
    n = np.random.default_rng(0).normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    light = Light((0, 0, 0), (), "environment", tuple(map(tuple, soft)))
    assert np.abs(light.soft_radiance(n) - [0.2, 0.4, 0.6]).max() < 2e-3  # a white surface looks like what it sees


def test_sides_join_the_front_without_a_seam() -> None:
    y, x = np.mgrid[0:90, 0:120]
    picture = np.stack([x / 120, y / 90, 0.5 + 0 * x], -1)
    right, left, down, up, front, back = fold(picture, 30)
    pitch = 1 / 3 / 30
    assert np.abs(right[:, 0, 0] - front[:, -1, 0] - pitch).max() < 0.2 * pitch
    assert np.abs(front[:, 0, 0] - left[:, 0, 0] - pitch).max() < 0.2 * pitch
    assert np.abs(down[0, :, 1] - front[-1, :, 1] - pitch).max() < 0.2 * pitch
    assert np.abs(front[0, :, 1] - up[0, :, 1] - pitch).max() < 0.2 * pitch
    assert (back == front).all()


def test_directions_of_the_sides_touch_those_of_the_front() -> None:
    right, left, down, up, front, _ = face_directions(32)
    for side, edge in (
        (right[:, 0], front[:, -1]), (left[:, 0], front[:, 0]), (down[0], front[-1]), (up[0], front[0])
    ):  # fmt: skip
        assert (np.sum(side * edge, -1) > np.cos(np.radians(4))).all()


def test_a_bright_side_lights_the_surfaces_that_face_it_after_any_turn() -> None:
    picture = np.full((90, 120, 3), 0.1)
    picture[30:60, 80:] = 1.0  # what stands right of the camera
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # world_from_camera
    soft = soft_light(fold(picture), turn)
    light = Light((0, 0, 0), (), "environment", tuple(map(tuple, soft)))
    towards, away = light.soft_radiance(turn @ [1.0, 0, 0]), light.soft_radiance(turn @ [-1.0, 0, 0])
    assert (towards > 2.5 * away).all()


def test_harmonics_are_orthonormal() -> None:
    basis = harmonics(face_directions(64).reshape(-1, 3))
    weight = np.tile(solid_angles(64).ravel(), 6)
    assert np.abs(basis.T @ (basis * weight[:, None]) - np.eye(9)).max() < 2e-3


def test_scaled_light_matches_what_was_measured_and_black_stays_finite() -> None:
    n = np.array([[0.0, 0, 1.0]])
    for picture in (GREY, 0 * GREY, np.full_like(GREY, np.nan)):
        soft = scaled_to(soft_light(fold(picture), np.eye(3)), n, np.array([[0.5, 0.4, 0.3]]))
        assert np.isfinite(soft).all()
        assert harmonics(n) @ soft == pytest.approx(np.array([[0.5, 0.4, 0.3]]))


def test_smoothing_follows_slowly_and_resumes_exactly() -> None:
    a, b = Surroundings(0.5), Surroundings(0.5)
    first = a.step(0.0, GREY, np.eye(3)).copy()
    after = a.step(0.1, 2 * GREY, np.eye(3)).copy()
    assert (after[0] / first[0] - 1 > 0.15).all() and (after[0] / first[0] - 1 < 0.25).all()
    b.restore(Surroundings(0.5).state())
    b.step(0.0, GREY, np.eye(3))
    c = Surroundings(0.5)
    c.restore(b.state())
    assert (c.step(0.1, 2 * GREY, np.eye(3)) == after).all()
