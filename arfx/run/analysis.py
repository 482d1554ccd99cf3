"""The sequential pass over the clip: decode once, in order, and fold every frame into facts. Checkpointed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from arfx.analyse.analyser import Analyser, Analysis, LightParams
from arfx.core.camera import Camera
from arfx.core.pose import Pose
from arfx.media.clip import ClipInfo
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.run.ahead import Ahead
from arfx.run.folder import JobFolder, write_text
from arfx.run.span import Span

CHECKPOINT_S = 20.0  # at most this much analysis is lost to a kill
Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Pass:
    """What the pass leaves behind. span : the frames to render;  truncated : a message where the file ends in damage"""

    analysis: Analysis
    span: Span
    truncated: str | None
    decode_s: float
    analyse_s: float


def analyse_clip(
    info: ClipInfo,
    camera: Camera,
    markers: tuple[Any, ...],
    params: Any,
    marker_map: Mapping[str, Pose] | None,
    span_s: tuple[float | None, float | None],
    progress: Progress,
    folder: JobFolder | None = None,
    key: str = "",
    light: LightParams | None = None,
    panorama: np.ndarray | None = None,
    folds: frozenset[str] = frozenset(),
) -> Pass:
    """Analyse the frames of span_s (seconds from the clip's first frame, ends included).

    light, panorama, folds : as in Analyser
    folder, key : where the state is checkpointed and what it must match to be taken up again
    Raises NothingToDoError if the span holds no frame or no marker is seen.
    """
    analyser = Analyser(markers, camera, params, marker_map, light, panorama, folds)
    span = Span(span_s, info.time_base)
    if folder is not None and (saved := _saved(folder, key)):
        analyser.restore(saved["state"])
        span.pts, span.keys = saved["pts"], saved["keys"]
        span.origin, span.before = saved["origin"], saved["before"]
    pts = span.pts
    analyse_s = 0.0
    last_save = time.monotonic()
    expected = info.frame_count_stated if span_s == (None, None) else None
    with ClipReader(info) as reader, Ahead(reader.frames(first_pts=pts[-1] if pts else None)) as frames:
        for frame, following in _with_next(span.inside(frames)):
            start = time.perf_counter()
            analyser.step(len(pts), frame.time_s, frame.luma(), frame, None if following is None else following.luma)
            analyse_s += time.perf_counter() - start
            span.take(frame)
            progress("analyse", len(pts), expected)
            if folder is not None and time.monotonic() - last_save > CHECKPOINT_S:
                saved = {
                    "key": key, "pts": pts, "keys": span.keys, "origin": span.origin, "before": span.before,
                    "state": analyser.state(),
                }  # fmt: skip
                write_text(folder.checkpoint, json.dumps(saved))
                last_save = time.monotonic()
        truncated, decode_s = reader.truncated, frames.seconds
    span.whole &= not truncated
    span.require_any(info.path)
    start = time.perf_counter()
    analysis = analyser.finish()
    analyse_s += time.perf_counter() - start
    progress("analyse", len(pts), len(pts))
    return Pass(analysis, span, truncated, decode_s, analyse_s)


def _with_next(frames: Iterator[Frame]) -> Iterator[tuple[Frame, Frame | None]]:
    """Each frame and the one after it."""
    frame = next(frames, None)
    while frame is not None:
        following = next(frames, None)
        yield frame, following
        frame = following


def _saved(folder: JobFolder, key: str) -> dict[str, Any] | None:
    try:
        saved = json.loads(folder.checkpoint.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None  # no checkpoint, or one cut short before renames were atomic on this disk: start over
    return saved if saved.get("key") == key else None
