"""Sweeps of a marker's pose through pixels: drawn, blurred, made noisy, found, refined, solved.

Where an answer is owed is said in cells: what is printed in them has to be there in the
picture to be read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from arfx.analyse.markers.corners import linear_table, refine_corners, shared_px
from arfx.analyse.markers.detect import MarkerDetector
from arfx.analyse.pose.planar import Observed, information
from arfx.core.colour import SRGB
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import cells_per_side, dictionary
from arfx.core.pose import Pose, rotation_angle_rad, rotation_from_rotvec
from tests.hard.sweeps import (
    ANSWER,
    CAMERA,
    EITHER,
    REFUSAL,
    Answer,
    Data,
    Expected,
    Sweep,
)
from tests.planar import planar

_FAMILY, _SIDE_M = "36h11", 0.1
_CORNERS_M = MarkerSpec(_FAMILY, 0, _SIDE_M).corners_m
_FOCAL_PX, _SIZE_PX = 900.0, 360
_CELLS = 8
_FINE = 6  # samples a pixel, each way, of the picture that is drawn
_NOISE = 1.5 / 255
_LEAST_DEG = 0.01  # no marker of 200 px says more
_INK, _PAPER, _TEXEL = 0.05, 0.7, 12
_DELTAS = tuple(10.0 ** (-k / 6) for k in range(19))


@dataclass(frozen=True)
class View:
    """turn : camera_from_marker;  side_px : of the print, facing;  blur_px : standard
    deviation;  contrast : of 1
    """

    turn: np.ndarray
    side_px: float = 120.0
    blur_px: float = 0.4
    contrast: float = 1.0

    @property
    def middle_m(self) -> np.ndarray:
        away = _SIDE_M * _FOCAL_PX / self.side_px
        return np.array([0.02, 0.013, 1.0]) * [away, away, away]

    @property
    def narrowest_cell_px(self) -> float:
        seen = _CORNERS_M @ self.turn.T + self.middle_m
        px = _FOCAL_PX * seen[:, :2] / seen[:, 2:]
        area = cv2.contourArea(px.astype(np.float32))
        return (
            area
            / float(np.linalg.norm(px - np.roll(px, 1, 0), axis=1).max())
            / _CELLS
        )


@cache
def _print() -> np.ndarray:
    """Linear light of the print with a margin of two cells, float32."""
    bits = cv2.aruco.generateImageMarker(dictionary(_FAMILY), 0, _CELLS)
    bits = np.pad(bits, 2, constant_values=255)
    return np.kron(
        np.where(bits > 0, _PAPER, _INK), np.ones((_TEXEL, _TEXEL))
    ).astype(np.float32)


def picture(view: View, draw: int) -> np.ndarray:
    """(h, w) uint8 luma: the print on paper, seen by a camera."""
    texels = _print()
    margin_m = _SIDE_M / _CELLS * 2
    span = _SIDE_M / 2 + margin_m
    sheet_m = np.array(
        [[-span, span, 0], [span, span, 0], [span, -span, 0], [-span, -span, 0]]
    )
    seen = sheet_m @ view.turn.T + view.middle_m
    px = _FOCAL_PX * seen[:, :2] / seen[:, 2:] + (_SIZE_PX - 1) / 2
    size = float(len(texels))
    texel_px = (
        np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - 0.5
    )
    fine_px = ((px + 0.5) * _FINE - 0.5).astype(np.float32)
    fine = cv2.warpPerspective(
        texels, cv2.getPerspectiveTransform(texel_px, fine_px), (_SIZE_PX * _FINE, _SIZE_PX * _FINE), flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=_PAPER,
    )  # fmt: skip
    light = cv2.resize(fine, (_SIZE_PX, _SIZE_PX), interpolation=cv2.INTER_AREA)
    light = cv2.GaussianBlur(light, (0, 0), view.blur_px)
    light = 0.5 + (light - 0.5) * view.contrast
    code = SRGB.encode(light) + np.random.default_rng(draw).normal(
        0, _NOISE, light.shape
    )
    return np.clip(np.rint(255 * code), 0, 255).astype(np.uint8)


def _pose(
    view_at: Callable[[float], View],
) -> Callable[[float, str, Data], Answer | None]:
    """Turn of the nearer of both poses from the true one, degrees."""

    def answer(delta: float, formula: str, data: Data) -> Answer | None:
        view = view_at(delta)
        luma = picture(view, data.draw)
        found = [
            c
            for c in MarkerDetector([_FAMILY], inverted=False).search(luma)
            if c.id == 0
        ]
        if not found:
            return None
        cells = np.array([cells_per_side(_FAMILY)])
        refined = refine_corners(luma, found[0].quad_px[None], cells, linear_table())
        ideal = (refined.corners_px - (_SIZE_PX - 1) / 2) / _FOCAL_PX
        sigma = np.hypot(
            refined.sigma_px, shared_px(refined.corners_px, refined.blur_px, cells)
        )
        scale = np.broadcast_to(_FOCAL_PX * np.eye(2), (1, 4, 2, 2))
        both = planar(_CORNERS_M, ideal[0], scale[0], float(sigma[0]))
        if not both:
            return None
        off = [
            rotation_angle_rad(pose, Pose(view.turn, np.zeros(3))) for pose, _ in both
        ]
        best, _ = both[int(np.argmin(off))]
        observed = Observed(
            _CORNERS_M[None], ideal, scale, np.repeat(sigma[:, None] ** -2.0, 4, 1)
        )
        covariance = np.linalg.pinv(
            information(best.rotation[None], best.translation_m[None], observed)[0],
            hermitian=True,
        )
        stated = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
        return Answer(
            float(np.degrees(min(off))), min(float(np.degrees(stated)), 180.0)
        )

    return answer


def _expected(view_at: Callable[[float], View]) -> Callable[[float, Data], Expected]:
    """Bits are read where a cell is two pixels and three of its blur's deviations wide, and
    20 codes apart (OpenCV looks for what is 7 darker than its neighbourhood's mean); not
    where it is half a pixel, or blurred by twice its width, or below a code."""

    def expected(delta: float, data: Data) -> Expected:
        view = view_at(delta)
        cell = view.narrowest_cell_px
        paper, ink = (
            SRGB.encode(0.5 + (albedo - 0.5) * view.contrast)
            for albedo in (_PAPER, _INK)
        )
        codes = 255 * float(paper - ink)
        if cell >= max(2.0, 3 * view.blur_px) and codes >= 20:
            return Expected(ANSWER, _LEAST_DEG)
        return Expected(
            REFUSAL if cell < max(0.5, 0.5 * view.blur_px) or codes < 1 else EITHER,
            _LEAST_DEG,
        )

    return expected


_FACING = np.diag([1.0, -1.0, -1.0])
_TILTED = rotation_from_rotvec(np.array([0.6, 0.2, 0.0])) @ _FACING


def _smaller(delta: float) -> View:
    return View(_TILTED, 200.0 * delta)


def _edge_on(delta: float) -> View:
    """Its plane passes the camera at an angle of delta, as seen from its middle."""
    view = View(_FACING)
    off = np.arctan2(view.middle_m[1], view.middle_m[2])
    return View(
        rotation_from_rotvec(np.array([np.pi / 2 - off - delta, 0.0, 0.0])) @ _FACING,
        160.0,
    )


def _blurred(delta: float) -> View:
    return View(_TILTED, 160.0, 0.4 / delta)


def _in_fog(delta: float) -> View:
    return View(_TILTED, 120.0, contrast=delta)


_WAYS = (
    ("no width", _smaller),
    ("edge on", _edge_on),
    ("endless blur", _blurred),
    ("no contrast", _in_fog),
)
PIXELS: tuple[Sweep, ...] = tuple(
    Sweep(
        "marker pose, pixels",
        towards,
        "deg",
        _pose(at),
        _expected(at),
        (CAMERA,),
        _DELTAS,
    )
    for towards, at in _WAYS
)
