"""From pictures or views to camera, verdict and advice."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from arfx.calibrate.advice import (
    GOOD,
    LIMITS,
    POOR,
    USABLE,
    coverage,
    judge,
    projection_uncertainty_px,
)
from arfx.calibrate.board import BoardSpec
from arfx.calibrate.calibration import (
    Calibration,
    Found,
    Picture,
    calibrate,
    document,
    file_extras,
    find_board,
)
from arfx.calibrate.corners import View
from arfx.calibrate.plot import write_plot
from arfx.calibrate.solve import FIRST_MODEL, fit, uncertainty
from arfx.errors import InputError, NothingToDoError
from tests.unit.calibrate.boards import (
    CHESS,
    SIZE,
    TRUE,
    board_picture,
    poses,
    render,
    view,
    views,
)
from tests.unit.calibrate.test_solve import textbook_deviations

CHARUCO = BoardSpec.parse("charuco:10x7:25mm:18mm:5X5_100")


def found(some: list[View]) -> Found:
    return Found(CHESS, tuple(some), len(some), (), (), ())


def spread_views() -> list[View]:
    """24 views that reach the picture's corners."""
    rng = np.random.default_rng(1)
    out = views(16)
    for i, (x, y) in enumerate(
        [(-1, -1), (1, -1), (-1, 1), (1, 1), (-1, 0), (1, 0), (0, -1), (0, 1)]
    ):
        rvec = 0.5 * np.array([np.cos(i), np.sin(i), 0])
        r = cv2.Rodrigues(rvec)[0]
        middle = np.array([x * 0.27, y * 0.2, 1]) * 0.45
        out.append(
            view((rvec, middle - r @ CHESS.corners_m.mean(0)), rng, 0.1, f"edge{i}")
        )
    return [
        v
        for v in out
        if (v.pixels > 0).all() and (v.pixels < np.array(SIZE) - 1).all()
    ]


@pytest.fixture(scope="module")
def good() -> Calibration:
    return calibrate(found(spread_views()))


def test_a_good_set(good: Calibration) -> None:
    assert good.verdict.word == GOOD, good.verdict.reasons
    assert not good.verdict.reasons
    values, sd = good.fitted.values, good.known.standard_deviations
    assert (
        np.abs(values[:4] - [TRUE.fx, TRUE.fy, TRUE.cx, TRUE.cy]) < 3.5 * sd[:4]
    ).all()
    assert sd[0] < 0.003 * TRUE.fx


def test_frontal_views_are_poor_and_the_advice_is_to_tilt() -> None:
    result = calibrate(found(views(8, tilt_deg=(1, 6))))
    assert result.verdict.word == POOR
    assert any("frontally" in r for r in result.verdict.reasons)
    assert "tilted by about 35°" in result.verdict.next_picture


def test_the_next_picture_goes_where_nothing_was() -> None:
    """Views in the left half only: the advice must name the right."""
    rng = np.random.default_rng(0)
    left = []
    for i, (rvec, _) in enumerate(poses(8)):
        middle = np.array([-0.16, 0.05 * (i % 3 - 1), 1]) * 0.55
        left.append(
            view(
                (rvec, middle - cv2.Rodrigues(rvec)[0] @ CHESS.corners_m.mean(0)),
                rng,
                0.1,
                f"l{i}",
            )
        )
    result = calibrate(found(left))
    assert result.verdict.word != GOOD
    assert "right of the picture" in result.verdict.next_picture, (
        result.verdict.next_picture
    )


def test_the_recommended_kind_of_picture_helps_more_than_another_of_the_same(
    good: Calibration,
) -> None:
    some = views(8)
    frontal = view(
        (np.zeros(3), np.array([0, 0, 0.5]) - CHESS.corners_m.mean(0)),
        np.random.default_rng(0),
        0.1,
        "frontal",
    )
    tilted = views(9)[8]
    assert (
        textbook_deviations(fit([*some, tilted], FIRST_MODEL))[0]
        < textbook_deviations(fit([*some, frontal], FIRST_MODEL))[0]
    )


