"""The sequential pass over the clip: decode once, in order, and fold every frame into facts. Checkpointed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from arfx.analyse.folds import Analyser, Analysis, LightParams
from arfx.core import codec
from arfx.core.camera import Camera
from arfx.core.pose import Pose
from arfx.media.clip import ClipInfo
from arfx.media.frame import Frame
from arfx.media.frames import ClipReader
from arfx.run.ahead import Ahead
from arfx.run.folder import JobFolder, write_bytes
from arfx.run.span import Span

CHECKPOINT_S = 20.0  # at most this much analysis is lost to a kill, or as many times what it takes to write it down
Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Pass:
    """What the pass leaves behind. span : the frames to render;  truncated : a message where the file ends in damage"""

    analysis: Analysis
    span: Span
    truncated: str | None
    decode_s: float
    analyse_s: float


class FrameFold(Protocol):
    """A fold (analyse.fold) over frames as they are decoded. following : luma of the next frame, None at the end"""

    def step(
        self, index: int, time_s: float, luma: np.ndarray, picture: Frame, following: Callable[[], np.ndarray] | None
    ) -> None: ...

    def state(self) -> dict[str, Any]: ...

    def restore(self, state: dict[str, Any]) -> None: ...


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
    span, truncated, decode_s, analyse_s = read_clip(info, span_s, analyser, progress, folder, key)
    start = time.perf_counter()
    analysis = analyser.finish()
    analyse_s += time.perf_counter() - start
    progress("analyse", len(span.pts), len(span.pts))
    return Pass(analysis, span, truncated, decode_s, analyse_s)


def read_clip(
    info: ClipInfo, span_s: tuple[float | None, float | None], fold: FrameFold, progress: Progress,
    folder: JobFolder | None, key: str,
) -> tuple[Span, str | None, float, float]:  # fmt: skip
    """Feed the frames of span_s to the fold. (span, Pass.truncated, seconds of decoding, seconds in the fold)

    What was interrupted goes on from its checkpoint. All of the clip is decoded again even so: what a decoder makes of a
    frame, and when the frame is shown, may depend on any frame before it.
    Raises NothingToDoError if the span holds no frame.
    """
    span, fold_s, expected = Span(span_s, info.time_base), 0.0, info.frame_count_stated if span_s == (None, None) else None
    kept = None if folder is None else Checkpoint(folder.checkpoint, [key, type(fold).__name__])
    if kept is not None and (state := kept.read()) is not None:
        span.restore(state["span"])
        fold.restore(state["fold"])
    with ClipReader(info) as reader, Ahead(reader.frames()) as frames:
        for frame, following in _with_next(span.inside(frames)):
            start = time.perf_counter()
            after = None if following is None else following.luma
            fold.step(len(span.pts), frame.time_s, frame.luma(), frame, after)
            fold_s += time.perf_counter() - start
            span.take(frame)
            progress("analyse", len(span.pts), expected)
            if kept is not None and kept.due():
                kept.write({"span": span.state(), "fold": fold.state()})
        truncated, decode_s = reader.truncated, frames.seconds
    span.whole &= not truncated
    span.require_any(info.path)
    return span, truncated, decode_s, fold_s


class Checkpoint:
    """A file with the state of an unfinished pass. of : what the state must be of to be taken up again"""

    def __init__(self, path: Path, of: list[str]) -> None:
        self._path, self._of = path, of
        self._last, self._cost_s = time.monotonic(), 0.0

    def read(self) -> dict[str, Any] | None:
        """None where there is none, or one of something else, of another version, or damaged: the pass starts over."""
        try:
            saved = codec.loads(self._path.read_bytes())
        except (OSError, ValueError):
            return None
        right = isinstance(saved, dict) and saved.get("of") == self._of and isinstance(saved.get("state"), dict)
        return saved["state"] if right else None

    def due(self) -> bool:
        return time.monotonic() - self._last > CHECKPOINT_S * max(self._cost_s, 1.0)

    def write(self, state: dict[str, Any]) -> None:
        """Raises RenderError where the disk is full."""
        start = time.monotonic()
        write_bytes(self._path, codec.dumps({"of": self._of, "state": state}))
        self._last = time.monotonic()
        self._cost_s = self._last - start


def _with_next(frames: Iterator[Frame]) -> Iterator[tuple[Frame, Frame | None]]:
    """Each frame and the one after it."""
    frame = next(frames, None)
    while frame is not None:
        following = next(frames, None)
        yield frame, following
        frame = following
