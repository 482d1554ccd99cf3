"""The workers of a cluster, and what they do of one job: chunks, or stretches of the
analysis. Dask gives these out to workers that may work, and again where one is lost."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from arfx.core import interrupt
from arfx.errors import RenderError
from arfx.run.cluster import remote
from arfx.run.cluster.files import Store
from arfx.run.executors import Done, Results, Task

ROUND_S = 0.05
LOOK_S = 1.0  # between two looks at who is there
SILENT_S = 5.0  # a scheduler that says nothing for so long is gone
ARRIVE_S = 20.0  # until a file that a worker has written is seen here
MOST = 4  # consecutive chunks at once: a worker reads on from one to the next


@dataclass
class Pool:
    """The workers that may work for one job.

    here : this process's `environment`;  job : None = only that is compared
    notice : is told of workers that render nothing
    store : where files go that workers write, if not into the job folder
    threads, refused : by address; "" = it may work"""

    client: Any
    here: Mapping[str, str]
    job: remote.JobReference | None
    notice: Callable[[str], None]
    store: Store | None = None
    threads: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    looked: float = -LOOK_S

    def look(self) -> None:
        """See who is there, and ask who is new. Raises RenderError where the scheduler is
        gone."""
        self._check_connection()
        if time.monotonic() < self.looked + LOOK_S:
            return
        try:
            if self.looked < 0:  # that it imports this is no silence
                self.client.run_on_scheduler(remote.work, "", [])
            threads = self.client.nthreads(callback_timeout=SILENT_S)
            new = [*(threads.keys() - self.refused.keys())]
            answers = self.client.run(
                remote.examine, self.here, self.job, workers=new, on_error="return"
            )
        except (
            OSError,
            TimeoutError,
        ):  # distributed's errors of connections are both
            raise self._lost() from None
        self.looked = time.monotonic()
        known = dict(self.refused)
        for address, answer in answers.items():
            name, why = answer if isinstance(answer, tuple) else (address, "")
            if isinstance(answer, Exception):  # arfx is not there, or is another
                why = f"it does not answer as arfx does: {type(answer).__name__}: {answer}"
            if why and (self.job is None or self.job.rendering):
                self.notice(f"worker {name} gets no work: {why}")
            known[address] = why and f"{name}: {why}"
        self.threads = threads
        self.refused = {address: known[address] for address in threads}

    @property
    def slots(self) -> int:
        """Tasks at once, of the workers that may work."""
        return sum(self.threads[a] for a, why in self.refused.items() if not why)

    def refusal(self) -> str:
        """Why every worker that there is has been refused; "" where that is not so."""
        reasons = self.refused.values()
        return "; ".join(dict.fromkeys(reasons)) if all(reasons) else ""

    def check(self) -> None:
        """Raises RenderError where every worker that there is has been refused."""
        if why := self.refusal():
            raise RenderError(
                f"no worker may render: {why}",
                "the same arfx, Python and libraries on all machines; --map-path HERE=THERE"
                " where paths are others",
            )

    def results(self, tasks: Sequence[Task], progress: Done, workers: int) -> Results:
        """Have the tasks done. workers : how many there may be

        Raises RenderError: a chunk that lost too many workers, no worker that may render,
        no scheduler; what a worker raises. On the way out what has not begun is dropped."""
        done, size = 0, min(max(len(tasks) // (2 * max(workers, 1)), 1), MOST)
        runs = [tasks[k : k + size] for k in range(0, len(tasks), size)]
        waiting = {self._submit(run): run for run in runs}
        alone = False
        try:
            while waiting:
                self.look()
                self.check()
                if not (self.threads or alone):
                    self.notice("the cluster has no worker: waiting for one")
                alone = not self.threads
                for future in [f for f in waiting if f.done()]:
                    run = waiting.pop(future)
                    for task, result in zip(
                        run, self._result(future, run), strict=True
                    ):
                        self._collect(Path(task[-1]).with_name(result["file"]))
                        done += task[3] - task[2] + 1
                        yield result
                progress(done)
                time.sleep(ROUND_S)
        finally:
            with interrupt.deferred(), contextlib.suppress(Exception):
                self.client.cancel([*waiting], force=True)

    def _submit(self, run: Sequence[Task]) -> Any:
        assert self.job is not None
        return self.client.submit(
            remote.work,
            self.job.run,
            [(first, last, Path(target).name) for _, _, first, last, target in run],
            resources={self.job.run: 1},
            pure=False,
        )

    def _result(self, future: Any, run: Sequence[Task]) -> Sequence[dict[str, Any]]:
        self._check_connection()
        if future.status == "cancelled":
            raise self._lost()
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

    def _collect(self, file: Path) -> None:
        """Have a file that a worker has written in the job folder."""
        if self.store is not None:
            self.store.take(file)
        began = time.monotonic()
        while not file.exists():  # a shared disk may show it later
            if time.monotonic() - began > ARRIVE_S:
                raise RenderError(
                    f"a worker has written {file.name}, and it is not in {file.parent}",
                    "--map-path has to name the same folder on the workers",
                )
            time.sleep(ROUND_S)

    def _check_connection(self) -> None:
        if self.client.status != "running":
            raise self._lost()

    def _lost(self) -> RenderError:
        return RenderError(
            f"the connection to the scheduler at {self.client.scheduler.address} is lost",
            "what is done is kept; --resume goes on, with the same cluster or another",
        )
