"""Prints that are known by their picture: found, followed, their corners beside the exact
ones, and absent where they are.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.markers.detect import Detection
from arfx.analyse.markers.pattern import (
    PatternPicture,
    check_turned,
    coded_luma,
    plausible,
)
from arfx.analyse.markers.search import pattern_checks
from arfx.analyse.markers.tracker import PicturedPrints
from arfx.core.camera import Camera
from arfx.core.marker import PatternSpec
from arfx.core.pose import Pose, rotation_angle_rad
from arfx.errors import ConfigError, InputError, NothingToDoError
from tests.observed import Observed
from tests.unit.analyse.synthetic import (
    background,
    camera,
    hung,
    picture,
    poster,
    tilted,
)

CAM = camera(320, 240, 330.0)
PRINT, PRINTED = PatternSpec(Path("poster.png"), 0.22, 0.15), poster()
INK, PAPER = 0.05, 0.88
GREY = (INK + (PAPER - INK) * PRINTED).mean(-1)
BACK = background(320, 240)


@pytest.fixture(scope="module")
def known() -> PatternPicture:
    return PatternPicture(PRINT.key, coded_luma(PRINTED, INK, PAPER))


def place(k: int, tilt: float = 0.5, away_m: float = 0.45) -> Pose:
    return tilted([tilt, 0.02 * k, 0.03 * k], [0.01 * k - 0.03, 0.01, away_m])


def frame(
    pose: Pose | None,
    cam: Camera = CAM,
    blur_px: float = 0.6,
    noise: float = 1.5,
    seed: int = 0,
) -> np.ndarray:
    view = BACK if pose is None else hung(cam, GREY, PRINT.corners_m, pose, BACK)
    return picture(cam, [], 0.8 * view, noise, blur_px, seed)


def tracked(
    known: PatternPicture, frames: list[np.ndarray], cam: Camera = CAM
) -> list[Detection | None]:
    tracker = PicturedPrints([known], cam)
    return [
        next(iter(tracker.search(AnalysisFrame(k, k / 25, luma))[0]), None)
        for k, luma in enumerate(frames)
    ]


def errors_px(
    seen: list[Detection | None], poses: list[Pose], cam: Camera = CAM
) -> np.ndarray:
    """(n, 4, 2); fails where one is missing."""
    assert all(seen), [s is not None for s in seen]
    return np.array(
        [
            s.corners_px - cam.project(p.apply(PRINT.corners_m))
            for s, p in zip(seen, poses, strict=True)
            if s
        ]
    )


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.002)])
def test_corners_follow_a_known_path(
    known: PatternPicture, distortion: tuple[float, ...]
) -> None:
    cam = camera(320, 240, 330.0, distortion)
    poses = [place(k) for k in range(4)]
    seen = tracked(known, [frame(p, cam, seed=k) for k, p in enumerate(poses)], cam)
    error = errors_px(seen, poses, cam)
    assert np.sqrt((error**2).mean()) < 0.1 and np.abs(error).max() < 0.3
    sigma = np.median([s.sigma_px for s in seen if s])
    assert 0.3 * sigma < np.sqrt((error**2).mean()) < 3 * sigma


@pytest.mark.parametrize(
    ("case", "tilt", "away_m", "blur_px", "limit_px"),
    [
        ("60 degrees", 1.05, 0.45, 0.6, 0.2),
        ("60 px", 0.4, 1.1, 0.6, 0.3),
        ("blurred", 0.5, 0.45, 2.5, 0.8),
    ],
)
def test_hard_views_are_found_from_nothing(
    known: PatternPicture,
    case: str,
    tilt: float,
    away_m: float,
    blur_px: float,
    limit_px: float,
) -> None:
    seen = tracked(known, [frame(place(2, tilt, away_m), blur_px=blur_px)])
    assert np.sqrt((errors_px(seen, [place(2, tilt, away_m)]) ** 2).mean()) < limit_px


def test_what_blurs_or_hides_the_print_widens_its_sigma_until_it_is_gone(
    known: PatternPicture,
) -> None:
    pose = place(0)
    sharp, soft = frame(pose), frame(pose, blur_px=3.0)
    half = sharp.copy()
    quad = CAM.project(pose.apply(PRINT.corners_m))
    left = np.array(
        [
            quad[0],
            0.6 * quad[0] + 0.4 * quad[1],
            0.6 * quad[3] + 0.4 * quad[2],
            quad[3],
        ]
    )
    cv2.fillConvexPoly(half, left.round().astype(np.int32), (90,))
    seen = tracked(known, [sharp, half, soft])
    error = np.sqrt((errors_px(seen, [pose] * 3) ** 2).mean((1, 2)))
    assert error[1] < 1.0 and error[2] < 1.0
    sigma = [s.sigma_px for s in seen if s]
    assert sigma[1] > 1.2 * sigma[0] and sigma[2] > 3 * sigma[0]
    cv2.fillConvexPoly(half, quad.round().astype(np.int32), (90,))
    assert tracked(known, [sharp, half, frame(None)])[1:] == [None, None]


def test_the_print_comes_back_after_a_loss(known: PatternPicture) -> None:
    frames = (
        [frame(place(k)) for k in range(2)]
        + [frame(None)] * 2
        + [frame(tilted([0.3, -0.3, 1.2], [0.04, -0.02, 0.5]))] * 2
    )
    assert [s is not None for s in tracked(known, frames)] == [
        True,
        True,
        False,
        False,
        True,
        True,
    ]


def test_other_pictures_are_not_taken_for_it(known: PatternPicture) -> None:
    other = hung(CAM, poster(seed=9).mean(-1), PRINT.corners_m, place(1), BACK)
    mirrored = hung(CAM, GREY[:, ::-1].copy(), PRINT.corners_m, place(1), BACK)
    assert tracked(
        known, [picture(CAM, [], 0.8 * view) for view in (other, mirrored)]
    ) == [
        None,
        None,
    ]


def test_a_quad_of_the_back_or_without_extent_is_no_print() -> None:
    quad = np.array([[10.0, 10], [110, 12], [108, 90], [9, 88]])
    assert (
        plausible(quad)
        and not plausible(quad[::-1])
        and not plausible(quad * [1, 0.01])
    )
    assert not plausible(quad[[0, 2, 1, 3]]) and not plausible(
        np.full((4, 2), np.nan)
    )


def test_plain_and_small_pictures_are_refused() -> None:
    with pytest.raises(
        InputError, match=r"pattern a\.png is too plain: \d+ features"
    ):
        PatternPicture("a.png", np.full((200, 300), 200, np.uint8))
    with pytest.raises(InputError, match=r"pattern a\.png is 40x300"):
        PatternPicture("a.png", np.zeros((300, 40), np.uint8))


def test_a_rectangle_has_a_pose_as_a_marker_has() -> None:
    """The whole analysis, from a print of 220 x 150 mm."""
    analyser = Observed(AnalysisJob((PRINT,), CAM, prints={PRINT.key: PRINTED}))
    poses = [place(k) for k in range(8)]
    for k, pose in enumerate(poses):
        analyser.step(AnalysisFrame(k, k / 25, frame(pose, seed=k)))
    clip = analyser.finish()
    assert clip.anchor == PRINT and clip.summary["markers_seen"] == {"poster.png": 8}
    for fact, pose in zip(clip.facts, poses, strict=True):
        assert np.degrees(rotation_angle_rad(fact.pose, pose)) < 0.3
        assert np.linalg.norm(fact.pose.translation_m - pose.translation_m) < 1e-3


@pytest.mark.parametrize(("bend", "flat"), [(0.0, True), (0.02, False)])
def test_a_print_that_is_not_flat_is_told_by_its_misfit(
    bend: float, flat: bool
) -> None:
    """Bent like a wave, by a share of its height: 2 px in the frame."""
    h, w = GREY.shape
    x, y = np.meshgrid(np.arange(w), np.arange(h))
    y = y + bend * h * np.cos(2 * np.pi * x / w)
    bent = cv2.remap(
        GREY.astype(np.float32), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    analyser = Observed(AnalysisJob((PRINT,), CAM, prints={PRINT.key: PRINTED}))
    for k in range(4):
        view = hung(CAM, bent, PRINT.corners_m, place(k), BACK)
        analyser.step(
            AnalysisFrame(k, k / 25, picture(CAM, [], 0.8 * view, 1.5, 0.6, k))
        )
    clip = analyser.finish()
    (check,) = pattern_checks(clip.summary)
    assert (
        check.ok == flat
        and check.name.startswith(PRINT.key)
        and "flat" in check.action
    )


def test_a_print_that_is_never_seen_is_said() -> None:
    analyser = Observed(AnalysisJob((PRINT,), CAM, prints={PRINT.key: PRINTED}))
    analyser.step(AnalysisFrame(0, 0.0, frame(None)))
    with pytest.raises(
        NothingToDoError, match=r"no configured marker \(poster.png\) in 1 frames"
    ):
        analyser.finish()


def test_a_print_that_looks_the_same_turned_is_refused_and_no_other() -> None:
    grey = coded_luma(poster(300, 200), INK, PAPER)
    card = np.where(
        np.arange(len(grey))[:, None] < len(grey) / 2, grey, grey[::-1, ::-1]
    ).astype(np.uint8)
    scanned = np.pad(card, ((3, 9), (8, 2)), constant_values=240)
    marked = card.copy()
    marked[20:45, 20:45] = 255
    square = grey[:, :200]
    four = np.mean([np.rot90(square, k) for k in range(4)], 0).astype(np.uint8)
    logo = np.pad(four, ((0, 0), (60, 60)), constant_values=240)
    for same in (card, scanned, marked, four, logo):
        with pytest.raises(
            ConfigError, match="looks the same when it is turned by 180 degrees"
        ):
            check_turned("card", same)
    half = np.where(np.arange(300) < 150, grey, card).astype(np.uint8)
    for told in (
        grey,
        half,
        np.concatenate([square, square[:, ::-1]], 1),
    ):  # the last one is its own mirror image
        check_turned("poster", told)
