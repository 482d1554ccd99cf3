"""Chunks, or stretches of the analysis, to the workers of a cluster. Dask gives them out
to those that may work, and again where a worker is lost."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from arfx.core import interrupt
from arfx.errors import RenderError
from arfx.run.cluster import remote
from arfx.run.cluster.crew import Crew, check_connection, lost
from arfx.run.cluster.store import Store
from arfx.run.executors import Done, Results, Task
from arfx.run.folder import JobFolder

ROUND_S = 0.05
ARRIVE_S = 20.0  # until a file that a worker has written is seen here
START_S = 120.0  # for workers that were started here to be there
MOST = 4  # consecutive chunks at once: a worker reads on from one to the next


class Dispatch:
    """One run of tasks.

    own : whether workers that were started here run, or may yet; None = they are others'"""

    def __init__(
        self,
        client: Any,
        crew: Crew,
        job: remote.JobReference,
        store: Store | None,
        own: Callable[[], bool] | None,
        notice: Callable[[str], None],
    ) -> None:
        self._client, self.crew, self._job, self._store = client, crew, job, store
        self._own, self._notice = own, notice
        self._frames: dict[int, int] = {}  # done, by the first frame of a task
        self._worked, self._said_waiting = time.monotonic(), False

    def results(self, tasks: Sequence[Task], progress: Done, workers: int) -> Results:
        """workers : how many there may be

        Raises RenderError: a chunk that lost too many workers, no worker that may render,
        no scheduler; what a worker raises. On the way out all leave what they are at."""
        left = []
        for task in tasks:
            if self._store is not None and (file := self._taken(task)):
                yield self._done({"file": file, "first": task[2], "last": task[3]})
            else:
                left.append(task)
        size = min(max(len(left) // (2 * max(workers, 1)), 1), MOST)
        runs = [left[k : k + size] for k in range(0, len(left), size)]
        self._client.subscribe_topic(self._job.run, self._hear)
        waiting = {self._submit(run): run for run in runs}
        try:
            while waiting:
                self.crew.look()
                self._check_crew()
                for future in [f for f in waiting if f.done()]:
                    run = waiting.pop(future)
                    for task, result in zip(
                        run, self._result(future, run), strict=True
                    ):
                        self._await_file(task, result)
                        yield self._done(result)
                progress(sum([*self._frames.values()]))
                time.sleep(ROUND_S)
        finally:
            with interrupt.deferred(), contextlib.suppress(Exception):
                self._client.cancel([*waiting], force=True)
                self._client.unsubscribe_topic(self._job.run)

    def _submit(self, run: Sequence[Task]) -> Any:
        return self._client.submit(
            remote.work,
            self._job.run,
            [(first, last, Path(target).name) for _, _, first, last, target in run],
            resources={self._job.run: 1},
            pure=False,
        )

    def _result(self, future: Any, run: Sequence[Task]) -> Sequence[dict[str, Any]]:
        check_connection(self._client)
        if future.status == "cancelled":
            raise lost(self._client)
        try:
            results: Sequence[dict[str, Any]] = future.result()
            return results
        except Exception as e:
            if type(e).__name__ != "KilledWorker":
                raise
            raise RenderError(
                f"frames {run[0][2]}–{run[-1][3]}: too many workers were lost with them,"
                f" the last at {e.args[1].address}",
                "out of memory? --resume goes on; as many are allowed as Dask's"
                " distributed.scheduler.allowed-failures says",
            ) from None

    def _done(self, result: dict[str, Any]) -> dict[str, Any]:
        self._frames[result["first"]] = result["last"] - result["first"] + 1
        return result

    def _taken(self, task: Task) -> str | None:
        """The name of a task's file that was in the store, and is in the job folder now."""
        target = Path(task[-1])
        assert self._store is not None
        folder = JobFolder(target.parents[1])
        path = self._store.take(target.name, self._job.suffix, folder)
        return None if path is None else path.name

    def _await_file(self, task: Task, result: Mapping[str, Any]) -> None:
        """A shared disk may show a file later than the worker that wrote it."""
        folder, file, began = Path(task[-1]).parent, result["file"], time.monotonic()
        while not (folder / file).exists():
            if self._store is not None and self._taken(task):
                return
            if time.monotonic() - began > ARRIVE_S:
                raise RenderError(
                    f"a worker has written {file}, and it is not in {folder}",
                    "--map-path has to name the same folder on the workers",
                )
            time.sleep(ROUND_S)

    def _check_crew(self) -> None:
        if self.crew.slots:
            self._worked, self._said_waiting = time.monotonic(), False
            return
        self.crew.check()
        if self._own is not None:
            if not self._own() or time.monotonic() - self._worked > START_S:
                raise RenderError(
                    "no worker of the local cluster starts",
                    "--workers N renders without a cluster",
                )
        elif not self.crew.members and not self._said_waiting:
            self._notice("the cluster has no worker: waiting for one")
            self._said_waiting = True

    def _hear(self, event: tuple[float, Mapping[str, int]]) -> None:
        """How far a worker is, in the client's own thread."""
        _, said = event
        self._frames[said["first"]] = max(
            said["frames"], self._frames.get(said["first"], 0)
        )
