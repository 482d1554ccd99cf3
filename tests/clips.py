"""Small real video files with a marker in them, made on the spot, independent of arfx.synth."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np

from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_from_euler_deg

SIZE = (320, 240)
MARKER = MarkerSpec("36h11", 3, 0.1)


def clip_camera(width: int = SIZE[0], height: int = SIZE[1]) -> Camera:
    return Camera(
        width,
        height,
        np.array(
            [
                [0.95 * width, 0, width / 2 - 0.5],
                [0, 0.95 * width, height / 2 - 0.5],
                [0, 0, 1],
            ]
        ),
    )


def write_camera(path: Path, camera: Camera | None = None) -> Path:
    c = camera or clip_camera()
    f = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    f.write("image_width", c.width)
    f.write("image_height", c.height)
    f.write("camera_matrix", c.matrix)
    f.write(
        "distortion_coefficients", c.distortion if c.distortion.size else np.zeros(5)
    )
    f.release()
    return path


def pose_at(i: int, n: int) -> Pose:
    """camera_from_marker: a slow arc around a marker that lies tilted away."""
    t = i / max(n - 1, 1) - 0.5
    r = (
        rotation_from_euler_deg(180, 0, 0)
        @ rotation_from_euler_deg(-35, 0, 0)
        @ rotation_from_euler_deg(0, 0, 30 * t)
    )
    return Pose(r, np.array([0.04 * t, 0.02, 0.42]))


@cache
def ground_of(w: int, h: int, seed: int) -> np.ndarray:
    coarse = (
        np.random.default_rng(seed)
        .integers(90, 170, (h // 8, w // 8, 3))
        .astype(np.uint8)
    )
    return cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC)


@cache
def print_of(side: int, border: int) -> np.ndarray:
    image = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11),
        MARKER.id,
        side,
    )
    return np.clip(
        cv2.copyMakeBorder(
            image, border, border, border, border, cv2.BORDER_CONSTANT, value=255
        ),
        25,
        225,
    )


def picture(pose: Pose | None, camera: Camera, seed: int = 0) -> np.ndarray:
    """(h, w, 3) uint8 RGB: the marker on a textured ground; None = no marker."""
    w, h = camera.width, camera.height
    ground = ground_of(w, h, seed)
    if pose is None:
        return ground.copy()
    scale, side, border = 3, 160, 24
    image = print_of(side, border)
    half = MARKER.size_m / 2
    corners = camera.project(
        pose.apply(
            np.array(
                [
                    [-half, half, 0],
                    [half, half, 0],
                    [half, -half, 0],
                    [-half, -half, 0],
                ]
            )
        )
    )
    src = (
        np.array(
            [
                [border, border],
                [border + side, border],
                [border + side, border + side],
                [border, border + side],
            ]
        )
        - 0.5
    )
    hom = cv2.getPerspectiveTransform(
        src.astype(np.float32), ((corners + 0.5) * scale - 0.5).astype(np.float32)
    )
    big = (w * scale, h * scale)
    mark = cv2.warpPerspective(image, hom, big)
    mask = cv2.warpPerspective(np.full_like(image, 255), hom, big)
    mark, mask = (
        cv2.resize(a, (w, h), interpolation=cv2.INTER_AREA).astype(float)[..., None]
        for a in (mark, mask)
    )
    seen = np.flatnonzero(mask.any((1, 2)))
    rows = slice(seen[0], seen[-1] + 1) if len(seen) else slice(0, 0)
    alpha, out = mask[rows] / 255, ground.copy()
    mixed = ground[rows] * (1 - alpha) + mark[rows] * (alpha > 0) * np.minimum(
        alpha + 1e-9, 1
    )
    out[rows] = np.clip(mixed, 0, 255).astype(np.uint8)
    return out


def write_clip(
    path: Path,
    frames: int = 48,
    camera: Camera | None = None,
    absent: Sequence[int] = (),
    pts: Sequence[int] | None = None,
    time_base: Fraction = Fraction(1, 30),
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    audio: bool = False,
    container: dict[str, str] | None = None,
) -> Path:
    """A clip whose frame i shows the marker at pose_at(i), except in `absent`."""
    camera = camera or clip_camera()
    with av.open(str(path), "w", container_options=container or {}) as out:
        stream = out.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = (
            camera.width,
            camera.height,
            pixel_format,
        )
        stream.time_base = stream.codec_context.time_base = time_base
        if codec == "libx264":
            stream.options = {"crf": "16", "preset": "veryfast"}
        sound = out.add_stream("aac", rate=44100, layout="mono") if audio else None
        for i in range(frames):
            rgb = picture(None if i in absent else pose_at(i, frames), camera)
            f = av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(
                format=pixel_format
            )
            f.pts, f.time_base = (i if pts is None else pts[i]), time_base
            out.mux(stream.encode(f))
        out.mux(stream.encode())
        if sound is not None:
            t = np.arange(44100 * frames // 30) / 44100
            for a in range(0, len(t), 1024):
                block = (0.2 * np.sin(2 * np.pi * 440 * t[a : a + 1024])).astype(
                    np.float32
                )[None]
                f = av.AudioFrame.from_ndarray(block, format="fltp", layout="mono")
                f.rate, f.pts, f.time_base = 44100, a, Fraction(1, 44100)
                out.mux(sound.encode(f))
            out.mux(sound.encode())
    return path


def write_model(path: Path) -> Path:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.visual.vertex_colors = [200, 80, 40, 255]
    mesh.export(path)
    return path
