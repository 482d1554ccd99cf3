"""Writes a synthetic clip, H.264 in MP4 or lossless FFV1 in Matroska, with exact times,
tags, rotation and tone; and its depth.

Written apart from arfx.media, so that a mistake there cannot cancel out. BT.709, limited
range, sRGB curve; the chroma of 4:2:0 is sited left (MPEG-2), as H.264 players expect."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy import ndarray

from arfx.core.colour import yuv_from_rgb
from arfx.media.codecs import create_container
from arfx.synth.description import SceneFile
from arfx.synth.truth import DEPTH_UNIT_M

CLOCK_HZ = 90_000
_STEP = (
    0.05  # of the distance: surfaces that are farther apart have an edge between them
)
_HOLE_PX = 4.0  # sigma of the noise whose highest parts are holes


class VideoFile:
    """A file with one video stream of exact times, whole when it is closed."""

    def __init__(
        self,
        path: Path,
        scene: SceneFile,
        codec: str,
        size: tuple[int, int],
        pix_fmt: str,
    ) -> None:
        self._scene = scene
        exact = {"movie_timescale": str(CLOCK_HZ)} if path.suffix == ".mp4" else {}
        self._out = create_container(path, options=exact)
        stream = self._out.add_stream(
            codec, rate=Fraction(scene.clip.fps).limit_denominator(1001)
        )
        stream.width, stream.height = size
        stream.pix_fmt = pix_fmt
        stream.time_base = stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
        self._stream = stream

    def put(self, samples: ndarray, time_s: float) -> None:
        """samples : as `av.VideoFrame.from_ndarray` takes them;  time_s : as it is to be shown"""
        frame = av.VideoFrame.from_ndarray(samples, format=self._stream.pix_fmt)
        if self._stream.pix_fmt.startswith("yuv"):
            _tag(frame)
        frame.pts, frame.time_base = round(time_s * CLOCK_HZ), Fraction(1, CLOCK_HZ)
        self._out.mux(self._stream.encode(frame))

    def close(self) -> None:
        self._out.mux(self._stream.encode(None))
        self._out.close()


class ClipFile(VideoFile):
    """A clip being written."""

    def __init__(self, path: Path, scene: SceneFile) -> None:
        clip = scene.clip
        size = clip.width, clip.height
        lossless = path.suffix == ".mkv"
        whole = lossless or any(side % 2 for side in size)
        super().__init__(
            path,
            scene,
            "ffv1" if lossless else "libx264",
            size[::-1] if clip.rotation_deg in (90, 270) else size,
            "yuv444p" if whole else "yuv420p",
        )
        context = self._stream.codec_context
        _tag(context)
        if not lossless:
            # Without macroblock trees: with them x264 gives several different streams of
            # the same frames, one thread or not.
            context.options = {
                "crf": f"{clip.crf:g}",
                "preset": "fast",
                "x264-params": "mbtree=0",
            }
            context.thread_count = 1  # another number of threads gives another stream
        if clip.rotation_deg:
            self._stream.set_display_rotation(clip.rotation_deg)
        self._tone: Any = None
        if clip.tone_hz:
            sound = "flac" if lossless else "aac"
            self._tone = self._out.add_stream(sound, rate=48_000)

    def write(self, coded: ndarray, time_s: float) -> None:
        """coded (h, w, 3) float R'G'B' 0..1, upright;  time_s from the clip's first frame."""
        turned = np.rot90(coded, -self._scene.clip.rotation_deg // 90)
        matrix = yuv_from_rgb("bt709").astype(np.float32)
        yuv = cv2.transform(np.ascontiguousarray(turned), matrix)
        luma, chroma = 16 + 219 * yuv[..., 0], 128 + 224 * yuv[..., 1:]
        shape: tuple[int, ...] = 3, *luma.shape
        if self._stream.pix_fmt == "yuv420p":
            across = np.array([[0.25, 0.5, 0.25]])
            wide = cv2.filter2D(chroma, -1, across, borderType=cv2.BORDER_REPLICATE)
            wide = wide[:, ::2]
            chroma = (wide[::2] + wide[1::2]) / 2
            shape = luma.shape[0] * 3 // 2, luma.shape[1]
        planes = [p.ravel() for p in (luma, *np.moveaxis(chroma, -1, 0))]
        samples = np.clip(np.rint(np.concatenate(planes)), 0, 255)
        self.put(
            samples.astype(np.uint8).reshape(shape), self._scene.clip.start_s + time_s
        )

    def close(self) -> None:
        scene = self._scene
        if self._tone is not None:
            samples = np.arange(int(48_000 * scene.frames / scene.clip.fps))
            turns = (scene.clip.tone_hz or 0) * samples / 48_000
            wave = (0.2 * np.sin(2 * np.pi * turns)).astype(np.float32)
            frame = av.AudioFrame.from_ndarray(wave[None], "fltp", "mono")
            frame.sample_rate, frame.time_base = 48_000, Fraction(1, 48_000)
            frame.pts = round(scene.clip.start_s * 48_000)
            # the encoder cuts it and turns it into what it takes
            for part in (frame, None):
                self._out.mux(self._tone.encode(part))
        super().close()


def _tag(what: Any) -> None:
    """Limited range, BT.709, sRGB curve: on a codec context or a frame."""
    what.color_range = what.colorspace = what.color_primaries = 1
    what.color_trc = 13


def measured_steps(scene: SceneFile, depth_m: ndarray, frame: int) -> ndarray:
    """(h, w) uint16, in DEPTH_UNIT_M, 0 = not measured.
    depth_m : (h, w) true metres, 0 = nothing;  frame : gives, with the scene's seed, the noise
    """
    asked = scene.depth
    rng = np.random.default_rng([scene.seed, 16, frame])
    steps = np.rint(
        depth_m
        * (1 + asked.noise * rng.standard_normal(depth_m.shape))
        / DEPTH_UNIT_M
    )
    good = (depth_m > 0) & (steps > 0) & (steps < np.iinfo(np.uint16).max)
    if asked.edge_px > 0:
        box = np.ones((2 * asked.edge_px + 1,) * 2, np.uint8)
        good &= cv2.dilate(depth_m, box) <= (1 + _STEP) * cv2.erode(depth_m, box)
    if asked.holes > 0:
        rough = cv2.GaussianBlur(rng.standard_normal(depth_m.shape), (0, 0), _HOLE_PX)
        good &= rough < np.quantile(rough, 1 - asked.holes)
    return np.where(good, steps, 0).astype(np.uint16)
