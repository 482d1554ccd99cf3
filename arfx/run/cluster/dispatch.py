"""Chunks to the workers of a cluster, one at a time for each of their threads: consecutive
ones where that is possible.

What a worker that is lost was at is rendered by others, unless its file is there already.
When nothing waits any more, a chunk that takes far longer than others is rendered twice:
files appear when they are whole, so whoever is first wins. Stretches of the analysis are
given out in the same way; all that is said here of chunks is so for them."""

from __future__ import annotations

import bisect
import contextlib
import itertools
import math
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from arfx.core import interrupt
from arfx.errors import RenderError
from arfx.run.cluster import remote
from arfx.run.cluster.crew import Crew, Member, SchedulerLostError, scheduler_says, submit
from arfx.run.cluster.store import Store
from arfx.run.executors import Results, Task
from arfx.run.folder import JobFolder
from arfx.run.schedule import find_chunk, next_chunk

ROUND_S = 0.05
SLOW, SLOW_S = (
    3.0,
    2.0,
)  # a chunk is rendered twice after so many times the others' median, and at least so long
ARRIVE_S = 20.0  # until a file that a worker has written is seen here
LEAVE_S = 3.0  # for workers to leave what they are at
START_S = 120.0  # for workers that were started here to be there


@dataclass
class _Attempt:
    """chunk : number of the task;  worker : address;  frames : done;  result : when it has
    come;  ended : when that was due
    """

    chunk: int
    worker: str
    future: Any
    began: float = field(default_factory=time.monotonic)
    frames: int = 0
    result: dict[str, Any] | None = None
    ended: float = math.inf


