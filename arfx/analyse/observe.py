"""What the frames of a part of a clip show, as rows of tables, each by an observer.

A part is observed as if nothing lay before it. `clip.py` says what the rows of all parts mean.
Cost per 720p frame: .5 to 2 ms with a marker tracked, about 3 ms without one. Memory: some
hundred bytes per frame and marker, no pixels but some small pictures."""

from collections.abc import Collection
from typing import Any

from arfx.analyse.job import PLANE, AnalysisFrame, AnalysisJob
from arfx.analyse.lens import SideReader
from arfx.analyse.light.observe import LightReader, SnapshotTaker
from arfx.analyse.markers.search import MarkerSearch
from arfx.analyse.motion.flow import BackgroundMotion
from arfx.analyse.pose.at_rest import BackgroundFlow, RestCheck
from arfx.analyse.tables import Tables, by_columns, rows_of

KINDS: dict[str, type] = {
    table: kind
    for observer in (
        *(MarkerSearch, BackgroundFlow, RestCheck),
        *(LightReader, SnapshotTaker, BackgroundMotion, SideReader),
    )
    for table, kind in observer.tables.items()
}


class Observation:
    """Feed the frames of a part of the clip, in order, to `step`. wanted : facts, by name
    (`Stage.facts`)

    An observer's `step` takes the next frame and the prints in it. `tables` are its
    attributes that are lists of rows, and the rows' class, whose first field is the frame's
    number.

    Raises ConfigError for no marker, the same one twice, or a map that lacks one."""

    def __init__(self, job: AnalysisJob, wanted: Collection[str] = ()) -> None:
        markers, lit = job.anchor != PLANE, {"light", "environment"} & {*wanted}
        self._search = MarkerSearch(job) if markers else None
        self._others: list[Any] = []
        add = self._others.append
        if not markers and job.poses is None:
            add(RestCheck())
        if markers and job.params.static == "auto":
            add(BackgroundFlow(job.frames))
        if markers and lit:
            add(LightReader(job))
        if lit:
            add(SnapshotTaker(job.frames))
        if "flow" in wanted:
            add(BackgroundMotion())
        if markers and "lens" in wanted:
            add(SideReader())

    def step(self, frame: AnalysisFrame) -> None:
        """Raises InputError for another size or order."""
        shown = [] if self._search is None else self._search.step(frame)
        for observer in self._others:
            observer.step(frame, shown)

    def tables(self) -> Tables:
        """The rows of all frames so far by columns, as files keep them."""
        every: list[Any] = [o for o in (self._search, *self._others) if o is not None]
        return {
            table: by_columns(getattr(observer, table), kind)
            for observer in every
            for table, kind in observer.tables.items()
        }


class ClipRows:
    """Rows of all parts of a clip, by table. They are kept by columns, which take a fraction
    of the rows' memory, and made when they are asked for."""

    def __init__(self) -> None:
        self._parts: list[tuple[Tables, int]] = []

    def add(self, tables: Tables, shift: int = 0) -> None:
        """Add what the next part showed. shift : to be added to its frames' numbers"""
        self._parts.append((tables, shift))

    def __getitem__(self, table: str) -> list[Any]:
        kind = KINDS[table]
        return [
            row
            for tables, shift in self._parts
            if table in tables
            for row in rows_of(tables[table], kind, shift)
        ]
