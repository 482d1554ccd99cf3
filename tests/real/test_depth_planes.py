"""Planes of real depth: Kinect pictures with a third of holes, and rendered rooms of ICL-NUIM."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.analyse.depth.planes import cloud_of, facing_up, find_planes, scene_planes
from arfx.core.camera import Camera
from arfx.core.pose import Pose

DATA = (
    Path(__file__).parents[2].parent
    / "shared"
    / "data"
    / "rgbd"
    / "gaoxiang12-slambook2"
)
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not DATA.is_dir(), reason="no ../shared/data/rgbd: real depth is not here"
    ),
]
KINECT = Camera(640, 480, np.array([[518.0, 0, 325.5], [0, 519, 253.5], [0, 0, 1]]))
ICL = Camera(640, 480, np.array([[481.2, 0, 319.5], [0, 480, 239.5], [0, 0, 1]]))


def depth(name: str, scale: float) -> np.ndarray:
    raw = cv2.imread(str(DATA / name), cv2.IMREAD_UNCHANGED)
    assert raw is not None
    return raw.astype(float) / scale


@pytest.mark.parametrize("number", [1, 3, 5])
def test_the_floor_before_a_kinect(number: int) -> None:
    map_ = depth(f"ch5_rgbd/depth/{number}.pgm", 1000)
    assert 0.25 < (map_ == 0).mean() < 0.33
    planes = scene_planes([(map_, Pose.identity())], KINECT)
    floor = facing_up(planes, [Pose.identity()])[0]
    height = -float(
        floor.world_from_plane.rotation[:, 2] @ floor.world_from_plane.translation_m
    )
    assert 1.25 < height < 1.5 and floor.residual_mm < 10 and floor.area_m2 > 1
    seen = KINECT.project(floor.world_from_plane.translation_m)
    assert 0 < seen[0] < 640 and 240 < seen[1] < 480


def test_a_rendered_room() -> None:
    cloud = cloud_of(depth("ch12_dense_RGBD/depth/1.png", 5000), ICL)
    found = find_planes(cloud)
    off_mm = [
        1e3 * np.abs(cloud.points[p.inliers] @ p.normal - p.offset_m) for p in found
    ]
    assert len(found) >= 5 and max(np.sqrt((off**2).mean()) for off in off_mm) < 1
    assert sum(len(p.inliers) for p in found) > 0.7 * len(cloud.points)
    walls = [p.normal for p in found[:3]]
    assert np.abs(np.array(walls) @ np.array(walls).T - np.eye(3)).max() < 0.03, (
        "two walls and the ceiling"
    )