def test_projection_uncertainty_is_the_spread_of_projections() -> None:
    """At the picture's border, with a turn of the camera allowed for, over repetitions."""
    grids, stated = [], []
    truth = fit(views(12, noise_px=0.0), FIRST_MODEL)
    from arfx.calibrate.advice import projection_jacobian

    j = projection_jacobian(truth)
    for seed in range(40):
        fitted = fit(views(12, seed=seed), FIRST_MODEL)
        grids.append(j @ (fitted.values - truth.values))
        stated.append(projection_uncertainty_px(fitted, uncertainty(fitted)))
    spread = np.sqrt((np.var(grids, axis=0).reshape(-1, 2)).mean(1))
    ratio = np.mean(stated, axis=0) / spread
    assert 0.75 < np.median(ratio) < 1.7


@pytest.mark.parametrize(
    ("tilt", "edge", "azimuth"),
    [
        ((0, 1), "right", 0),
        ((0, -1), "left", 180),
        ((1, 0), "upper", 270),
        ((-1, 0), "lower", 90),
    ],
)
def test_tilt_is_told_by_the_near_edge(
    tilt: tuple[int, int], edge: str, azimuth: int
) -> None:
    rvec = np.radians(30) * np.array([*tilt, 0.0])
    middle = np.array([0, 0, 0.45]) - cv2.Rodrigues(rvec)[0] @ CHESS.corners_m.mean(0)
    pose = (rvec, middle)
    corners = CHESS.corners_m @ cv2.Rodrigues(rvec)[0].T + middle
    nearest = corners[corners[:, 2].argmin()]
    assert {
        "right": nearest[0] > 0,
        "left": nearest[0] < 0,
        "upper": nearest[1] < 0,
        "lower": nearest[1] > 0,
    }[edge]
    fitted = fit([view(pose, np.random.default_rng(0), 0.05), *views(6)], FIRST_MODEL)
    seen = coverage(fitted)
    assert seen.tilt_deg[0] == pytest.approx(30, abs=1)
    assert (seen.azimuth_deg[0] - azimuth + 180) % 360 - 180 == pytest.approx(
        0, abs=3
    )


def test_judging() -> None:
    fine = {
        name: limit["good"] * 2
        if limit["good"] > limit["poor"]
        else limit["good"] / 2
        for name, limit in LIMITS.items()
    }
    assert judge(fine) == (GOOD, ())
    for name, limit in LIMITS.items():
        good, poor = limit["good"], limit["poor"]
        between = fine | {name: (good + poor) / 2}
        beyond = fine | {name: poor / 2 if good > poor else poor * 2}
        assert judge(between)[0] == USABLE, name
        assert judge(beyond)[0] == POOR, name
        assert judge(fine | {name: float("nan")})[0] == POOR
        assert len(judge(beyond)[1]) == 1


def test_copies_are_named() -> None:
    some = views(6)
    result = calibrate(found([*some, replace(some[0], name="again", sharpness=0.1)]))
    assert any("copies" in n and "again" in n for n in result.notices)


def test_too_few_different_views() -> None:
    v = views(1)[0]
    with pytest.raises(
        NothingToDoError, match="4 of 4 pictures, 1 of them different"
    ):
        calibrate(found([v] * 4))


def test_the_document_is_json_and_the_plot_is_a_picture(
    good: Calibration, tmp_path: Path
) -> None:
    d = json.loads(json.dumps(document(good), allow_nan=False))
    assert np.shape(d["camera_matrix"]) == (3, 3)
    assert d["verdict"] == "good"
    assert len(d["views"]) == len(good.fitted.views)
    assert set(file_extras(good)["standard_deviations"]) == set(
        good.fitted.model.parameters
    )
    write_plot(good, tmp_path / "residuals.png")
    picture = cv2.imread(str(tmp_path / "residuals.png"))
    assert picture is not None
    assert picture.shape[1] >= 900
    assert picture.std() > 10


def flat(spec: BoardSpec, px_per_square: int = 30) -> np.ndarray:
    return cv2.GaussianBlur(board_picture(spec, px_per_square), (0, 0), 0.8)


