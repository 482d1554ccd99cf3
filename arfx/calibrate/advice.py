"""What of the picture and of the board's tilts the views cover; the verdict good | usable |
poor with its reasons; and the next picture that would help: where the picture is emptiest,
tilted to the side that is missing.

Source of the projection uncertainty: mrcal's documentation, "Projection uncertainty"
(rotation-compensated, at infinity)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.calibrate.solve import Fit, Uncertainty, grid_pixels, without_pose
from arfx.core.numerics import arccos
from arfx.core.pose import rotation_from_rotvec

CELLS = (8, 6)  # across, down: at 4:3 they are square
# a board tilted by less separates focal length from distance too weakly: its depth range is
# .27 of its size
TILTED_DEG = 15.0
GRID = (13, 9)  # where the projection uncertainty is looked at
GOOD, USABLE, POOR = "good", "usable", "poor"
# how steeply, and how large in the picture, the next board is proposed
NEXT_TILT_DEG, NEXT_FRACTION = 35.0, 0.45
SIDES = (
    "right",
    "lower",
    "left",
    "upper",
)  # of the board, as `Coverage.azimuth_deg` turns


# figure of the calibration -> what it must reach (good, poor) and the reason when it does not
LIMITS = tomllib.loads(Path(__file__).with_name("limits.toml").read_text("utf-8"))


class Verdict(NamedTuple):
    """word : good, usable or poor; reasons : what keeps it from being good, worst first,
    empty for good; next_picture : how to hold the board"""

    word: str
    reasons: tuple[str, ...]
    next_picture: str


def judge(figures: dict[str, float]) -> tuple[str, tuple[str, ...]]:
    """The word and the reasons for the figures that LIMITS names.

    A figure that is not a number counts as poor.
    """
    graded = []
    for name, limit in LIMITS.items():
        value, good, poor = figures[name], limit["good"], limit["poor"]
        sign = 1 if good > poor else -1
        grade = int(sign * value >= sign * poor) + int(sign * value >= sign * good)
        graded.append((grade, limit["text"].format(value=value, limit=good)))
    graded.sort(key=lambda figure: figure[0])
    word = (POOR, USABLE, GOOD)[graded[0][0]]
    return word, tuple(text for grade, text in graded if grade < 2)


def figures(
    fitted: Fit,
    seen: Coverage,
    known: Uncertainty,
    projection_sd_px: ndarray,
    held_out_px: float,
    rejected: int,
) -> dict[str, float]:
    """What LIMITS judges. The projection's is that of nine tenths of the picture: its very
    corners are nearly always extrapolated, and are reported apart."""
    width = fitted.camera.width
    projection_sd = float(np.quantile(projection_sd_px, 0.9))
    return {
        "views": len(fitted.views),
        "focal_sd_percent": 100
        * float(max(known.standard_deviations[:2]))
        / fitted.camera.fx,
        "tilt_max_deg": float(seen.tilt_deg.max()),
        "tilt_directions": seen.directions,
        "cells_percent": 100 * seen.cells,
        "radius_percent": 100 * seen.radius,
        "held_out_permille": 1000 * held_out_px / width,
        "projection_sd_permille": 1000 * projection_sd / width,
        "rejected_percent": 100 * rejected / (rejected + len(fitted.views)),
    }


def next_picture(seen: Coverage) -> str:
    """In words, where to hold the board and how to tilt it: where the fewest corners are,
    towards the side that the fewest views are tilted to."""
    thirds = np.add.reduceat(np.add.reduceat(seen.counts, (0, 2, 4), 0), (0, 3, 5), 1)
    row, column = np.unravel_index(np.argmin(thirds / (3, 2, 3)), thirds.shape)
    place = ("upper ", "", "lower ")[row] + ("left", "middle", "right")[column]
    return (
        f"hold the board in the {place} of the picture, about {NEXT_FRACTION:.0%} of its"
        f" width, tilted by about {NEXT_TILT_DEG:.0f}° with its"
        f" {SIDES[np.argmin(seen.tilted_to)]} edge nearer"
    )


class Coverage(NamedTuple):
    """counts : (rows, columns) corners per cell of the picture; cells : share of the cells
    with a corner;
    radius : farthest corner from the picture's centre over half the diagonal; tilt_deg,
    azimuth_deg : (V,) of each view,
    the board's normal against the optical axis, and where its near edge points in the
    picture (0 right, 90 down);
    tilted_to : (4,) views tilted
    by more than TILTED_DEG with the near edge on each of SIDES"""

    counts: ndarray
    cells: float
    radius: float
    tilt_deg: ndarray
    azimuth_deg: ndarray
    tilted_to: ndarray

    @property
    def directions(self) -> int:
        """Sides to which a view is tilted."""
        return int((self.tilted_to > 0).sum())


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
    normals = rotation_from_rotvec(fitted.rotations)[:, :, 2]
    # in camera coordinates, towards the camera's side
    normals = np.where(normals[:, 2:] <= 0, normals, -normals)
    tilt = np.degrees(arccos(-normals[:, 2]))
    # the normal leans away from the near edge, so the near edge lies on the opposite side
    azimuth = np.degrees(np.arctan2(-normals[:, 1], -normals[:, 0])) % 360
    quarter = ((azimuth + 45) % 360 // 90).astype(int)
    off = points - ((w - 1) / 2, (h - 1) / 2)
    radius = float(np.linalg.norm(off, axis=1).max() / np.hypot(w / 2, h / 2))
    return Coverage(
        counts.astype(int),
        float((counts > 0).mean()),
        radius,
        tilt,
        azimuth,
        np.bincount(quarter[tilt > TILTED_DEG], minlength=4),
    )


def projection_jacobian(fitted: Fit) -> ndarray:
    """(2n, p) how each grid pixel's projection moves with the intrinsics, a turn of the
    camera taken out.

    A change of intrinsics that only turns the picture is no error for anyone who estimates
    the pose with them. The camera's distortion must not fold inside (`solve.one_to_one`)."""
    rays = fitted.camera.directions(grid_pixels(fitted.camera, *GRID))
    j = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), fitted.camera.matrix, fitted.camera.distortion
    )[1]
    return without_pose(fitted.model.by_parameters(j), j[:, :3])


def projection_uncertainty_px(fitted: Fit, known: Uncertainty) -> ndarray:
    """(n,) one standard deviation of the projection at each grid pixel, px (root mean
    square of x and y).
    """
    j = projection_jacobian(fitted)
    variance = (
        np.einsum("np,pq,nq->n", j, known.covariance, j).reshape(-1, 2).sum(1) / 2
    )
    return np.sqrt(np.maximum(variance, 0.0))