class Dispatch:
    """One run of tasks.

    suffix : of their files, None = stretches, whose files are the targets themselves;
    most_lost : workers that a chunk may lose
    own : whether workers that were started here run, or may yet; None = they are others'"""

    def __init__(
        self,
        client: Any,
        crew: Crew,
        tasks: Sequence[Task],
        run: str,
        suffix: str | None,
        store: Store | None,
        most_lost: int,
        own: Callable[[], bool] | None,
        notice: Callable[[str], None],
    ) -> None:
        self._client, self._crew, self._tasks, self._run = client, crew, tasks, run
        self._suffix, self._store, self._most_lost, self._own, self._notice = (
            suffix,
            store,
            most_lost,
            own,
            notice,
        )
        self._targets = [Path(target) for *_, target in tasks]
        self._frames = [last - first + 1 for _, _, first, last, _ in tasks]
        self._waiting = [*range(len(tasks))]
        self._done: set[int] = set()
        self._attempts: dict[str, _Attempt] = {}
        self._leaving: dict[
            str, str
        ] = {}  # attempts that nobody wants any more, and the address of their worker
        self._lost: dict[
            int, list[str]
        ] = {}  # names of the workers that were lost with a chunk
        self._s_per_frame: list[float] = []  # of finished chunks
        self._count = itertools.count()
        self._worked = time.monotonic()  # when there was a worker last
        self._said_waiting = False

    def results(self, progress: Callable[[int], None]) -> Results:
        """Raises RenderError: a chunk that lost too many workers, no worker that may
        render, no scheduler; what a worker raises.

        On the way out all of them leave what they are at."""
        self._client.subscribe_topic(self._run, self._event)
        try:
            yield from self._in_store()
            while len(self._done) < len(self._tasks):
                for address, member in self._crew.look().items():
                    yield from self._lose(address, member.name)
                self._check_lost()
                self._check_crew()
                self._give()
                self._give_twice()
                for token in [
                    t for t, a in self._attempts.items() if a.result or a.future.done()
                ]:
                    if (
                        token in self._attempts
                    ):  # no other has finished the same chunk meanwhile
                        for result in self._finish(token):
                            self._give()  # whoever takes the result may be long about it
                            yield result
                progress(self._frames_done())
                time.sleep(ROUND_S)
        except SchedulerLostError:
            self._attempts.clear()  # nobody would hear that they are to be left
            raise
        finally:
            with interrupt.deferred():
                self._leave()

    def _in_store(self) -> Results:
        """What an earlier run has left there."""
        for chunk in [*self._waiting] if self._store is not None else ():
            if path := self._find(chunk):
                self._waiting.remove(chunk)
                yield self._found(chunk, path)

    def _find(self, chunk: int) -> Path | None:
        """The chunk's file, whole, wherever it lies; in the job folder afterwards."""
        target = self._targets[chunk]
        if self._suffix is not None:
            found = find_chunk(target.parent, target.name, self._suffix)
        else:
            found = target if target.exists() else None
        if found is None and self._store is not None:
            found = self._store.take(
                target.name, self._suffix, JobFolder(target.parents[1])
            )
        return found

    def _found(self, chunk: int, path: Path) -> dict[str, Any]:
        self._done.add(chunk)
        _, _, first, last, _ = self._tasks[chunk]
        return {"file": path.name, "first": first, "last": last}

    def _check_crew(self) -> None:
        members = self._crew.members.values()
        if not self._attempts:
            self._crew.check()
        if self._attempts or any(m.ready for m in members):
            self._worked, self._said_waiting = time.monotonic(), False
        elif self._own is not None and (
            not self._own() or time.monotonic() - self._worked > START_S
        ):
            raise RenderError(
                "no worker of the local cluster starts",
                "--workers N renders without a cluster",
            )
        elif not members and not self._said_waiting and self._own is None:
            self._notice("the cluster has no worker: waiting for one")
            self._said_waiting = True

    def _idle(self) -> Iterator[tuple[str, Member]]:
        """Workers with a free slot, once for each."""
        busy = Counter(a.worker for a in self._attempts.values())
        for address, member in self._crew.members.items():
            if member.ready:
                yield from [(address, member)] * (member.slots - busy[address])

    def _give(self) -> None:
        for address, member in [*self._idle()]:
            if not self._waiting:
                return
            others = {m.reads_on for m in self._crew.members.values() if m is not member}
            chunk = next_chunk(self._waiting, member.reads_on, others)
            self._waiting.remove(chunk)
            self._submit(chunk, address, member)

    def _submit(self, chunk: int, address: str, member: Member) -> None:
        _, _, first, last, _ = self._tasks[chunk]
        name = self._targets[chunk].name
        token = f"{self._run}-{next(self._count)}-{name}"
        member.reads_on = chunk + 1
        future = submit(
            self._client, address, remote.work, self._run, first, last, name, key=token
        )
        self._attempts[token] = _Attempt(chunk, address, future)

    def _give_twice(self) -> None:
        """Chunks of stragglers to others that are idle."""
        if self._waiting or not self._s_per_frame:
            return
        usual, now, tried = (
            statistics.median(self._s_per_frame),
            time.monotonic(),
            self._tried(),
        )
        for a in sorted(self._attempts.values(), key=lambda a: a.began):
            if tried[a.chunk] == 1 and now - a.began > max(
                SLOW_S, SLOW * usual * self._frames[a.chunk]
            ):
                other = next(
                    ((address, m) for address, m in self._idle() if address != a.worker),
                    None,
                )
                if other is None:
                    return
                self._submit(a.chunk, *other)

    def _tried(self) -> Mapping[int, int]:
        return Counter(a.chunk for a in self._attempts.values())

    def _finish(self, token: str) -> Results:
        """What has become of an attempt that is over."""
        attempt = self._attempts[token]
        member = self._crew.members.get(attempt.worker)
        name = attempt.worker if member is None else member.name
        if attempt.result is not None:
            del self._attempts[token]
            self._await_file(attempt.chunk, attempt.result["file"], name)
            self._done.add(attempt.chunk)
            self._s_per_frame.append(
                (time.monotonic() - attempt.began) / self._frames[attempt.chunk]
            )
            self._drop([t for t, a in self._attempts.items() if a.chunk == attempt.chunk])
            yield attempt.result
        elif attempt.future.status == "error":
            e = attempt.future.exception(timeout=ARRIVE_S)
            # Dask has given up on it, or its worker is being closed
            if type(e).__name__ != "KilledWorker" and not isinstance(
                e, remote.UnwantedError
            ):
                raise e
            yield from self._lose_attempt(token, name)
        elif attempt.future.status == "finished":  # its event comes by another way
            attempt.ended = min(attempt.ended, time.monotonic())
            if time.monotonic() - attempt.ended > ARRIVE_S:
                yield from self._lose_attempt(token, name)
        else:  # cancelled: the scheduler is gone, or somebody has cleared it
            scheduler_says(self._client, lambda: None)
            yield from self._lose_attempt(token, name)

    def _await_file(self, chunk: int, file: str, worker: str) -> None:
        """A shared disk may show a file later than the worker that wrote it."""
        folder, began = self._targets[chunk].parent, time.monotonic()
        while not (folder / file).exists():
            if self._store is not None and self._find(chunk) is not None:
                return
            if time.monotonic() - began > ARRIVE_S:
                raise RenderError(
                    f"worker {worker} has written {file}, and it is not in {folder}",
                    "--map-path has to name the same folder on the workers",
                )
            time.sleep(ROUND_S)

    def _lose(self, address: str, name: str) -> Results:
        """The worker is gone, with all that it was at."""
        self._leaving = {
            token: worker for token, worker in self._leaving.items() if worker != address
        }
        for token in [t for t, a in self._attempts.items() if a.worker == address]:
            yield from self._lose_attempt(token, name)

    def _check_lost(self) -> None:
        killers = [
            c
            for c, names in self._lost.items()
            if c not in self._done and len(names) >= self._most_lost
        ]
        if killers:
            frames = " or ".join(
                f"{self._tasks[c][2]}–{self._tasks[c][3]}" for c in killers
            )
            names, what = (
                ", ".join(self._lost[killers[0]]),
                "stretch" if self._suffix is None else "chunk",
            )
            raise RenderError(
                f"frames {frames}: workers were lost with this {what} {self._most_lost}"
                f" times ({names})",
                "out of memory? --resume goes on; as many are allowed as Dask's"
                " distributed.scheduler.allowed-failures says",
            )

    def _lose_attempt(self, token: str, name: str) -> Results:
        attempt = self._attempts.pop(token)
        attempt.future.cancel(force=True)
        chunk = attempt.chunk
        self._lost.setdefault(chunk, []).append(name)
        if path := self._find(chunk):
            yield self._found(chunk, path)
        elif not self._tried()[chunk]:
            bisect.insort(self._waiting, chunk)

    def _event(self, event: tuple[float, Mapping[str, Any]]) -> None:
        """In the client's own thread."""
        _, said = event
        if attempt := self._attempts.get(said["attempt"]):
            attempt.frames = said.get("frames", attempt.frames)
            attempt.result = said.get("result", attempt.result)
        elif "ended" in said:
            self._leaving.pop(said["attempt"], None)

    def _frames_done(self) -> int:
        of_chunk: dict[int, int] = {}
        for a in [*self._attempts.values()]:
            of_chunk[a.chunk] = max(of_chunk.get(a.chunk, 0), a.frames)
        return sum(self._frames[c] for c in self._done) + sum(of_chunk.values())

    def _drop(self, tokens: Sequence[str]) -> None:
        """Nobody wants these any more: their workers see that at the next frame."""
        for token in tokens:
            attempt = self._attempts.pop(token)
            self._leaving[token] = attempt.worker
            with contextlib.suppress(Exception):  # the scheduler may be gone
                attempt.future.cancel(force=True)

    def _leave(self) -> None:
        self._drop([*self._attempts])
        began = time.monotonic()
        while (
            self._leaving
            and self._client.status == "running"
            and time.monotonic() - began < LEAVE_S
        ):
            time.sleep(ROUND_S)
        with contextlib.suppress(Exception):
            self._client.unsubscribe_topic(self._run)