def test_no_board_says_what_is_there_instead() -> None:
    small = BoardSpec.parse(
        "charuco:6x4:25mm:18mm:5X5_100"
    )  # every marker is looked up in dictionaries of a thousand
    with pytest.raises(
        NothingToDoError,
        match=r"none of 1 pictures.*chessboard with 5x4 inner corners",
    ):
        find_board(
            [Picture("a", flat(BoardSpec.parse("chessboard:5x4:20mm")))], CHESS
        )
    with pytest.raises(NothingToDoError, match=r"a\.png: 10 markers of 5X5_1000"):
        find_board(
            [
                Picture(
                    "a.png", flat(BoardSpec.parse("charuco:5x4:25mm:18mm:5X5_100"))
                )
            ],
            CHESS,
        )
    with pytest.raises(NothingToDoError, match="no other board or marker"):
        find_board([Picture("a", np.full((200, 300), 128, np.uint8))], CHARUCO)
    with pytest.raises(NothingToDoError, match="fits charuco:6x4:25mm:18mm:5X5_50"):
        find_board(
            [Picture("a", flat(small))],
            BoardSpec.parse("charuco:6x4:25mm:18mm:4X4_100"),
        )
    with pytest.raises(NothingToDoError, match="fits charuco:6x4"):
        find_board(
            [Picture("a", flat(small))],
            BoardSpec.parse("charuco:4x6:25mm:18mm:5X5_100"),
        )
    with pytest.raises(NothingToDoError, match="no pictures"):
        find_board([], CHESS)


def test_the_other_charuco_pattern_is_tried_and_told() -> None:
    old = BoardSpec.parse("charuco:9x6:25mm:18mm:5X5_100:legacy")
    got = find_board(
        [Picture("a", flat(old)), Picture("b", flat(old))],
        replace(old, legacy=not old.legacy),
    )
    assert got.spec == old
    assert len(got.views) == 2
    assert "legacy pattern" in got.notices[0]


def test_mixed_boards_are_told() -> None:
    pictures = [
        Picture("a", render(CHESS, poses(8)[1])),
        Picture("b", render(BoardSpec.parse("chessboard:7x5:30mm"), poses(8)[2])),
    ]
    got = find_board(pictures, CHESS)
    assert [v.name for v in got.views] == ["a"]
    assert got.empty == ("b",)
    assert any("mixed boards" in n and "7x5" in n for n in got.notices)


def test_what_cannot_be_read_or_is_of_another_kind_is_left_out_and_all_of_it_is_told() -> (
    None
):
    """A picture upside down by EXIF has the others' size, and its principal point on the
    other side.
    """
    good = [
        Picture(f"g{i}", render(CHESS, p), turn=(1, 6)[i % 2])
        for i, p in enumerate(poses(9)[:5])
    ]
    turned = Picture("turned", render(CHESS, poses(9)[5]), turn=3)
    small = Picture("small", np.zeros((200, 300), np.uint8))
    bad = [
        Picture(n, InputError(f"{n} is damaged", "save it again"))
        for n in ("bad", "worse")
    ]
    got = find_board([bad[0], *good, small, turned, bad[1]], CHESS)
    assert [v.name for v in got.views] == [g.name for g in good]
    assert (
        got.notices[0] == "left out: bad is damaged; worse is damaged (save it again)"
    )
    assert (
        "small is 300x200" in got.notices[1]
        and "turned is 640x480 upside down by EXIF" in got.notices[1]
    )
    with pytest.raises(InputError, match="bad is damaged; worse is damaged"):
        find_board(bad, CHESS)
    with pytest.raises(
        InputError,
        match=r"a is 640x480, b is 640x480 upside down by EXIF",
    ):
        find_board([Picture("a", good[0].gray), Picture("b", good[1].gray, 3)], CHESS)
    with pytest.raises(NothingToDoError, match="left out: bad is damaged"):
        find_board([small, bad[0]], CHESS)
    with pytest.raises(NothingToDoError, match="3 different views are needed"):
        calibrate(find_board(good[:2], CHESS))


def test_mixed_sizes_are_an_error_that_names_both() -> None:
    with pytest.raises(InputError, match="a is 300x200, b is 200x300"):
        find_board(
            [
                Picture("a", np.zeros((200, 300), np.uint8)),
                Picture("b", np.zeros((300, 200), np.uint8)),
            ],
            CHARUCO,
        )
