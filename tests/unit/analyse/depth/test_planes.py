"""Planes in a measured depth map: rooms of known planes with noise, holes and clutter; what
is no plane; several maps.
"""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.depth.planes import (
    cloud_of,
    facing_up,
    find_planes,
    scene_planes,
    seen_of,
)
from arfx.core.camera import Camera
from arfx.core.numerics import divide
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.real_depth import RealPlane

CAMERA = Camera(320, 240, np.array([[260.0, 0, 160], [0, 260, 120], [0, 0, 1]]))
# camera_from_world of a camera 1.4 m over the floor z = 0 that looks along y, turned down
# by 25 degrees
POSE = Pose(
    rotation_from_euler_deg(90 + 25, 0, 0),
    rotation_from_euler_deg(90 + 25, 0, 0) @ -np.array([0, 0, 1.4]),
)
FLOOR, WALL, SIDE = (
    (np.array([0, 0, 1.0]), 0.0),
    (np.array([0, -1.0, 0]), -3.0),
    (np.array([1.0, 0, 0]), -1.2),
)


def room(
    pose: Pose = POSE,
    noise: float = 0.0,
    holes: float = 0.0,
    table: bool = False,
    seed: int = 0,
) -> np.ndarray:
    """(h, w) depth; noise : metres at 1 m, with the square of the distance, rounded to
    millimetres.
    """
    y, x = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    d = CAMERA.directions(np.stack([x, y], -1).astype(float)) @ pose.rotation
    d /= (d @ pose.rotation.T)[..., 2:]
    eye = pose.inverse().translation_m
    z = np.full(x.shape, np.inf)
    for n, offset in (FLOOR, WALL, SIDE):
        t = divide(offset - eye @ n, d @ n, where_zero=np.inf)
        z = np.where((t > 0) & (t < z), t, z)
    if table:
        t = divide(0.6 - eye[2], d[..., 2], where_zero=np.inf)
        p = eye + t[..., None] * d
        z = np.where(
            (t > 0)
            & (t < z)
            & (np.abs(p[..., 0] - 0.5) < 0.35)
            & (np.abs(p[..., 1] - 1.6) < 0.3),
            t,
            z,
        )
    rng = np.random.default_rng(seed)
    z = (
        np.round(
            1000
            * (
                np.where(z < 50, z, 0)
                + noise * np.minimum(z, 9) ** 2 * rng.standard_normal(z.shape)
            )
        )
        / 1000
    )
    gone = rng.random((24, 32)) < holes
    z[np.kron(gone, np.ones((10, 10), bool))] = 0
    return z


@pytest.mark.parametrize(
    ("noise", "holes"), [(0.0, 0.0), (0.0015, 0.0), (0.0015, 0.32), (0.0015, 0.5)]
)
def test_floor_and_walls_with_noise_and_holes(noise: float, holes: float) -> None:
    cloud = cloud_of(room(noise=noise, holes=holes), CAMERA)
    found = find_planes(cloud)
    assert len(found) == 3
    for n, offset in (FLOOR, WALL, SIDE):
        m = POSE.rotation @ n
        best = max(found, key=lambda p: float(p.normal @ m))
        assert np.degrees(np.arccos(min(best.normal @ m, 1.0))) < 0.1 + 150 * noise
        at = -best.normal * -best.offset_m  # its point nearest the camera
        assert abs(POSE.inverse().apply(at) @ n - offset) < 0.001 + 3 * noise
        off_mm = 1e3 * (cloud.points[best.inliers] @ best.normal - best.offset_m)
        assert 0.2 * noise * 1e3 < np.sqrt((off_mm**2).mean()) < 1.5 + 1e4 * noise
    assert sum(len(p.inliers) for p in found) > 0.8 * len(cloud.points)


def test_a_table_is_a_plane_of_its_own_and_clutter_is_none() -> None:
    depth = room(noise=0.001, table=True)
    y, x = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    ball = (x - 90.0) ** 2 + (y - 150.0) ** 2 < 35**2
    depth[ball] -= (
        0.02
        * np.sqrt(
            35**2 - (x - 90.0) ** 2 - (y - 150.0) ** 2,
            where=ball,
            out=np.zeros(x.shape),
        )[ball]
    )
    cloud = cloud_of(depth, CAMERA)
    heights = sorted(
        float(POSE.inverse().apply(cloud.points[p.inliers]).mean(0)[2])
        for p in find_planes(cloud)
        if p.normal @ POSE.rotation[:, 2] > 0.95
    )
    assert heights == pytest.approx([0.0, 0.6], abs=0.01)


