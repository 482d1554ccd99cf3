"""Pixels against OpenCV's projection, flow against the pictures themselves, axes against
each other.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.synth.clip import frame_truth
from arfx.synth.description import SceneFile, parse_scene
from arfx.synth.picture import Picture
from arfx.synth.world import World, look_at

FRONTAL = 'kind = "static"\nposition_m = [0, 0, 1.0]\ntarget_m = [0, 0, 0]'


def scene(
    body: str, width: int = 80, height: int = 60, frames: int = 3, path: str = FRONTAL
) -> SceneFile:
    return parse_scene(
        f"[clip]\nwidth = {width}\nheight = {height}\n[[shot]]\nframes ="
        f" {frames}\n[shot.path]\n{path}\n{body}"
    )


LENSES = {
    "pinhole": "fov_deg = 60",
    "off centre": "fov_deg = 60\ncentre_offset_px = [6.5, -4.25]",
    "barrel": "fov_deg = 75\ndistortion = [-0.22, 0.06, 0.001, -0.002, -0.005]",
    "fisheye": 'fov_deg = 80\nmodel = "fisheye"\ndistortion = [0.02, -0.01, 0.002, 0.0]',
}
TABLE = """
[[plane]]
size_m = [1.5, 1.5]
texture = { kind = "noise", feature_m = 0.06 }
[[box]]
size_m = [0.2, 0.15, 0.1]
position_m = [-0.2, 0.1, 0]
rotate_deg = [0, 0, 30]
[[sphere]]
radius_m = 0.06
position_m = [0.2, 0.1, 0.06]
"""
TILTED = 'kind = "static"\nposition_m = [0.1, -0.6, 0.7]\ntarget_m = [0, 0, 0]'


@pytest.mark.parametrize("lens", LENSES)
def test_every_surface_point_projects_onto_its_own_pixel_by_opencv(lens: str) -> None:
    world = World(scene(f"[lens]\n{LENSES[lens]}\n{TABLE}", path=TILTED))
    picture = Picture(world)
    depth, owner = picture.surfaces(0)
    y, x = np.nonzero(owner)
    points = (
        np.concatenate([picture.rays(0, 0)[y, x], np.ones((len(x), 1))], -1)
        * depth[y, x, None]
    )
    c = world.camera
    if c.model == "fisheye":
        pixels = cv2.fisheye.projectPoints(
            points[:, None], np.zeros(3), np.zeros(3), c.matrix, c.distortion
        )[0][:, 0]
    else:
        d = c.distortion if c.distortion.size else np.zeros(4)
        pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), c.matrix, d)[0][
            :, 0
        ]
    np.testing.assert_allclose(pixels, np.stack([x, y], -1), atol=1e-5)
    room = world.camera_at(0, 0.0).inverse().apply(points)
    assert np.abs(room[owner[y, x] == 1][:, 2]).max() < 1e-9  # the table is z = 0
    ball = np.linalg.norm(room[owner[y, x] == 3] - [0.2, 0.1, 0.06], axis=1)
    np.testing.assert_allclose(ball, 0.06, atol=1e-9)
    assert room[owner[y, x] == 2][:, 2].max() == pytest.approx(0.1, abs=1e-9)


def test_flow_carries_one_frame_onto_the_next() -> None:
    """Photometric check, independent of the flow's own formula: sample frame 1 where flow
    says, compare with frame 0.
    """
    path = (
        'kind = "dolly"\nposition_m = [-0.05, -0.5, 0.7]\nend_m = [0.05, -0.5,'
        " 0.66]\ntarget_m = [0, 0, 0]"
    )
    body = (
        "[lens]\ndistortion = [-0.15, 0.03, 0, 0]\n[light]\nlamps = []\n"
        + TABLE.split("[[box]]")[0]
    )
    world = World(scene(body, 160, 120, 4, path))
    picture = Picture(world)
    depth, owner = picture.surfaces(1)
    flow = picture.flow(1, depth, owner)
    before, after = (picture.radiance(n)[..., 0].astype(np.float32) for n in (1, 2))
    y, x = np.indices(depth.shape)
    u, v = (
        (flow[..., 0] + x).astype(np.float32),
        (flow[..., 1] + y).astype(np.float32),
    )
    there = cv2.remap(after, u, v, cv2.INTER_LINEAR)
    inside = np.isfinite(flow).all(-1) & (u > 2) & (v > 2) & (u < 157) & (v < 117)
    assert np.nanmax(np.abs(flow)) > 2
    moved, still = np.abs(there - before)[inside], np.abs(after - before)[inside]
    assert moved.mean() < 0.15 * still.mean()


def test_flow_of_a_moving_object() -> None:
    body = """
