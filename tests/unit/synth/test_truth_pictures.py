"""Depth, masks and flow against plane geometry, and the truth file's round trip."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.errors import InputError, RenderError
from arfx.synth.clip import frame_truth
from arfx.synth.truth import (
    DEPTH_UNIT_M,
    FLOW_UNIT_PX,
    Truth,
    read_truth,
    write_depth,
    write_flow,
    write_truth,
)
from tests.unit.synth.little_scenes import from_above, little_scene, picture_of

GREY = {"kind": "plain", "colour": [0.5, 0.5, 0.5]}
ORBIT = {
    "kind": "orbit",
    "radius_m": 0.4,
    "azimuth_deg": [-110, -90],
    "elevation_deg": [50, 55],
    "hand_deg": 0.5,
    "hand_m": 0.002,
}
TURNED = {
    "kind": "keys",
    "keys": [{"time_s": 0.0}, {"time_s": 0.2, "rotate_deg": [8, 12, 40]}],
}


def test_depth_and_mask_of_a_plane_and_a_sphere() -> None:
    scene = little_scene(
        path=from_above(2.0),
        plane=[{"size_m": [9, 9], "texture": GREY}],
        sphere=[{"radius_m": 0.3, "position_m": [0, 0, 0.5]}],
    )
    depth, owner = picture_of(scene)[1].surfaces(0)
    assert set(np.unique(owner)) == {1, 2} and owner[24, 32] == 2
    assert np.allclose(depth[owner == 1], 2.0), (
        "depth is along the axis, the same all over a plane that faces the camera"
    )
    assert depth[owner == 2].min() == pytest.approx(2 - 0.8, abs=2e-3)
    f = 32 / np.tan(np.radians(30))
    silhouette = (
        np.pi * (f * 0.3) ** 2 / (1.5**2 - 0.3**2)
    )  # a sphere on the axis: its outline is a circle of tan² = r²/(d²-r²)
    assert (owner == 2).sum() == pytest.approx(silhouette, rel=0.05)


def test_flow_is_the_homography_between_two_views_of_a_plane() -> None:
    """Taken from the marker's four true corners in both frames, for a still desk and for a
    print that turns on it.
    """
    scene = little_scene(
        96, 72, frames=3, path=ORBIT, plane=[{"size_m": [3, 3], "position_m": [0, 0, "-0.2mm"], "texture": GREY}],
        marker=[{"spec": "36h11:3:60mm", "motion": TURNED}, {"spec": "36h11:9:60mm", "position_m": [0.1, 0.05, "-0.2mm"]}],
    )  # fmt: skip
    world, picture = picture_of(scene)
    depth, owner = picture.surfaces(1)
    flow = picture.flow(1, depth, owner)
    now, then = (frame_truth(world, n).markers for n in (1, 2))
    for number, key in (
        (2, "36h11:3"),
        (1, "36h11:9"),
    ):  # the second marker lies in the desk's plane
        h = cv2.getPerspectiveTransform(
            np.float32(now[key].corners_px), np.float32(then[key].corners_px)
        )
        y, x = np.nonzero(owner == number)
        assert len(x) > 100
        moved = cv2.perspectiveTransform(
            np.stack([x, y], -1)[:, None].astype(float), h
        )[:, 0]
        error = flow[y, x] - (moved - np.stack([x, y], -1))
        near = np.hypot(*(np.stack([x, y], -1) - now[key].corners_px.mean(0)).T) < 40
        assert np.abs(error[near]).max() < 0.02
        assert np.abs(flow[y, x]).max() > 1


def test_flow_is_unknown_across_a_cut_and_after_the_last_frame() -> None:
    scene = little_scene(frames=2, path=from_above(), plane=[{"texture": GREY}])
    scene = scene.model_copy(update={"shot": (scene.shot[0], scene.shot[0])})
    _, picture = picture_of(scene)
    known = [
        np.isfinite(picture.flow(n, *picture.surfaces(n))).all(-1).mean()
        for n in range(4)
    ]
    assert known == [1, 0, 1, 0]


def test_depth_and_flow_files_keep_their_steps(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    depth = rng.uniform(0.1, 12, (20, 30))
    depth[0, 0], depth[0, 1] = 0, 50
    write_depth(tmp_path / "d.png", depth)
    back = cv2.imread(str(tmp_path / "d.png"), cv2.IMREAD_UNCHANGED) * DEPTH_UNIT_M
    assert back[0, 0] == back[0, 1] == 0
    assert np.abs((back - depth).ravel()[2:]).max() <= 1.0001e-4
    flow = rng.uniform(-500, 500, (20, 30, 2))
    flow[3, 4], flow[5, 6] = np.nan, 600
    write_flow(tmp_path / "f.png", flow)
    raw = cv2.imread(str(tmp_path / "f.png"), cv2.IMREAD_UNCHANGED).astype(float)
    again = np.where(
        raw[..., :1] == 0, np.nan, (raw[..., [2, 1]] - 2**15) * FLOW_UNIT_PX
    )
    lost = np.isnan(again).any(-1)
    assert np.argwhere(lost).tolist() == [[3, 4], [5, 6]]
    assert np.abs((again - flow)[~lost]).max() <= 1 / 128 + 1e-9


def test_a_picture_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match=r"d\.png"):
        write_depth(tmp_path / "missing" / "d.png", np.ones((2, 3)))
    with pytest.raises(RenderError, match=r"f\.png"):
        write_flow(tmp_path / "missing" / "f.png", np.ones((2, 3, 2)))


def test_truth_files_come_back_as_they_were(tmp_path: Path) -> None:
    scene = little_scene(
        frames=2,
        path=ORBIT,
        marker=[{"spec": "36h11:3:60mm"}],
        light={"lamps": [{"azimuth_deg": 10}]},
    )
    world, _ = picture_of(scene)
    frames = tuple(frame_truth(world, n) for n in range(2))
    header = {"arfx_truth": 1, "world": "36h11:3"}
    write_truth(tmp_path / "truth.jsonl", Truth(header, frames))
    back = read_truth(tmp_path / "truth.jsonl")
    assert back.world == "36h11:3" and len(back.frames) == 2
    for a, b in zip(frames, back.frames, strict=True):
        assert np.allclose(
            a.camera_from_room.matrix, b.camera_from_room.matrix, atol=1e-12
        )
        assert np.allclose(
            a.markers["36h11:3"].corners_px, b.markers["36h11:3"].corners_px
        )
        assert (a.time_s, a.shot, a.gain, a.lights) == (
            b.time_s,
            b.shot,
            b.gain,
            b.lights,
        )
    lamp = back.frames[0].lights[0]
    pose = back.frames[0].markers["36h11:3"].camera_from_marker
    assert np.allclose(pose.rotation @ lamp["marker"]["36h11:3"], lamp["camera"]), (
        "one lamp in two frames of reference"
    )


def test_another_file_is_no_truth(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_truth(tmp_path / "none.jsonl")
    (tmp_path / "x.jsonl").write_text('{"format": "arfx-facts"}\n')
    with pytest.raises(InputError, match="not a truth file"):
        read_truth(tmp_path / "x.jsonl")
