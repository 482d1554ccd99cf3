"""Exact sightings and pictures of markers with known poses, made here from scratch:
projected corners with noise, or a texture warped with supersampling, blurred in linear
light and coded."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from arfx.analyse.markers.detect import Detection, Record
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import dictionary
from arfx.core.pose import Pose, rotation_from_rotvec

THUMBNAIL = np.random.default_rng(0).integers(0, 256, (18, 32), np.uint8)
FACING = np.diag([1.0, -1.0, -1.0])  # a marker that looks straight into the camera


def camera(
    width: int = 640,
    height: int = 480,
    focal_px: float = 800.0,
    distortion: Sequence[float] = (),
) -> Camera:
    matrix = np.array(
        [[focal_px, 0, width / 2 - 3.5], [0, focal_px, height / 2 + 2.5], [0, 0, 1]]
    )
    return Camera(width, height, matrix, np.array(distortion, float))


def tilted(rotvec: Sequence[float], translation_m: Sequence[float]) -> Pose:
    """camera_from_marker of a marker turned by rotvec (camera axes, radians) out of facing
    the camera.
    """
    return Pose(
        rotation_from_rotvec(np.asarray(rotvec, float)) @ FACING,
        np.asarray(translation_m, float),
    )


def records(
    cam: Camera, poses: Sequence[Pose | None], times_s: Sequence[float], layout: dict[MarkerSpec, Pose],
    noise_px: float, seed: int = 0, visible: Callable[[int, MarkerSpec], bool] = lambda k, m: True,
    claimed_px: float | None = None,
) -> list[Record]:  # fmt: skip
    """Noisy corners of the markers of a layout (world_from_marker) under camera_from_world
    poses; None = nothing seen.
    """
    rng = np.random.default_rng(seed)
    out = []
    for k, (pose, t) in enumerate(zip(poses, times_s, strict=True)):
        seen = []
        for m, place in layout.items():
            px = (
                None
                if pose is None
                else cam.project((pose @ place).apply(m.corners_m))
            )
            noise = rng.normal(0, noise_px, (4, 2)) if noise_px else np.zeros((4, 2))
            if px is not None and visible(k, m):
                sigma = max(claimed_px if claimed_px is not None else noise_px, 0.01)
                seen.append(Detection(m.key, px + noise, sigma, 0.8, False))
        out.append(Record(k, float(t), tuple(seen), THUMBNAIL))
    return out


def poster(width: int = 220, height: int = 150, seed: int = 0) -> np.ndarray:
    """(h, w, 3) linear picture 0..1 of a print: discs and bars of several sizes and colours
    on white.
    """
    rng = np.random.default_rng(seed)
    out = np.full((height, width, 3), 1.0, np.float32)
    for _ in range(70):
        colour = (rng.uniform(0, 1) * rng.uniform(0.2, 1, 3)).tolist()
        x, y, r = (
            int(rng.integers(0, width)),
            int(rng.integers(0, height)),
            int(rng.integers(4, 18)),
        )
        if rng.random() < 0.5:
            cv2.circle(out, (x, y), r, colour, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(out, (x, y), (x + r, y + 2 * r), colour, -1)
    return out


def hung(
    cam: Camera,
    print_: np.ndarray,
    corners_m: np.ndarray,
    pose: Pose,
    back: np.ndarray,
) -> np.ndarray:
    """`back` (h, w[, 3]) with a print (same channels) on it, camera_from_print: a linear
    picture, sampled 3 x 3 times a pixel.
    """
    ss = 3
    quad = cam.project(pose.apply(corners_m))
    (x0, y0), (x1, y1) = (
        np.clip(v, 0, [cam.width, cam.height]).astype(int)
        for v in (quad.min(0) - 3, quad.max(0) + 4)
    )
    grid = np.stack(
        np.meshgrid(np.arange(ss * x0, ss * x1), np.arange(ss * y0, ss * y1)), -1
    )
    ideal = cam.normalised((grid + 0.5) / ss - 0.5)
    m = np.stack(
        [pose.rotation[:, 0], pose.rotation[:, 1], pose.translation_m], -1
    )  # the print's plane to the camera
    at = (
        np.concatenate([ideal, np.ones_like(ideal[..., :1])], -1) @ np.linalg.inv(m).T
    )
    h, w = print_.shape[:2]
    x, y = corners_m.max(0)[:2]
    u, v = (
        (at[..., 0] / at[..., 2] / x + 1) / 2,
        (1 - at[..., 1] / at[..., 2] / y) / 2,
    )
    map_ = [(u * w - 0.5).astype(np.float32), (v * h - 0.5).astype(np.float32)]
    seen = cv2.remap(print_, *map_, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = ((u > 0) & (u < 1) & (v > 0) & (v < 1)).astype(np.float32)
    size = (int(x1 - x0), int(y1 - y0))
    cover = cv2.resize(inside, size, interpolation=cv2.INTER_AREA)
    covered = cv2.resize(
        seen * (inside if seen.ndim == 2 else inside[..., None]),
        size,
        interpolation=cv2.INTER_AREA,
    )
    out = back.copy()
    out[y0:y1, x0:x1] = (
        out[y0:y1, x0:x1] * (1 - (cover if back.ndim == 2 else cover[..., None]))
        + covered
    )
    return out


def background(width: int, height: int, seed: int = 1) -> np.ndarray:
    """(h, w) linear light 0..1: smooth random blotches with corners for a tracker, no squares."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(
        rng.uniform(0.15, 0.5, (height // 40 + 2, width // 40 + 2)),
        (width, height),
        interpolation=cv2.INTER_CUBIC,
    )
    for _ in range(60):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        cv2.circle(
            coarse, (x, y), int(rng.integers(3, 9)), float(rng.uniform(0.05, 0.7)), -1
        )
    return np.clip(coarse, 0, 1).astype(np.float32)


def picture(
    cam: Camera, markers: Sequence[tuple[MarkerSpec, Pose]], back: np.ndarray, noise: float = 2.0, blur_px: float = 0.7,
    seed: int = 0, inverted: bool = False, linear: bool = True,
) -> np.ndarray:  # fmt: skip
    """(h, w) uint8 luma. markers : camera_from_marker of each; the camera must be without
    distortion.
    linear : blur in light and code as sRGB; else blur what is coded."""
    ss = 4
    image = back.astype(np.float32).copy()
    for m, pose in markers:
        code = dictionary(m.family)
        cells, px = int(code.markerSize) + 2, 24
        print_ = cv2.copyMakeBorder(
            cv2.aruco.generateImageMarker(code, m.id, cells * px),
            px,
            px,
            px,
            px,
            cv2.BORDER_CONSTANT,
            value=255,
        )
        if inverted:
            print_ = 255 - print_
        paper = np.where(print_ > 127, 0.85, 0.05).astype(np.float32)
        outer = m.corners_m * (1 + 2 / cells)
        corner_px = cam.project(pose.apply(outer))
        x0, y0 = np.floor(corner_px.min(0)).astype(int) - 4
        x1, y1 = np.ceil(corner_px.max(0)).astype(int) + 5
        side = (cells + 2) * px
        source = (
            np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) - 0.5
        )
        target = ((corner_px - [x0, y0] + 0.5) * ss - 0.5).astype(np.float32)
        h = cv2.getPerspectiveTransform(source, target)
        size = ((x1 - x0) * ss, (y1 - y0) * ss)
        flags = cv2.INTER_LINEAR
        warped = cv2.warpPerspective(paper, h, size, flags=flags)
        cover = cv2.warpPerspective(
            np.ones_like(paper), h, size, flags=cv2.INTER_LINEAR
        )
        small = (int(x1 - x0), int(y1 - y0))
        warped, cover = (
            cv2.resize(a, small, interpolation=cv2.INTER_AREA)
            for a in (warped, cover)
        )
        a0, b0 = max(x0, 0), max(y0, 0)
        a1, b1 = min(x1, cam.width), min(y1, cam.height)
        if a1 <= a0 or b1 <= b0:
            continue
        part = slice(b0 - y0, b1 - y0), slice(a0 - x0, a1 - x0)
        image[b0:b1, a0:a1] = image[b0:b1, a0:a1] * (1 - cover[part]) + warped[part]
    if not linear:
        image = _coded(image)
    if blur_px:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    if linear:
        image = _coded(image)
    rng = np.random.default_rng(seed)
    return (
        np.clip(image * 255 + rng.normal(0, noise, image.shape), 0, 255)
        .round()
        .astype(np.uint8)
    )


def _coded(light: np.ndarray) -> np.ndarray:
    return np.where(
        light <= 0.0031308,
        light * 12.92,
        1.055 * np.clip(light, 0, None) ** (1 / 2.4) - 0.055,
    )
