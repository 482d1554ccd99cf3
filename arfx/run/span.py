"""The frames of a clip between two times: which they are, and what of the clip lies around them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

from arfx.analyse.fold import Stateful
from arfx.errors import NothingToDoError
from arfx.media.frame import Frame

_ROUNDING_S = 1e-9


class Span(Stateful):
    """Seconds from the clip's first frame, ends included; None = no end.

    pts : presentation times of the frames that were taken, in the clip's time base: who takes a frame calls `take`
    keys : which of them decoding can begin at
    origin : of the clip's first frame;  before : frames of the clip before the span;  whole : it reaches to the clip's end
    """

    given = frozenset({"_start_s", "_end_s", "_time_base"})

    def __init__(self, span_s: tuple[float | None, float | None], time_base: Fraction) -> None:
        self._start_s, self._end_s = span_s
        self._time_base = time_base
        self.pts: list[int] = []
        self.keys: list[int] = []
        self.origin: int | None = None
        self.before, self.whole = 0, True

    def inside(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Those of the clip's `frames`, in order, that lie in the span and behind what was taken before."""
        last = self.pts[-1] if self.pts else None
        for frame in frames:
            if self.origin is None:
                self.origin = frame.pts
            if last is not None and frame.pts <= last:
                continue
            since_s = self._since_s(frame.pts)
            if self._start_s is not None and since_s < self._start_s - _ROUNDING_S:
                self.before += 1
                continue
            if self._end_s is not None and since_s > self._end_s + _ROUNDING_S:
                self.whole = False
                return
            last = frame.pts
            yield frame

    def take(self, frame: Frame) -> None:
        if frame.key:
            self.keys.append(len(self.pts))
        self.pts.append(frame.pts)

    def from_start_s(self) -> list[float]:
        """Seconds of the frames that were taken, from the clip's first frame."""
        return [self._since_s(t) for t in self.pts]

    def _since_s(self, pts: int) -> float:
        return float((pts - (self.origin or 0)) * self._time_base)

    def require_any(self, path: Path) -> None:
        """Raises NothingToDoError where no frame was taken."""
        if not self.pts:
            end = "its end" if self._end_s is None else f"{self._end_s:g} s"
            raise NothingToDoError(
                f"{path} has no frame between {self._start_s or 0:g} s and {end}",
                "check --start and --end; `arfx inspect` shows the clip's length",
            )
