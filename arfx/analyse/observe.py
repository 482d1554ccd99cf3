"""What the frames of a part of a clip show, as rows of tables, each by an observer.

A part is observed as if nothing lay before it. `clip.py` says what the rows of all parts mean.
Cost per 720p frame: .5 to 2 ms with a marker tracked, about 3 ms without one. Memory: some
hundred bytes per frame and marker, no pixels but some small pictures."""

from collections.abc import Collection
from typing import Any

from arfx.analyse.job import PLANE, AnalysisFrame, AnalysisJob
from arfx.analyse.light.observe import LightReader, SnapshotTaker
from arfx.analyse.markers.search import MarkerSearch
from arfx.analyse.motion.flow import BackgroundMotion
from arfx.analyse.pose.at_rest import BackgroundFlow, RestCheck
from arfx.analyse.tables import T, Tables, rows_of


class Observation:
    """Feed the frames of a part of the clip, in order, to `step`. wanted : facts, by name
    (`Stage.facts`)
    frames : about how many the clip has: what is kept of some of them is spread over all

    An observer's `step` takes the next frame and the prints in it. Its `rows` are of any
    kinds, the first field is the frame's number."""

    def __init__(
        self, job: AnalysisJob, wanted: Collection[str] = (), frames: int = 0
    ) -> None:
        markers, lit = job.anchor != PLANE, {"light", "environment"} & {*wanted}
        self._search = MarkerSearch(job, "lens" in wanted) if markers else None
        self._others: list[Any] = []
        add = self._others.append
        if not markers and job.poses is None:
            add(RestCheck(frames))
        if markers and job.params.static == "auto":
            add(BackgroundFlow(frames))
        if markers and lit:
            add(LightReader(job))
        if lit:
            add(SnapshotTaker(frames))
        if "flow" in wanted:
            add(BackgroundMotion())

    def step(self, frame: AnalysisFrame) -> None:
        shown = [] if self._search is None else self._search.step(frame)
        for observer in self._others:
            observer.step(frame, shown)

    def rows(self) -> list[Any]:
        """Of all frames so far, of all kinds."""
        search = [] if self._search is None else self._search.rows
        return [*search, *(row for o in self._others for row in o.rows)]


class ClipRows:
    """Rows of all parts of a clip, by kind. They are kept by columns, which take a fraction
    of the rows' memory, and made when they are asked for."""

    def __init__(self) -> None:
        self._parts: list[tuple[Tables, int]] = []

    def add(self, tables: Tables, shift: int = 0) -> None:
        """Add what the next part showed. shift : to be added to its frames' numbers"""
        self._parts.append((tables, shift))

    def __getitem__(self, kind: type[T]) -> list[T]:
        return [r for part in self._parts for r in rows_of(part[0], kind, part[1])]
