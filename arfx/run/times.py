"""What each piece of a job's work took, noted in timings.jsonl when it is done: a resumed job tells the time of all of it.

A row is {"work": "checkpoint" | "analysis" | "chunk", "key", "seconds", "walls", "rss_mb", …}. key : of what was made, so that
the time of work that is not in the output is left out;  walls : process of the job -> how long it had run by then, seconds.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from arfx.run.memory import peak_mb

CHECKPOINT, ANALYSIS, CHUNK = "checkpoint", "analysis", "chunk"


@dataclass(frozen=True)
class Spent:
    """The time of what is in an output.

    seconds, stages : by phase and by stage, over all chunks and the analysis
    untimed : keys of chunks that a process finished, but was killed before it noted their time
    wall_s : of all processes, each up to the last of its work that is in the output;  processes : how many of them
    """

    seconds: Mapping[str, float]
    stages: Mapping[str, float]
    untimed: tuple[str, ...]
    wall_s: float
    processes: int
    peak_rss_mb: float


@dataclass
class WorkLog:
    """timings.jsonl of a job folder. began : perf_counter at the start of this process's work on the job"""

    path: Path
    began: float = field(default_factory=time.perf_counter)
    process: str = field(default_factory=lambda: f"{time.time_ns():x}-{os.getpid()}")

    def rows(self) -> Iterator[dict[str, Any]]:
        """Every row, in order; a line that a kill or a full disk cut short, or that is damaged, is passed over."""
        if not self.path.exists():
            return
        with self.path.open(encoding="utf-8", errors="replace") as f:
            for line in f:
                try:
                    row = json.loads(line)
                except (ValueError, RecursionError):
                    continue
                if isinstance(row, dict) and _whole(row):
                    yield row

    def note(
        self, work: str, key: str, seconds: Mapping[str, float], walls: Mapping[str, float] | None = None, **more: Any
    ) -> None:
        """walls : of the earlier processes without whose work this would not be;  more["rss_mb"] : most memory of the process
        that did it, where that was another. Raises OSError."""
        here = {self.process: time.perf_counter() - self.began}
        peak = max(peak_mb(), more.pop("rss_mb", 0.0))
        row = {"work": work, "key": key, **more, "seconds": seconds, "walls": {**(walls or {}), **here}, "rss_mb": peak}
        with self.path.open("ab+") as f:
            end = f.seek(0, os.SEEK_END)
            if end:
                f.seek(end - 1)
            whole = not end or f.read(1) == b"\n"
            f.write(f"{'' if whole else chr(10)}{json.dumps(row)}\n".encode())

    def spent(self, analysis: str, chunks: Iterable[str]) -> Spent:
        """The time of the analysis and the chunks with these keys; of work done twice that of the last time."""
        last = {(row["work"], row["key"]): row for row in self.rows()}
        wanted = [(ANALYSIS, analysis), *((CHUNK, key) for key in chunks)]
        used = [last[w] for w in wanted if w in last]
        seconds: dict[str, float] = {}
        stages: dict[str, float] = {}
        walls = {self.process: time.perf_counter() - self.began}
        for row in used:
            for total, part in ((seconds, row["seconds"]), (stages, row.get("stages", {}))):
                for name, s in part.items():
                    total[name] = total.get(name, 0.0) + s
            for process, s in row["walls"].items():
                walls[process] = max(walls.get(process, 0.0), s)
        return Spent(
            seconds, stages, tuple(key for work, key in wanted if work == CHUNK and (work, key) not in last),
            sum(walls.values()), len(walls), max(peak_mb(), *(row["rss_mb"] for row in used), 0.0),
        )  # fmt: skip


def _whole(row: dict[str, Any]) -> bool:
    def numbers(values: Any) -> bool:
        return isinstance(values, dict) and all(isinstance(v, (int, float)) and abs(v) < 1e15 for v in values.values())

    texts = all(isinstance(row.get(name), str) for name in ("work", "key"))
    tables = all(numbers(row.get(name)) for name in ("seconds", "walls")) and numbers(row.get("stages", {}))
    return texts and tables and numbers({k: row.get(k, 0) for k in ("rss_mb", "frames")})


class AnalysisClock:
    """Passes the progress of the analysis on, and notes at every checkpoint what it took up to there.

    before_s, walls : time of the earlier processes whose checkpoint this one took up
    """

    def __init__(self, log: WorkLog, key: str, checkpoint: Path, progress: Callable[[str, int, int | None], None]) -> None:
        self.before_s = 0.0
        self.walls: Mapping[str, float] = {}
        self._log, self._key, self._checkpoint, self._progress = log, key, checkpoint, progress
        self._stamp = self._written()
        self._began = self._last = time.perf_counter()
        self._done = 0

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        if not self._done and self._stamp is not None:
            self._take_up(done)
        stamp = self._written()
        if stamp != self._stamp:  # written after the last call, before the next frame
            self._stamp = stamp
            seconds = {"analysis": self.before_s + self._last - self._began}
            self._log.note(CHECKPOINT, self._key, seconds, self.walls, frames=self._done)
        self._done, self._last = done, time.perf_counter()
        self._progress(phase, done, total)

    def _take_up(self, done: int) -> None:
        """The first frame beyond the checkpoint tells which one it was; `done` itself if nothing was beyond it."""
        noted = {row.get("frames"): row for row in self._log.rows() if (row["work"], row["key"]) == (CHECKPOINT, self._key)}
        row = noted.get(done - 1) or noted.get(done)
        if row is not None and "analysis" in row["seconds"]:
            self.before_s, self.walls = row["seconds"]["analysis"], row["walls"]

    def _written(self) -> int | None:
        try:
            return self._checkpoint.stat().st_mtime_ns
        except OSError:
            return None
