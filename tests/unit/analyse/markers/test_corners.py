"""Sub-pixel corners against exact renderings."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.markers.corners import CODE, LIGHT, linear_table, refine_corners
from arfx.analyse.markers.detect import Candidate, MarkerDetector
from arfx.analyse.markers.search import (
    ANY,
    SIGHTINGS,
    MarkerSearch,
    Sighting,
    choose_transfer,
)
from arfx.core.camera import Camera
from arfx.core.colour import Transfer
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import cells_per_side
from arfx.core.pose import Pose
from tests.unit.analyse.synthetic import background, camera, picture, tilted

CAM = camera(320, 240, 400.0)
BACK = background(320, 240)
TABLE = linear_table()


def poses(side_px: float, size_m: float, count: int) -> list[Pose]:
    rng = np.random.default_rng(7)
    z = CAM.fx * size_m / side_px
    return [
        tilted(
            rng.normal(0, 0.25, 3),
            [rng.uniform(-0.15, 0.15) * z, rng.uniform(-0.1, 0.1) * z, z],
        )
        for _ in range(count)
    ]


def errors(
    family: str, side_px: float, blur_px: float, **how: object
) -> tuple[np.ndarray, np.ndarray, list[bool]]:
    """Errors (n, 4, 2) of refined corners, of cv2.cornerSubPix on the same starts, and the
    polarity found.
    """
    m = MarkerSpec(family, 1, 0.1)
    detector = MarkerDetector([family])
    ours, theirs, inverted = [], [], []
    for k, pose in enumerate(poses(side_px, m.size_m, 12)):
        image = picture(
            CAM, [(m, pose)], BACK, noise=2.0, blur_px=blur_px, seed=k, **how
        )  # type: ignore[arg-type]
        found = [c for c in detector.search(image) if c.key == m.key]
        if not found:
            continue
        truth = CAM.project(pose.apply(m.corners_m))
        r = refine_corners(
            image, found[0].quad_px[None], np.array([cells_per_side(family)]), TABLE
        )
        assert r.refined[0]
        ours.append(r.corners_px[0] - truth)
        start = found[0].quad_px.astype(np.float32).reshape(-1, 1, 2)
        theirs.append(
            cv2.cornerSubPix(image, start, (3, 3), (-1, -1), (3, 50, 1e-3)).reshape(
                4, 2
            )
            - truth
        )
        inverted.append(bool(r.inverted[0]))
    assert len(ours) >= 8
    return np.array(ours), np.array(theirs), inverted


@pytest.mark.parametrize(
    "family, side_px, blur_px, limit",
    [("4X4_50", 18, 0.6, 0.12), ("36h11", 40, 0.7, 0.06), ("36h11", 90, 1.2, 0.05)],
)
def test_corners_are_true_and_better_than_opencvs(
    family: str, side_px: float, blur_px: float, limit: float
) -> None:
    ours, theirs, _ = errors(family, side_px, blur_px)
    rms = np.sqrt((ours**2).mean())
    assert rms < limit
    assert rms < np.sqrt((theirs**2).mean()) / 3


def test_inverted_print_is_told_and_as_exact() -> None:
    ours, _, inverted = errors("36h11", 60, 0.8, inverted=True)
    assert all(inverted) and np.sqrt((ours**2).mean()) < 0.06
    assert not any(errors("36h11", 60, 0.8)[2])


@pytest.mark.parametrize("grey, slant", [(0.35, 0.5), (0.55, 0.35), (0.8, 0.5)])
def test_what_covers_part_of_a_side_moves_no_corner(
    grey: float, slant: float
) -> None:
    """Normals that meet no edge of the print, but what lies over it, are no samples of
    where it lies.
    """
    m, pose = MarkerSpec("36h11", 1, 0.1), tilted([0.4, 0.2, 0.0], [0.0, 0.0, 0.4])
    truth = CAM.project(pose.apply(m.corners_m))
    clear = picture(CAM, [(m, pose)], BACK, noise=0.0, blur_px=0.0)
    left, top, bottom = truth[:, 0].min(), truth[:, 1].min(), truth[:, 1].max()
    worst = 0.0
    for edge in left + slant * (bottom - top) * np.array(
        [0.15, 0.25, 0.35, 0.45]
    ):  # at the top; so much of the side is covered
        hand = np.array(
            [
                [0, top - 30],
                [edge, top],
                [edge - slant * (bottom - top), bottom],
                [0, bottom],
            ]
        )
        code = cv2.fillPoly(
            clear.copy(),
            [np.rint(hand * 16).astype(np.int32)],
            255 * grey,
            cv2.LINE_AA,
            4,
        )
        luma = (
            Transfer("srgb").encode(cv2.GaussianBlur(TABLE[code] / 255, (0, 0), 0.8))
            * 255
        )
        r = refine_corners(
            np.rint(luma).astype(np.uint8), truth[None] + 0.3, np.array([8]), TABLE
        )
        worst = max(worst, float(np.abs(r.corners_px[0] - truth).max()))
    assert r.refined[0] and worst < 0.25


@pytest.mark.parametrize("share", [0.8, 1.0])
def test_a_side_that_is_no_edge_of_the_print_is_no_side(share: float) -> None:
    """What lies over the paper beside it is darker than the ink: nearly no normal of it
    meets the print's edge.
    """
    luma = np.full((200, 200), 200, np.uint8)
    luma[60:140, 60:140] = 40
    luma[:60, : round(60 + 80 * share)] = 5
    quad = np.array([[59.5, 59.5], [139.5, 59.5], [139.5, 139.5], [59.5, 139.5]])
    assert not refine_corners(luma, quad[None] + 1.5, np.array([8]), TABLE).refined[0]


def test_sides_bent_by_the_lens_do_not_move_the_corners() -> None:
    bent = Camera(
        320,
        240,
        np.array([[220.0, 0, 160], [0, 220, 120], [0, 0, 1]]),
        np.array([-0.35, 0.12, 0, 0]),
    )
    wide = Camera(520, 440, np.array([[220.0, 0, 260], [0, 220, 220], [0, 0, 1]]))
    m, pose = MarkerSpec("36h11", 1, 0.1), tilted([0.2, -0.2, 0.1], [0.09, 0.05, 0.2])
    ideal = picture(
        wide, [(m, pose)], background(520, 440), noise=0, blur_px=0
    ).astype(np.float32)
    y, x = np.mgrid[:240, :320]
    at = bent.normalised(np.stack([x, y], -1).astype(float)) * 220 + [260, 220]
    image = cv2.GaussianBlur(
        cv2.remap(ideal, *at.astype(np.float32).transpose(2, 0, 1), cv2.INTER_CUBIC),
        (0, 0),
        0.6,
    )
    image = np.clip(image, 0, 255).round().astype(np.uint8)
    quad = next(
        c for c in MarkerDetector(["36h11"]).search(image) if c.key == m.key
    ).quad_px[None]
    truth = bent.project(pose.apply(m.corners_m))
    cells, table = np.array([8]), linear_table(CODE)
    with_lens = np.abs(
        refine_corners(image, quad, cells, table, bent).corners_px[0] - truth
    ).max()
    without = np.abs(
        refine_corners(image, quad, cells, table).corners_px[0] - truth
    ).max()
    assert with_lens < 0.2 and with_lens < without / 2, (with_lens, without)


def test_result_does_not_depend_on_the_company_or_on_a_small_change_of_start() -> (
    None
):
    m = MarkerSpec("36h11", 1, 0.1)
    a, b = (
        tilted([0.3, 0, 0], [-0.1, 0, 0.6]),
        tilted([0, 0.3, 0.2], [0.1, 0.02, 0.6]),
    )
    n = MarkerSpec("36h11", 2, 0.1)
    image = picture(CAM, [(m, a), (n, b)], BACK)
    quads = {c.key: c.quad_px for c in MarkerDetector(["36h11"]).search(image)}
    both = refine_corners(
        image, np.stack([quads[m.key], quads[n.key]]), np.array([8, 8]), TABLE
    )
    alone = refine_corners(image, quads[m.key][None], np.array([8]), TABLE)
    assert np.array_equal(both.corners_px[0], alone.corners_px[0])
    moved = refine_corners(
        image, quads[m.key][None] + [0.7, -0.5], np.array([8]), TABLE
    )
    assert np.abs(moved.corners_px - alone.corners_px).max() < 0.02


def test_large_marker_of_which_the_detector_reports_the_inside_of_its_rim() -> None:
    cam = camera(640, 480, 800.0)
    m, pose = MarkerSpec("36h11", 1, 0.1), tilted([0.35, 0.1, 0.2], [0.01, 0.0, 0.3])
    image = picture(cam, [(m, pose)], background(640, 480), noise=1.0, blur_px=0.5)
    truth = cam.project(pose.apply(m.corners_m))
    found = next(c for c in MarkerDetector(["36h11"]).search(image) if c.key == m.key)
    # whichever border the detector took: the rim may be as wide as OpenCV's neighbourhood
    for inside_px in (0.0, 6.0, 11.0):
        inner = (
            truth
            + (truth.mean(0) - truth)
            * inside_px
            * np.sqrt(2)
            / np.linalg.norm(truth - truth.mean(0), axis=1)[:, None]
        )
        for start in (found.quad_px, inner):
            r = refine_corners(image, start[None], np.array([8]), TABLE)
            assert (
                r.refined[0]
                and np.abs(r.corners_px[0] - truth).max() < 0.1
                and r.sigma_px[0] < 0.1
            )


def test_a_quad_without_size_comes_back_unrefined() -> None:
    image, quad = background(64, 48), np.zeros((4, 2))
    r = refine_corners(
        (image * 255).astype(np.uint8), quad[None], np.array([8]), TABLE
    )
    assert not r.refined[0] and r.sigma_px[0] == 1.0
    assert np.array_equal(r.corners_px[0], quad)


def test_nothing_to_refine_is_said() -> None:
    quad = np.array([[[100.0, 60], [160, 60], [160, 120], [100, 120]]])
    flat = refine_corners(
        np.full((240, 320), 90, np.uint8), quad, np.array([8]), TABLE
    )
    assert (
        not flat.refined[0]
        and np.array_equal(flat.corners_px, quad)
        and flat.sigma_px[0] == 1.0
    )


def test_marker_at_the_frame_border_stays_finite() -> None:
    m = MarkerSpec("36h11", 1, 0.1)
    pose = tilted([0, 0, 0], [-(153.5 - 36) / 400 * 0.62, 0, 0.62])
    image = picture(CAM, [(m, pose)], BACK)
    truth = CAM.project(pose.apply(m.corners_m))
    assert truth[:, 0].min() < 8  # the white margin is cut off by the frame
    found = [c for c in MarkerDetector(["36h11"]).search(image) if c.key == m.key]
    assert found
    r = refine_corners(image, found[0].quad_px[None], np.array([8]), TABLE)
    assert np.abs(r.corners_px[0] - truth).max() < 0.3


@pytest.mark.parametrize("linear, expected", [(True, LIGHT), (False, CODE)])
def test_edge_domain_is_found_from_the_edges(linear: bool, expected: str) -> None:
    m = MarkerSpec("36h11", 1, 0.1)
    detector, search = MarkerDetector(["36h11"]), MarkerSearch(AnalysisJob((m,), CAM))
    seen: list[Sighting] = []
    for k, pose in enumerate(poses(34, m.size_m, SIGHTINGS + 4)):
        image = picture(
            CAM, [(m, pose)], BACK, noise=1.0, blur_px=0.8, seed=k, linear=linear
        )
        found = [c for c in detector.search(image) if c.key == m.key]
        for transfer in (LIGHT, CODE):
            seen += search.refined(transfer, AnalysisFrame(k, k, image), found)
    assert choose_transfer(seen) == expected
    few = seen[: 2 * SIGHTINGS - 2]
    assert choose_transfer(few) == LIGHT, "too few to tell by"


def test_edges_too_poor_to_tell_are_taken_for_light() -> None:
    poor = Candidate(
        "36h11", 1, np.array([[100.0, 60], [160, 60], [160, 120], [100, 120]])
    )
    flat = np.full((240, 320), 90, np.uint8)
    search = MarkerSearch(AnalysisJob((MarkerSpec("36h11", 1, 0.1),), CAM))
    (seen,) = search.coded_sightings(AnalysisFrame(0, 0.0, flat), [poor])
    assert np.isnan(seen.skew) and seen.transfer == ANY
    assert choose_transfer([seen] * (2 * SIGHTINGS)) == LIGHT
