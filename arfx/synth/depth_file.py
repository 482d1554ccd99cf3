"""Writes what a depth camera beside the clip's would have measured: one file of 16-bit maps, a video or a TIFF of many pages.

True distance along the axis, upright as the clip is shown, of the clip's size and at its times, with what such cameras add:
noise in proportion to the distance, nothing beside edges of things, and holes.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np

from arfx.errors import RenderError
from arfx.media.containers import create
from arfx.synth.description import SceneFile
from arfx.synth.encode import CLOCK_HZ
from arfx.synth.truth import DEPTH_UNIT_M

_STEP = 0.05  # of the distance: surfaces that are farther apart have an edge between them
_HOLE_PX = 4.0  # sigma of the noise whose highest parts are holes


def measured_steps(scene: SceneFile, depth_m: np.ndarray, frame: int) -> np.ndarray:
    """(h, w) uint16, in DEPTH_UNIT_M, 0 = not measured.

    depth_m : (h, w) true metres, 0 = nothing;  frame : gives, with the scene's seed, the noise
    """
    asked = scene.depth
    rng = np.random.default_rng([scene.seed, 16, frame])
    steps = np.rint(depth_m * (1 + asked.noise * rng.standard_normal(depth_m.shape)) / DEPTH_UNIT_M)
    good = (depth_m > 0) & (steps > 0) & (steps < np.iinfo(np.uint16).max)
    if asked.edge_px > 0:
        box = np.ones((2 * asked.edge_px + 1,) * 2, np.uint8)
        good &= cv2.dilate(depth_m, box) <= (1 + _STEP) * cv2.erode(depth_m, box)
    if asked.holes > 0:
        rough = cv2.GaussianBlur(rng.standard_normal(depth_m.shape), (0, 0), _HOLE_PX)
        good &= rough < np.quantile(rough, 1 - asked.holes)
    return np.where(good, steps, 0).astype(np.uint16)


class DepthFile:
    """The file being written; use as a context manager. .mkv: FFV1 gray16 with the clip's times; .tiff: pages."""

    def __init__(self, path: Path, scene: SceneFile) -> None:
        self._path, self._scene = path, scene
        self._pages: list[np.ndarray] = []
        self._out: av.container.OutputContainer | None = None
        if path.suffix == ".mkv":
            try:
                self._out = create(path)
            except OSError as e:
                raise RenderError(f"cannot write {path}: {e.strerror or e}") from None
            self._stream = self._out.add_stream("ffv1", rate=Fraction(scene.clip.fps).limit_denominator(1001))
            self._stream.width, self._stream.height = scene.clip.width, scene.clip.height
            self._stream.pix_fmt = "gray16le"
            self._stream.time_base = self._stream.codec_context.time_base = Fraction(1, CLOCK_HZ)

    def __enter__(self) -> DepthFile:
        return self

    def write(self, depth_m: np.ndarray, frame: int, time_s: float) -> None:
        """depth_m (h, w) true metres, 0 = nothing;  time_s from the clip's first frame."""
        steps = measured_steps(self._scene, depth_m, frame)
        if self._out is None:
            self._pages.append(steps)
            return
        picture = av.VideoFrame.from_ndarray(steps, format="gray16le")
        picture.pts, picture.time_base = round(time_s * CLOCK_HZ), Fraction(1, CLOCK_HZ)
        self._out.mux(self._stream.encode(picture))

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._out is not None:
            if kind is None:
                self._out.mux(self._stream.encode(None))
            self._out.close()
        elif kind is None and not cv2.imwritemulti(str(self._path), self._pages):
            raise RenderError(f"cannot write {self._path}")
