"""A clip fed frame by frame, and its analysis: observation and meaning in one."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from arfx.analyse.clip import analyse
from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.markers.search import MarkerSearch
from arfx.analyse.observe import ClipRows, Observation
from arfx.analyse.tables import Tables, tables_of


class Observed:
    """Feed frames to `step`, or the tables of parts to `add`, then call `finish`."""

    def __init__(
        self, job: AnalysisJob, wanted: Collection[str] = (), frames: int = 0
    ) -> None:
        self.job, self.wanted = job, wanted
        self.observation = Observation(job, wanted, frames)
        self._before: list[tuple[Tables, int]] = []

    @property
    def search(self) -> MarkerSearch:
        found = self.observation._search
        assert found is not None
        return found

    def step(self, frame: AnalysisFrame) -> None:
        self.observation.step(frame)

    def tables(self) -> Tables:
        return tables_of(self.observation.rows())

    def add(self, tables: Tables, shift: int = 0) -> None:
        self._before.append((tables, shift))

    @property
    def rows(self) -> ClipRows:
        """Of the parts that were added, and behind them of the frames."""
        rows = ClipRows()
        for tables, shift in (*self._before, (self.tables(), 0)):
            rows.add(tables, shift)
        return rows

    def finish(self, *span: Any) -> Analysis:
        return analyse(self.rows, self.job, self.wanted, *span)
