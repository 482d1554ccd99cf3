"""A clip fed frame by frame, and its analysis: observation and meaning in one."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from arfx.analyse.clip import analyse
from arfx.analyse.job import Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.markers.search import MarkerSearch
from arfx.analyse.observe import Observation, Rows, add_rows
from arfx.analyse.tables import Tables


class Observed:
    """Feed frames to `step`, or the tables of parts to `add`, then call `finish`."""

    def __init__(self, job: AnalysisJob, wanted: Collection[str] = ()) -> None:
        self.job, self.wanted = job, wanted
        self._observation = Observation(job, wanted)
        self.rows: Rows = self._observation.rows

    @property
    def search(self) -> MarkerSearch:
        found = self._observation._search
        assert found is not None
        return found

    def step(self, frame: AnalysisFrame) -> None:
        self._observation.step(frame)

    def tables(self) -> Tables:
        return self._observation.tables()

    def add(self, tables: Tables, shift: int = 0) -> None:
        add_rows(self.rows, tables, shift)

    def finish(self, *span: Any) -> Analysis:
        return analyse(self.rows, self.job, self.wanted, *span)
