"""What of the picture and of the board's tilts the views cover; the verdict good | usable |
poor with its reasons; and the next picture that would help most: of 45 ways to hold the
board, the one after which the projection would be least uncertain.

Source of the projection uncertainty: mrcal's documentation, "Projection uncertainty"
(rotation-compensated, at infinity)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from arfx.calibrate.board import BoardSpec
from arfx.calibrate.corners import View
from arfx.calibrate.solve import Fit, Uncertainty, information, jacobians, without_pose
from arfx.core.numerics import angle_between, arccos

CELLS = (8, 6)  # across, down: at 4:3 they are square
# a board tilted by less separates focal length from distance too weakly: its depth range is
# .27 of its size
TILTED_DEG = 15.0
GRID = (13, 9)  # where the projection uncertainty is looked at
GOOD, USABLE, POOR = "good", "usable", "poor"
NEXT_TILT_DEG, NEXT_FRACTION = (
    35.0,
    0.45,
)  # how steeply, and how large in the picture, the next board is proposed


@dataclass(frozen=True, slots=True)
class Limit:
    """A figure of the calibration and what it must reach. Where `more` the value must be at
    least the limit, else at most.

    text : the reason when it does not, with {value} and {limit}"""

    name: str
    good: float
    poor: float
    more: bool
    text: str


# `poor`: a virtual object drawn with it is visibly wrong (1 % of focal length is 1 % of
# every distance); `good`: the camera's error stays below what marker corners add in each
# frame (.3 % and about a pixel).
LIMITS = (
    Limit(
        "views",
        10,
        5,
        True,
        "only {value:.0f} different views take part (good: {limit:.0f})",
    ),
    Limit(
        "focal_sd_percent",
        0.3,
        1.0,
        False,
        "the focal length is known to ±{value:.2g} % only (good: {limit:g} %)",
    ),
    Limit(
        "tilt_max_deg",
        25,
        15,
        True,
        "the board is seen nearly frontally: steepest tilt {value:.0f}° (good:"
        " {limit:.0f}°)",
    ),
    Limit(
        "tilt_directions",
        3,
        1,
        True,
        "the board tilts over 15° to {value:.0f} of 4 sides (good: {limit:.0f})",
    ),
    Limit(
        "cells_percent",
        60,
        30,
        True,
        "corners cover {value:.0f} % of the picture (good: {limit:.0f} %)",
    ),
    Limit(
        "radius_percent",
        70,
        45,
        True,
        "they reach {value:.0f} % of the way to the picture's corners (good:"
        " {limit:.0f} %)",
    ),
    Limit(
        "held_out_permille",
        0.8,
        3.0,
        False,
        "views miss their prediction by {value:.2g} ‰ of the width (good: {limit:g} ‰)",
    ),
    Limit(
        "projection_sd_permille",
        2.0,
        10.0,
        False,
        "towards the border the projection is uncertain by {value:.2g} ‰ of the width"
        " (good: {limit:g} ‰)",
    ),
    Limit(
        "rejected_percent",
        25,
        50,
        False,
        "{value:.0f} % of the views disagree with the others (good: {limit:.0f} %): two"
        " boards or cameras, or a bent board?",
    ),
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """word : good, usable or poor; reasons : what keeps it from being good, worst first,
    empty for good; next_picture : how to hold the board"""

    word: str
    reasons: tuple[str, ...]
    next_picture: str


def judge(figures: dict[str, float]) -> tuple[str, tuple[str, ...]]:
    """The word and the reasons for the figures that LIMITS names.

    A figure that is not a number counts as poor.
    """
    poor, usable = [], []
    for limit in LIMITS:
        value = figures[limit.name]
        text = limit.text.format(value=value, limit=limit.good)
        if not np.isfinite(value) or (
            value < limit.poor if limit.more else value > limit.poor
        ):
            poor.append(text)
        elif value < limit.good if limit.more else value > limit.good:
            usable.append(text)
    return (POOR if poor else USABLE if usable else GOOD), (*poor, *usable)


def figures(
    fitted: Fit,
    seen: Coverage,
    focal_sd_px: float,
    projection_sd_px: np.ndarray,
    held_out_px: float,
    rejected: int,
) -> dict[str, float]:
    """What LIMITS judges. The projection's is that of nine tenths of the picture: its very
    corners are nearly always extrapolated, and are reported apart."""
    width = fitted.camera.width
    projection_sd = (
        float(np.quantile(projection_sd_px, 0.9)) if projection_sd_px.size else float("inf")
    )
    return {
        "views": float(len(fitted.views)),
        "focal_sd_percent": 100 * focal_sd_px / fitted.camera.fx,
        "tilt_max_deg": float(seen.tilt_deg.max()),
        "tilt_directions": float(seen.directions),
        "cells_percent": 100 * seen.cells,
        "radius_percent": 100 * seen.radius,
        "held_out_permille": 1000 * held_out_px / width,
        "projection_sd_permille": 1000 * projection_sd / width,
        "rejected_percent": 100 * rejected / (rejected + len(fitted.views)),
    }


def next_picture(fitted: Fit, known: Uncertainty, spec: BoardSpec) -> str:
    """In words, where to hold the board and how to tilt it, so that the next view teaches most."""
    noise = max(known.sigma_px, 0.05)
    normal = sum(j.T @ j for j in information(fitted))
    where = projection_jacobian(fitted)
    best, best_score = (
        (
            f"hold the board so that it fills {NEXT_FRACTION:.0%} of the picture's width,"
            f" tilted by {NEXT_TILT_DEG:.0f}°"
        ),
        float("inf"),
    )
    for text, view, rvec, tvec in _candidates(fitted, spec):
        j = without_pose(*jacobians(view, rvec, tvec, fitted.camera, fitted.model))
        covariance = noise**2 * np.linalg.pinv(normal + j.T @ j, hermitian=True)
        score = float(np.einsum("np,pq,nq->", where, covariance, where))
        if score < best_score:
            best, best_score = text, score
    return best


def _candidates(
    fitted: Fit, spec: BoardSpec
) -> Sequence[tuple[str, View, np.ndarray, np.ndarray]]:
    """Ways to hold the board so that all of it is in the picture."""
    camera, out = fitted.camera, []
    distance = (
        camera.fx
        * float(np.ptp(spec.corners_m[:, 0] - spec.corners_m[:, 0].mean()))
        / (NEXT_FRACTION * camera.width)
    )
    a, tilted = np.radians(NEXT_TILT_DEG), f"tilted by about {NEXT_TILT_DEG:.0f}° with its"
    tilts = {
        "facing the camera": (0.0, 0.0),
        f"{tilted} right edge nearer": (0.0, a),
        f"{tilted} left edge nearer": (0.0, -a),
        f"{tilted} upper edge nearer": (a, 0.0),
        f"{tilted} lower edge nearer": (-a, 0.0),
    }
    columns = {"left": 0.27, "middle": 0.5, "right": 0.73}
    rows = {"upper ": 0.3, "": 0.5, "lower ": 0.7}
    size = camera.width, camera.height
    for (down, y), (across, x), (how, tilt) in itertools.product(
        rows.items(), columns.items(), tilts.items()
    ):
        ray = camera.directions(np.multiply([x, y], np.subtract(size, 1)))
        rvec = np.array([*tilt, 0.0])
        turn = cv2.Rodrigues(rvec)[0]
        tvec = ray * distance - turn @ spec.corners_m.mean(0)  # about the board's middle
        points = camera.project(spec.corners_m @ turn.T + tvec)
        if not ((points > 0) & (points < size)).all():  # nor where a point is NaN
            continue
        text = (
            f"hold the board in the {down}{across} of the picture, about"
            f" {NEXT_FRACTION:.0%} of its width, {how}"
        )
        view = View("", size, np.arange(len(points)), spec.corners_m, points, "")
        out.append((text, view, rvec, tvec))
    return out


@dataclass(frozen=True, eq=False)
class Coverage:
    """counts : (rows, columns) corners per cell of the picture; cells : share of the cells
    with a corner;
    radius : farthest corner from the picture's centre over half the diagonal; tilt_deg,
    azimuth_deg : (V,) of each view,
    the board's normal against the optical axis, and where its near edge points in the
    picture (0 right, 90 down);
    span_deg : largest angle between the normals of two views; directions : how many of the
    four quarter turns of azimuth
    hold a tilt above TILTED_DEG"""

    counts: np.ndarray
    cells: float
    radius: float
    tilt_deg: np.ndarray
    azimuth_deg: np.ndarray
    span_deg: float
    directions: int


def coverage(fitted: Fit) -> Coverage:
    """Coverage of the views that a fit rests on."""
    w, h = fitted.camera.width, fitted.camera.height
    points = np.concatenate([v.pixels for v in fitted.views])
    counts, _, _ = np.histogram2d(
        points[:, 1],
        points[:, 0],
        bins=(CELLS[1], CELLS[0]),
        range=((-0.5, h - 0.5), (-0.5, w - 0.5)),
    )
    normals = np.array([cv2.Rodrigues(r)[0][:, 2] for r in fitted.rotations])
    normals = np.where(
        normals[:, 2:] <= 0, normals, -normals
    )  # in camera coordinates, towards the camera's side
    tilt = np.degrees(arccos(-normals[:, 2]))
    # the normal leans away from the near edge, so the near edge lies on the opposite side
    azimuth = np.degrees(np.arctan2(-normals[:, 1], -normals[:, 0])) % 360
    span = max(float(np.degrees(angle_between(n[None], normals)).max()) for n in normals)
    quadrants = {
        int(((a + 45) % 360) // 90)
        for a, t in zip(azimuth, tilt, strict=True)
        if t > TILTED_DEG
    }
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    radius = float(np.linalg.norm(points - centre, axis=1).max() / np.hypot(w / 2, h / 2))
    return Coverage(
        counts.astype(int),
        float((counts > 0).mean()),
        radius,
        tilt,
        azimuth,
        span,
        len(quadrants),
    )


def grid_pixels(width: int, height: int) -> np.ndarray:
    """(n, 2) pixels spread over the picture, GRID of them, borders included."""
    x, y = np.meshgrid(
        np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1])
    )
    return np.stack([x.ravel(), y.ravel()], -1)


def projection_jacobian(fitted: Fit) -> np.ndarray:
    """(2n, p) how each grid pixel's projection moves with the intrinsics, a turn of the
    camera taken out.

    A change of intrinsics that only turns the picture is no error for anyone who estimates
    the pose with them. Pixels that no direction maps to are left out."""
    rays = fitted.camera.directions(grid_pixels(fitted.camera.width, fitted.camera.height))
    rays = rays[np.isfinite(rays).all(-1)]
    j = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), fitted.camera.matrix, fitted.camera.distortion
    )[1]
    return without_pose(
        np.hstack([j[:, 6:10], j[:, [10 + i for i in fitted.model.free]]]), j[:, :3]
    )


def projection_uncertainty_px(fitted: Fit, known: Uncertainty) -> np.ndarray:
    """(n,) one standard deviation of the projection at each grid pixel, px (root mean
    square of x and y).
    """
    j = projection_jacobian(fitted)
    variance = np.einsum("np,pq,nq->n", j, known.covariance, j).reshape(-1, 2).sum(1) / 2
    return np.sqrt(np.maximum(variance, 0.0))
