"""What each piece of a job's work took, recorded in timings.jsonl when it is done: a
resumed job reports the time of all of it.
"""

import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from arfx.core.compiled import work_clock
from arfx.run.folder import append_line, read_lines
from arfx.run.memory import peak_mb

ANALYSIS, STRETCH, CHUNK = "analysis", "stretch", "chunk"


class _Row(BaseModel):
    """A line of timings.jsonl.

    work : ANALYSIS (of all stretches, joined), STRETCH or CHUNK;  key : of what was made,
    so that the time of work that is not in the output is left out
    walls : process of the job -> how long it had run by then, seconds
    worker, host, first, last : of a chunk and of a stretch;  stretches : keys of an
    analysis's"""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    work: str
    key: str
    rss_mb: float
    seconds: dict[str, float]
    walls: dict[str, float]
    stages: dict[str, float] = {}
    worker: str = ""
    host: str = ""
    first: int = 0
    last: int = 0
    stretches: list[str] = []


@dataclass(frozen=True)
class TimeSpent:
    """The time of what is in an output.

    seconds, stages : by phase and by stage, over all chunks and the analysis
    untimed : keys of chunks that a process finished, but was killed before it recorded their time
    wall_s : of all processes, each up to the last of its work that is in the output;
    processes : how many of them
    workers : {name, host, stretches, chunks, frames, seconds} of each thread or process
    that had a share
        frames : rendered;  seconds : of its stretches' and chunks' work"""

    seconds: Mapping[str, float]
    stages: Mapping[str, float]
    untimed: tuple[str, ...]
    wall_s: float
    processes: int
    peak_rss_mb: float
    workers: tuple[dict[str, Any], ...]


@dataclass
class WorkLog:
    """timings.jsonl of a job folder.

    began : `work_clock` at the start of this process's work on the job
    """

    path: Path
    began: float = field(default_factory=work_clock)
    process: str = field(default_factory=lambda: f"{time.time_ns():x}-{os.getpid()}")

    def rows(self) -> Iterator[dict[str, Any]]:
        """Every row, in order; what is damaged is skipped."""
        for row in read_lines(self.path):
            try:
                _Row.model_validate(row)
            except ValidationError:
                continue
            yield row

    def _walls(self) -> dict[str, float]:
        return {self.process: work_clock() - self.began}

    def note(
        self, work: str, key: str, seconds: Mapping[str, float], **more: Any
    ) -> None:
        """more["rss_mb"] : peak memory of the process that did it, where that was another.

        Raises OSError."""
        row = {
            "work": work,
            "key": key,
            "rss_mb": peak_mb(),
            **more,
            "seconds": seconds,
            "walls": self._walls(),
        }
        append_line(self.path, row)

    def spent(self, analysis: str, chunks: Iterable[str]) -> TimeSpent:
        """The time of the analysis and the chunks with these keys; of work done twice that
        of the last time.
        """
        last = {(row["work"], row["key"]): row for row in self.rows()}
        stretches = last.get((ANALYSIS, analysis), {}).get("stretches", ())
        names = list(chunks)
        wanted = [(STRETCH, name) for name in stretches]
        wanted += [(ANALYSIS, analysis), *((CHUNK, name) for name in names)]
        used = [last[w] for w in wanted if w in last]
        seconds: Any = Counter()
        stages: Any = Counter()
        walls = self._walls()
        for row in used:
            seconds.update(row["seconds"])
            stages.update(row.get("stages", {}))
            for process, s in row["walls"].items():
                walls[process] = max(walls.get(process, 0.0), s)
        return TimeSpent(
            seconds,
            stages,
            tuple(name for name in names if (CHUNK, name) not in last),
            sum(walls.values()),
            len(walls),
            max(peak_mb(), *(row["rss_mb"] for row in used), 0.0),
            _workers(used),
        )


def _workers(rows: Iterable[Mapping[str, Any]]) -> tuple[dict[str, Any], ...]:
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        if not {"worker", "host", "first", "last"} <= row.keys():
            continue
        who = {"name": row["worker"], "host": row["host"]}
        worker = found.setdefault(
            (row["worker"], row["host"]),
            who | {"stretches": 0, "chunks": 0, "frames": 0, "seconds": 0.0},
        )
        if row["work"] == STRETCH:
            worker["stretches"] += 1
        else:
            worker["chunks"] += 1
            worker["frames"] += row["last"] - row["first"] + 1
        worker["seconds"] += sum(row["seconds"].values())
        worker["seconds"] += sum(row.get("stages", {}).values())
    return tuple(found.values())
