"""Small clips made in the tests: moving texture with colour, any times, any codec."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np


def pattern(i: int, width: int, height: int) -> np.ndarray:
    """(h, w, 3) uint8: smooth colour with a moving block; different for each i."""
    y, x = np.mgrid[:height, :width]
    a = np.stack(
        [
            x * 200 / width + 20,
            y * 200 / height + 20,
            128 + 80 * np.sin((x + y + 3 * i) / 9),
        ],
        -1,
    )
    a[4:14, (5 * i) % max(width - 12, 1) :][:, :10] = [220, 40, 30]
    return a.astype(np.uint8)


def make_clip(
    path: Path, pts: list[int], *, width: int = 96, height: int = 64, codec: str = "libx264", pix_fmt: str = "yuv420p",
    time_base: Fraction = Fraction(1, 15360), rotation: int | None = None, full_range: bool | None = None, matrix: int = 2,
    audio: bool = False, options: dict[str, str] | None = None, container: dict[str, str] | None = None,
) -> Path:  # fmt: skip
    """Writes a clip with the given presentation times; `audio` adds an AAC tone as long as
    the clip.
    """
    options = (
        {"crf": "12", "bf": "3", "g": "12", "mbtree": "0"}
        if options is None and codec == "libx264"
        else options or {}
    )
    held = (
        {"movie_timescale": "15360", "movflags": "faststart"}
        if path.suffix in (".mp4", ".mov")
        else {}
    )
    with av.open(
        str(path), "w", container_options={**held, **(container or {})}
    ) as out:
        s = out.add_stream(codec, rate=30, options=options)
        s.width, s.height, s.pix_fmt = width, height, pix_fmt
        s.time_base = s.codec_context.time_base = time_base
        s.codec_context.colorspace = matrix
        if full_range is not None:
            s.codec_context.color_range = 2 if full_range else 1
        if rotation is not None:
            s.set_display_rotation(rotation)
        tone = out.add_stream("aac", rate=48000) if audio else None
        if tone is not None:
            samples = int(float((pts[-1] - pts[0]) * time_base) * 48000) + 2048
            wave = (np.sin(np.arange(samples) * 0.05) * 0.3).astype(np.float32)
            for k in range(0, samples - 1023, 1024):
                f = av.AudioFrame.from_ndarray(
                    np.tile(wave[k : k + 1024], (2, 1)),
                    format="fltp",
                    layout="stereo",
                )
                f.sample_rate, f.pts, f.time_base = (
                    48000,
                    k + int(float(pts[0] * time_base) * 48000),
                    Fraction(1, 48000),
                )
                out.mux(tone.encode(f))
            out.mux(tone.encode(None))
        for i, t in enumerate(pts):
            f = av.VideoFrame.from_ndarray(pattern(i, width, height), format="rgb24")
            f = f.reformat(
                format=pix_fmt,
                dst_colorspace={1: "ITU709", 6: "ITU601"}.get(matrix),
                dst_color_range=2 if full_range else 1,
            )
            f.pts, f.time_base = t, time_base
            out.mux(s.encode(f))
        out.mux(s.encode(None))
    return path


def packets(path: Path, kind: str) -> list[tuple[bytes, Fraction]]:
    """(payload, presentation time) of all packets of the first stream of a kind."""
    with av.open(str(path)) as c:
        s = next(s for s in c.streams if s.type == kind)
        return [(bytes(p), p.pts * p.time_base) for p in c.demux(s) if p.size]
