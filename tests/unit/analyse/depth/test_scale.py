"""The scale of depth maps from the markers' planes, and when it is refused."""

from __future__ import annotations

import numpy as np
import pytest

from arfx.analyse.depth.scale import depth_scale, print_ratios
from arfx.core.facts import FrameFacts, MarkerSighting
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from tests.scenes import camera, facts, look_at, scene


def seen(distance_m: float, s: Scene) -> tuple[FrameFacts, np.ndarray]:
    """A frame that shows the marker, and the true depth of its plane (h, w), metres."""
    pose = look_at(distance_m)
    corners = s.camera.project(pose.apply(s.markers[0].corners_m))
    f = facts(s, pose).with_(
        markers=(MarkerSighting(s.markers[0].key, corners, 0.1),)
    )
    grid = np.stack(
        np.meshgrid(np.arange(s.camera.width), np.arange(s.camera.height)), -1
    ).astype(float)
    normal = pose.rotation[:, 2]
    z = (normal @ pose.translation_m) / (s.camera.directions(grid) @ normal)
    return f, np.where(z > 0, z, 0).astype(np.float32)


def ratios(
    factors: list[float], noise: float = 0.02, holes: float = 0.3, half: bool = False
) -> list[np.ndarray]:
    """Of frames at several distances whose maps hold distance / factor, noisy and with holes."""
    s, g, out = (
        scene(camera(160, 120, (0.05, -0.02, 0.001, 0.0005))),
        np.random.default_rng(3),
        [],
    )
    for k, factor in enumerate(factors):
        f, z = seen(0.35 + 0.05 * k, s)
        z = (
            z
            / np.float32(factor)
            * (1 + noise * g.normal(size=z.shape)).astype(np.float32)
        )
        z[g.random(z.shape) < holes] = 0
        out.append(
            print_ratios(z[::2, ::2] if half else z, f, s.world_from_marker, s.camera)
        )
    return out


@pytest.mark.parametrize("half", [False, True])
def test_one_factor_is_found(half: bool) -> None:
    found = depth_scale(ratios([0.2] * 6, half=half))
    assert found.known and found.scale == pytest.approx(0.2, rel=0.005)
    assert (
        found.residual == pytest.approx(0.02 * 0.6745, rel=0.3) and found.frames == 6
    )


def test_frames_with_a_hand_over_the_marker_do_not_move_it() -> None:
    sparse = ratios([1.0] * 7)
    sparse[2] = sparse[2] * 1.7
    found = depth_scale(sparse)
    assert found.known and found.scale == pytest.approx(1.0, rel=0.01)


def test_refused_where_it_cannot_be_told() -> None:
    assert (
        "0 frames have depth on a marker's print"
        in depth_scale(ratios([1.0] * 4, holes=1.0)).reason
    )
    other = depth_scale(
        ratios([1.0, 1.6, 0.7, 2.2, 1.2])
    )  # another unit in every frame
    assert (
        not other.known and "not proportional" in other.reason and other.scale == 1.0
    )
    s = scene()
    f, z = seen(0.4, s)
    hidden = f.with_(status="interpolated")
    assert len(print_ratios(z, hidden, s.world_from_marker, s.camera)) == 0
    assert len(print_ratios(z, f, {"36h11:9": Pose.identity()}, s.camera)) == 0