[[box]]
size_m = [0.2, 0.2, 0.05]
motion = { kind = "keys", keys = [{ time_s = 0, position_m = [-0.2, 0, 0] }, { time_s = 1, position_m = [0.2, 0, 0] }] }
"""
    world = World(scene(body, frames=2, path=FRONTAL))
    picture = Picture(world)
    depth, owner = picture.surfaces(0)
    flow = picture.flow(0, depth, owner)
    per_frame = (
        (world.poses(1 / 24)[0].translation_m - world.poses(0.0)[0].translation_m)[0]
        * world.camera.fx
        / 0.95
    )
    assert per_frame > 0.05
    np.testing.assert_allclose(
        flow[owner == 1],
        np.broadcast_to([per_frame, 0], (int((owner == 1).sum()), 2)),
        atol=1e-6,
    )
    assert np.isnan(flow[owner == 0]).all()


def test_a_marker_seen_from_behind_or_out_of_the_picture_is_not_visible() -> None:
    marker = '\n[[marker]]\nspec = "36h11:3:200mm"\n'
    for path in (
        FRONTAL.replace("1.0]", "-1.0]"),
        'kind = "static"\nposition_m = [0, 0, 1]\ntarget_m = [5, 0, 1]',
    ):
        world = World(scene(marker, path=path))
        assert frame_truth(world, 0).markers["36h11:3"].visible == 0


def test_lights_of_the_truth_agree_in_all_frames_of_reference() -> None:
    body = '[[marker]]\nspec = "36h11:3:100mm"\nrotate_deg = [40, 10, 70]\n'
    body += "[light]\nlamps = [{ azimuth_deg = 30, elevation_deg = 40 }]"
    world = World(scene(body, path=TILTED))
    truth = frame_truth(world, 0)
    lamp = truth.lights[0]
    e, a = np.radians(40), np.radians(30)
    np.testing.assert_allclose(
        lamp["room"],
        [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)],
        atol=1e-12,
    )
    in_camera = (
        truth.markers["36h11:3"].camera_from_marker.rotation
        @ lamp["marker"]["36h11:3"]
    )
    np.testing.assert_allclose(in_camera, lamp["camera"], atol=1e-12)


@pytest.mark.parametrize("offset_m", [0.5, 1e-3, 1e-4, 1e-6, 1e-10, 0.0])
def test_looking_straight_down_is_never_singular(offset_m: float) -> None:
    for sign in (1, -1):
        pose = look_at(np.array([offset_m, 0, sign * 1.0]), np.zeros(3))
        np.testing.assert_allclose(
            pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12
        )
        assert np.linalg.det(pose.rotation) == pytest.approx(1)
        seen = pose.apply(np.zeros(3))
        np.testing.assert_allclose(seen[:2], 0, atol=1e-12)
        assert seen[2] == pytest.approx(np.hypot(1, offset_m))


def test_an_attached_object_follows() -> None:
    body = """
[[marker]]
spec = "36h11:3:100mm"
motion = { kind = "keys", keys = [
    { time_s = 0, position_m = [0.1, 0, 0] },
    { time_s = 1, position_m = [0.1, 0, 0], rotate_deg = [0, 0, 90] },
] }
[[box]]
position_m = [0.2, 0, 0]
attached_to = "36h11:3"
"""
    world = World(scene(body, path=FRONTAL))
    np.testing.assert_allclose(
        world.poses(0.0)[0].translation_m, [0.3, 0, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        world.poses(1.0)[0].translation_m, [0.1, 0.2, 0], atol=1e-12
    )
