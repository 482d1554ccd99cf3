"""The cube folded out of a picture, and the soft light that it gives."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from arfx.analyse.light.seen import given_everywhere
from arfx.analyse.light.surroundings import (
    EnvironmentSample,
    cube_from_picture,
    environment_sample,
    face_directions,
    from_panorama,
    overhead,
    soft_light,
    soft_of,
    solid_angles,
    turned,
    with_environment,
)
from arfx.core.cube import look_up
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.light import Light, harmonics
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.papers.s4_environment import step3_environment
from arfx.stages.light.surroundings import checked_faces

GREY = np.full((90, 120, 3), [0.2, 0.4, 0.6])


def test_solid_angles_make_the_sphere() -> None:
    assert 6 * solid_angles(16).sum() == pytest.approx(4 * np.pi, abs=1e-12)


def test_a_constant_picture_gives_constant_surroundings() -> None:
    faces = step3_environment(GREY)
    assert np.abs(faces - [0.2, 0.4, 0.6]).max() < 1e-6
    soft = soft_of(faces, np.eye(3))
    n = np.random.default_rng(0).normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    light = Light((0, 0, 0), (), "environment", tuple(map(tuple, soft)))
    assert (
        np.abs(light.soft_radiance(n) - [0.2, 0.4, 0.6]).max() < 2e-3
    )  # a white surface looks like what it sees


def test_sides_join_the_front_without_a_seam() -> None:
    y, x = np.mgrid[0:90, 0:120]
    picture = np.stack([x / 120, y / 90, 0.5 + 0 * x], -1)
    right, left, down, up, front, back = step3_environment(picture, 30)
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
    soft = soft_of(step3_environment(picture), turn)
    light = Light((0, 0, 0), (), "environment", tuple(map(tuple, soft)))
    towards, away = (
        light.soft_radiance(turn @ [1.0, 0, 0]),
        light.soft_radiance(turn @ [-1.0, 0, 0]),
    )
    assert (towards > 2.5 * away).all()


def test_harmonics_are_orthonormal() -> None:
    basis = harmonics(face_directions(64).reshape(-1, 3))
    weight = np.tile(solid_angles(64).ravel(), 6)
    assert np.abs(basis.T @ (basis * weight[:, None]) - np.eye(9)).max() < 2e-3


def largest_step(faces: np.ndarray) -> float:
    """The largest difference of radiance between texels that are neighbours on the sphere,
    over any edge.
    """
    d = face_directions(faces.shape[1]).reshape(-1, 3)
    near = (d @ d.T > np.cos(np.radians(1.6 * 90 / faces.shape[1]))) & ~np.eye(
        len(d), dtype=bool
    )
    a, b = np.nonzero(near)
    flat = faces.reshape(-1, 3)
    return float(np.abs(flat[a] - flat[b]).max())


def test_the_papers_fold_has_a_seam_and_the_corrected_one_none() -> None:
    y, x = np.mgrid[0:180, 0:240]
    picture = np.stack(
        [x / 240, y / 180, 0.5 + 0 * x], -1
    )  # left dark, right bright: the back's edges clash
    assert largest_step(step3_environment(picture, 12)) > 0.3
    assert largest_step(cube_from_picture(picture, 12)) < 0.16
    assert np.abs(cube_from_picture(GREY) - [0.2, 0.4, 0.6]).max() < 1e-6
    quad = np.array([[100.0, 80], [140, 80], [140, 120], [100, 120]])
    kept = environment_sample(0, picture, quad, 240, np.zeros(3)).cube
    assert largest_step(kept) < 0.3 and kept.shape == (6, 6, 6, 3)


def test_the_corrected_fold_keeps_sides_where_they_are() -> None:
    picture = np.zeros((90, 120, 3))
    picture[:, 90:, 0] = 1  # right
    picture[70:, :, 1] = 1  # below
    faces = cube_from_picture(picture, 12)
    right, left, down, up = (
        look_up(faces, np.array([v], float))[0]
        for v in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0])
    )
    assert right[0] > 0.9 > 0.1 > left[0] and down[1] > 0.9 > 0.1 > up[1]
    ahead, behind = (look_up(faces, np.array([[0, 0, z]], float))[0] for z in (1, -1))
    np.testing.assert_allclose(ahead, behind, atol=1e-6)


@pytest.mark.parametrize("angles", [(0, 0, 0), (90, 0, 0), (20, -35, 110)])
def test_a_turned_cube_shows_the_same_in_the_room(
    angles: tuple[float, float, float],
) -> None:
    rotation = rotation_from_euler_deg(*angles)
    d = face_directions(32)
    smooth = np.stack([1 + d[..., 0], 1 + d[..., 1] * d[..., 2], 1 - d[..., 2]], -1)
    made = turned(smooth, rotation)
    at = d.reshape(-1, 3) @ rotation.T
    want = np.stack([1 + at[:, 0], 1 + at[:, 1] * at[:, 2], 1 - at[:, 2]], -1)
    np.testing.assert_allclose(made.reshape(-1, 3), want, atol=0.05)


def test_a_panorama_looks_along_x_and_its_lamps_are_cut() -> None:
    picture = np.full((64, 128, 3), 0.1)
    picture[:, 24:40, 0] = 1.0  # left half: +y
    picture[10:12, 64:66] = 5000.0
    faces = from_panorama(picture, 8)
    side, other = look_up(faces, np.array([[0, 1.0, 0], [0, -1.0, 0]]))
    assert side[0] > 0.9 and other[0] < 0.2
    assert faces.max() < 0.02 * 5000


def test_every_frame_of_a_shot_has_one_environment_fixed_in_the_room() -> None:
    poses = [
        Pose(rotation_from_euler_deg(0, 0, 40 * k), np.array([0, 0, 1.0]))
        for k in range(3)
    ]
    facts = [
        FrameFacts(k, k / 30, status=MEASURED, camera_from_world=p, opacity=1)
        for k, p in enumerate(poses)
    ]
    facts.append(FrameFacts(3, 0.1))
    d = face_directions(8)
    room = np.stack([1 + d[..., 0], 1 + d[..., 1], 1 + 0 * d[..., 2]], -1)
    samples = [
        EnvironmentSample(k, turned(room, p.rotation.T), np.zeros(3), np.zeros(3))
        for k, p in enumerate(poses)
    ]
    made = with_environment(facts, samples, False)
    assert (
        made[3].environment is None
        and made[0].environment is made[2].environment is not None
    )
    np.testing.assert_allclose(checked_faces(made[0].environment), room, atol=0.12)
    # a camera that stands still sees the same while the marker turns: other axes every
    # frame, one room
    still = with_environment(
        facts,
        [EnvironmentSample(0, room, np.zeros(3), np.zeros(3))],
        True,
    )
    assert still[2].environment is not None and still[2].environment.axes is not None
    room_at_rest = turned(
        checked_faces(still[2].environment),
        np.reshape(still[2].environment.axes, (3, 3)),
    )
    back = turned(room_at_rest, poses[2].rotation.T)
    np.testing.assert_allclose(back, room, atol=0.25)
    given, _ = given_everywhere(facts, np.full((16, 32, 3), 0.3), np.eye(3))
    np.testing.assert_allclose(checked_faces(given[1].environment), 0.3, rtol=2e-3)


def looking(pitch_deg: float) -> np.ndarray:
    """(3, 3) world_from_camera of a camera held upright that looks down by that angle,
    along the world's y; z is up.
    """
    return rotation_from_euler_deg(-90 - pitch_deg, 0, 0)


def test_light_comes_from_over_a_plane_that_lies_and_from_before_and_above_one_that_stands() -> (
    None
):
    lying, standing = np.array([0.0, 0, 1]), np.array([0.0, -1, 0])
    for pitch in (20, 35, 45):
        np.testing.assert_allclose(
            overhead([looking(pitch)], lying), lying, atol=1e-9
        )
    half = np.array([0, -1, 1]) / np.sqrt(2)
    for pitch in (-0.0, 10, 40):
        np.testing.assert_allclose(
            overhead([looking(pitch)], standing), half, atol=1e-9
        )
    straight_down = overhead([looking(90)], lying)
    np.testing.assert_allclose(
        straight_down, np.array([0, 1, 1]) / np.sqrt(2), atol=1e-9
    )  # a wall would look the same
    path = [overhead([looking(p)], lying) for p in np.linspace(20, 90, 71)]
    assert max(np.linalg.norm(b - a) for a, b in pairwise(path)) < 0.04


@pytest.mark.parametrize(
    ("plane_up", "pitch"), [((0.0, 0, 1), 40), ((0.0, -1, 0), 5)]
)
def test_soft_light_of_a_grey_room_has_a_form_and_no_direction(
    plane_up: tuple[float, float, float], pitch: float
) -> None:
    turn, up, shown = looking(pitch), np.array(plane_up), np.array([0.6, 0.5, 0.4])
    sample = EnvironmentSample(
        0,
        cube_from_picture(np.full((90, 120, 3), 0.4), 6),
        np.full(3, 0.25),
        np.zeros(3),
    )
    light = soft_light([sample], [turn], up, shown)
    assert not light.lights
    np.testing.assert_allclose(light.radiance(up), shown, rtol=1e-6)
    top, bottom = light.radiance(np.array([[0.0, 0, 1], [0, 0, -1]]))
    assert (top > 1.3 * bottom).all() and (top < 3 * bottom).all()
