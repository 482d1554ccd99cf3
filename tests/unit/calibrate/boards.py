"""Synthetic views of boards: exact corners with noise, and rendered pictures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from arfx.calibrate.board import BoardSpec, charuco_board
from arfx.calibrate.corners import View
from arfx.core.camera import Camera

SIZE = (640, 480)
CHESS = BoardSpec.parse("chessboard:9x6:25mm")
TRUE = Camera(
    *SIZE,
    np.array([[620.0, 0, 325], [0, 618, 236], [0, 0, 1]]),
    np.array([-0.21, 0.07, 0.0008, -0.0005, 0.0]),
)


def poses(
    count: int, seed: int = 0, tilt_deg: tuple[float, float] = (15, 42)
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Board poses spread over the picture, tilted in all directions."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(count):
        azimuth = 2 * np.pi * i / count * 3.7
        rvec = np.radians(rng.uniform(*tilt_deg)) * np.array(
            [np.cos(azimuth), np.sin(azimuth), 0]
        )
        turn = cv2.Rodrigues(np.array([0, 0, rng.uniform(-0.5, 0.5)]))[0]
        distance = rng.uniform(0.36, 0.52)
        middle = (
            np.array([rng.uniform(-0.17, 0.17), rng.uniform(-0.12, 0.12), 1])
            * distance
        )
        r = cv2.Rodrigues(rvec)[0] @ turn
        out.append(
            (cv2.Rodrigues(r)[0].ravel(), middle - r @ CHESS.corners_m.mean(0))
        )
    return out


def view(
    pose: tuple[np.ndarray, np.ndarray], rng: np.random.Generator, noise_px: float = 0.1, name: str = "", camera: Camera = TRUE,
    spec: BoardSpec = CHESS,
) -> View:  # fmt: skip
    pixels = cv2.projectPoints(
        spec.corners_m, *pose, camera.matrix, camera.distortion
    )[0].reshape(-1, 2)
    pixels = pixels + rng.normal(0, noise_px, pixels.shape)
    ids = np.arange(len(pixels))
    return View(
        name,
        (camera.width, camera.height),
        ids,
        spec.corners_m,
        pixels,
        0.4,
    )


def views(
    count: int,
    seed: int = 0,
    noise_px: float = 0.1,
    camera: Camera = TRUE,
    **kw: tuple[float, float],
) -> list[View]:
    rng = np.random.default_rng(seed + 1000)
    return [
        view(p, rng, noise_px, f"v{i:02d}", camera)
        for i, p in enumerate(poses(count, **kw))
    ]


def board_picture(spec: BoardSpec, px_per_square: int = 60) -> np.ndarray:
    """The flat print with a white margin of one square, uint8; its corner (i, j) lies at
    ((i + 2) * p - .5, ...).
    """
    p, (columns, rows) = px_per_square, spec.squares
    if spec.kind == "charuco":
        flat = charuco_board(spec).generateImage((columns * p, rows * p))
    else:
        i, j = np.mgrid[0:rows, 0:columns]
        flat = np.where(np.kron((i + j) % 2, np.ones((p, p))) > 0, 255, 0).astype(
            np.uint8
        )
    return np.pad(flat, p, constant_values=255)


@cache
def _rays(camera: Camera, over: int) -> np.ndarray:
    offsets = (np.arange(over) - (over - 1) / 2) / over
    xs = (np.arange(camera.width)[:, None] + offsets).ravel()
    ys = (np.arange(camera.height)[:, None] + offsets).ravel()
    pixels = np.stack(np.meshgrid(xs, ys), -1)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-10)
    xy = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), camera.matrix, camera.distortion, criteria=stop
    ).reshape(pixels.shape)
    return np.concatenate([xy, np.ones_like(xy[..., :1])], -1)


def render(
    spec: BoardSpec,
    pose: tuple[np.ndarray, np.ndarray],
    camera: Camera = TRUE,
    blur_px: float = 0.8,
    noise: float = 2.0,
    seed: int = 0,
) -> np.ndarray:
    """(h, w) uint8 picture of a board: every pixel's direction is met with the board's
    plane; 2 x 2 samples a pixel.
    """
    p, over = 60, 2
    rays = _rays(camera, over)
    flat = board_picture(spec, p).astype(np.float32) * 0.75 + 30
    r, t = cv2.Rodrigues(pose[0])[0], np.asarray(pose[1])
    # ray * s = r (x, y, 0) + t  ->  in board coordinates
    o, d = -r.T @ t, rays @ r
    s = -o[2] / d[..., 2]
    xy = (o[:2] + d[..., :2] * s[..., None]) / spec.square_m
    at = ((xy + 2) * p - 0.5).astype(np.float32)
    sampled = cv2.remap(
        flat,
        at[..., 0],
        at[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=120,
    )
    small = cv2.GaussianBlur(
        cv2.resize(
            sampled, None, fx=1 / over, fy=1 / over, interpolation=cv2.INTER_AREA
        ),
        (0, 0),
        blur_px,
    )
    return np.clip(
        small + np.random.default_rng(seed).normal(0, noise, small.shape), 0, 255
    ).astype(np.uint8)


def projected(
    spec: BoardSpec, pose: tuple[np.ndarray, np.ndarray], camera: Camera = TRUE
) -> np.ndarray:
    return cv2.projectPoints(spec.corners_m, *pose, camera.matrix, camera.distortion)[
        0
    ].reshape(-1, 2)


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, -1))))


def names(items: Sequence) -> list[str]:
    return [i.name for i in items]