def test_what_is_no_plane_gives_none() -> None:
    y, x = np.mgrid[0:240, 0:320]
    bumps = 2 + 0.3 * np.sin(x / 6.0) * np.cos(y / 5.0)
    cloud = cloud_of(bumps, CAMERA)
    assert not find_planes(cloud)
    noise = np.random.default_rng(0).uniform(0.5, 5, (240, 320))
    cloud = cloud_of(noise, CAMERA)
    assert not find_planes(cloud)
    for empty in (np.zeros((240, 320)), np.full((240, 320), np.nan)):
        assert not find_planes(cloud_of(empty, CAMERA))


def test_the_search_is_the_same_each_time() -> None:
    a, b = (
        find_planes(c)
        for c in (
            cloud_of(room(noise=0.002), CAMERA),
            cloud_of(room(noise=0.002), CAMERA),
        )
        if c is not None
    )
    assert [p.offset_m for p in a] == [p.offset_m for p in b]


def test_planes_of_several_maps_are_one_and_the_floor_is_to_stand_on() -> None:
    """Detection from two places, a wall first by its size: what faces up is the floor."""
    turned = rotation_from_euler_deg(0, 12, 0) @ POSE.rotation
    poses = [POSE, Pose(turned, turned @ -np.array([0.3, 0.2, 1.5]))]
    planes = scene_planes(
        [(room(p, 0.001, 0.3, seed=k), p) for k, p in enumerate(poses)], CAMERA
    )
    assert len(planes) == 3 and all(p.frames == 2 for p in planes)
    best = facing_up(planes, poses)
    assert len(best) == 1
    plane = best[0]
    stands = plane.world_from_plane
    assert abs(stands.translation_m[2]) < 0.004 and stands.rotation[2, 2] > 0.9999
    assert (
        np.linalg.det(stands.rotation) == pytest.approx(1) and plane.residual_mm < 10
    )
    seen = CAMERA.project(POSE.apply(stands.translation_m))
    assert 0 < seen[0] < CAMERA.width and 0 < seen[1] < CAMERA.height
    x0, y0, x1, y1 = plane.extent_m
    assert x0 < 0 < x1 and y0 < 0 < y1


def test_a_wall_alone_is_nothing_to_stand_on() -> None:
    level = Pose(
        rotation_from_euler_deg(90, 0, 0),
        rotation_from_euler_deg(90, 0, 0) @ -np.array([0, 2.4, 1.4]),
    )
    depth = room(level)
    planes = scene_planes(
        [(np.where(np.arange(240)[:, None] < 150, depth, 0), level)], CAMERA
    )
    assert planes and not facing_up(planes, [level])


def test_what_is_seen_closes_holes_and_keeps_the_gap_of_a_corridor() -> None:
    rng = np.random.default_rng(1)
    positions = rng.uniform([-1, -1], [1, 1], (9000, 2))
    positions = positions[
        ~((np.abs(positions[:, 0]) < 0.25) & (positions[:, 1] > -0.5))
    ]
    seen = seen_of(positions, np.full(len(positions), 0.025))
    assert seen.area_m2 == pytest.approx(4 - 0.5 * 1.5, rel=0.05)
    assert abs(seen.middle_m[0]) > 0.25 or seen.middle_m[1] < -0.5


def test_a_table_ends_and_the_floor_goes_on_beyond_the_picture() -> None:
    """The table's four sides are in the picture; the floor ends at the walls and is cut by
    the picture's lower border.
    """
    planes = scene_planes([(room(noise=0.001, table=True), POSE)], CAMERA)
    level = sorted(
        (p for p in planes if p.world_from_plane.rotation[2, 2] > 0.95),
        key=lambda p: p.world_from_plane.translation_m[2],
    )
    floor, table = level
    assert (
        table.ends == (True,) * 4
        and RealPlane.from_json(table.to_json()).ends == table.ends
    )
    x0, y0, x1, y1 = table.extent_m
    assert x1 - x0 == pytest.approx(0.7, abs=0.1) and y1 - y0 == pytest.approx(
        0.6, abs=0.1
    )
    assert not all(floor.ends)
    old = {k: v for k, v in table.to_json().items() if k != "ends"}
    assert RealPlane.from_json(old).ends == (False,) * 4
