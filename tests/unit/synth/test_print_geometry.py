"""A rendered print against an independent calculation: OpenCV's own bitmap, lens and poses,
sampled densely.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.synth.clip import frame_truth
from tests.unit.synth.little_scenes import from_above, little_scene, picture_of

BROWN = (-0.28, 0.09, 0.001, -0.002, 0.0)


def sampled(
    world, frame: int, dictionary: int, number: int, margin_cells: float, dense: int
) -> np.ndarray:  # type: ignore[no-untyped-def]
    """(h, w) albedo of a sheet of paper 1 / ink 0 on black: point samples on a dense grid,
    nothing taken from the tracer.
    """
    camera, truth = world.camera, frame_truth(world, frame)
    (sighting,) = truth.markers.values()
    bitmap = cv2.aruco.getPredefinedDictionary(dictionary)
    cells = (
        cv2.aruco.generateImageMarker(
            bitmap, number, bitmap.markerSize + 2, borderBits=1
        )
        > 127
    )
    n, size = len(cells), world.scene.marker[0].spec.size_m
    grid = (np.arange(dense) + 0.5) / dense - 0.5
    x = (np.arange(camera.width)[:, None] + grid).ravel()
    y = (np.arange(camera.height)[:, None] + grid).ravel()
    pixels = np.stack(np.meshgrid(x, y), -1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    coefficients = camera.distortion if camera.distortion.size else np.zeros(5)
    rays = cv2.undistortPoints(
        pixels, camera.matrix, coefficients, None, None, None, criteria
    )[:, 0]
    pose = sighting.camera_from_marker
    normal = pose.rotation[:, 2]
    d = np.column_stack([rays, np.ones(len(rays))])
    t = (normal @ pose.translation_m) / (d @ normal)
    on_sheet = (d * t[:, None] - pose.translation_m) @ pose.rotation  # marker axes
    column = np.floor((on_sheet[:, 0] / size + 0.5) * n).astype(int)
    row = np.floor((0.5 - on_sheet[:, 1] / size) * n).astype(int)
    inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
    albedo = (
        np.abs(on_sheet[:, :2]).max(1) <= size * (0.5 + margin_cells / n)
    ).astype(float)
    albedo[inside] = cells[row[inside], column[inside]]
    shape = (camera.height, dense, camera.width, dense)
    return albedo.reshape(shape).mean((1, 3))


@pytest.mark.parametrize(
    ("spec", "dictionary", "number"),
    [
        ("36h11:3:120mm", cv2.aruco.DICT_APRILTAG_36h11, 3),
        ("4X4_50:7:120mm", cv2.aruco.DICT_4X4_50, 7),
    ],
)
@pytest.mark.parametrize("distortion", [(), BROWN])
def test_a_print_is_where_its_pose_and_the_lens_put_it(
    spec: str, dictionary: int, number: int, distortion: tuple[float, ...]
) -> None:
    scene = little_scene(
        72, 54, path={"kind": "static", "position_m": [0.03, -0.13, 0.15]}, lens={"fov_deg": 62, "distortion": distortion},
        marker=[{"spec": spec, "ink": 0, "paper": 1, "position_m": [0.01, 0.02, 0], "rotate_deg": [8, -5, 30]}],
    )  # fmt: skip
    world, picture = picture_of(scene, samples=4)
    made = picture.radiance(0)[..., 0]
    exact = sampled(world, 0, dictionary, number, 1.5, dense=24)
    assert 0.2 < exact.mean() < 0.8, "the print fills the picture"
    difference = made - exact
    # an average over a box along the print's axes is not exactly one over the pixel: some
    # per cent at edges, none on average
    assert np.abs(difference).max() < 0.1 and np.sqrt((difference**2).mean()) < 0.008
    slopes = np.column_stack([g.ravel() for g in np.gradient(exact)])
    shift_px = np.linalg.lstsq(slopes, -difference.ravel(), rcond=None)[0]
    assert np.abs(shift_px).max() < 0.004, (
        "a hundredth of what the corner finder is asked for"
    )


def test_truth_corners_are_the_print_s_corners() -> None:
    """The print's black square, cut out along its truth corners, is black inside and paper
    outside.
    """
    scene = little_scene(
        320, 240, path={"kind": "static", "position_m": [0.02, -0.2, 0.3]},
        marker=[{"spec": "36h11:3:120mm", "ink": 0, "paper": 1, "rotate_deg": [0, 0, 20]}],
    )  # fmt: skip
    world, picture = picture_of(scene)
    (sighting,) = frame_truth(world, 0).markers.values()
    rgb = picture.radiance(0)[..., 0].astype(np.float32)
    side = 160
    square = (
        np.float32([[0, 0], [side, 0], [side, side], [0, side]]) + 19.5
    )  # 20 px of margin, pixel centres at integers
    flat = cv2.warpPerspective(
        rgb,
        cv2.getPerspectiveTransform(sighting.corners_px.astype(np.float32), square),
        (side + 40, side + 40),
    )
    assert (
        flat[100, 24:36].max() < 0.1 and flat[100, 6:16].min() > 0.9
    )  # left border; its row crosses the middle
    for profile in (
        flat[100, 10:30],
        flat[100, ::-1][10:30],
        flat[10:30, 100],
        flat[::-1, 100][10:30],
    ):
        assert abs((profile.sum() / profile[:4].mean()) - 10.0) < 0.25, (
            "the edge lies at the corner's line"
        )
    assert sighting.visible == 1.0 and sighting.facing == pytest.approx(
        0.3 / np.linalg.norm([0.02, 0.2, 0.3]), abs=1e-6
    )


def test_visible_counts_what_stands_before_the_print_and_beyond_the_border() -> None:
    cover = {
        "size_m": [0.2, 0.2, 0.01],
        "position_m": [0.1, 0, 0.05],
    }  # covers x > 0 as seen from straight above
    free = little_scene(path=from_above(), marker=[{"spec": "36h11:3:100mm"}])
    half = little_scene(
        path=from_above(), marker=[{"spec": "36h11:3:100mm"}], box=[cover]
    )
    gone = little_scene(
        path=from_above(), marker=[{"spec": "36h11:3:100mm", "position_m": [3, 0, 0]}]
    )
    back = little_scene(
        path=from_above(),
        marker=[{"spec": "36h11:3:100mm", "rotate_deg": [180, 0, 0]}],
    )
    seen = []
    for scene in (free, half, gone, back):
        world, _ = picture_of(scene)
        seen.append(next(iter(frame_truth(world, 0).markers.values())).visible)
    assert (
        seen[0] == 1
        and seen[1] == pytest.approx(0.5, abs=0.05)
        and seen[2] == seen[3] == 0
    )
