"""Who does the work, chunks to render or stretches to analyse: this thread, several threads of this process, or several
processes. The same bytes.

Threads share the model and what the stages prepared, and need no second start of Python: right for a few cores, as
nearly all of a frame's time is spent in code that lets other threads run. With many they would wait for each other."""

from __future__ import annotations

import itertools
import os
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from typing import Any, Self

from arfx.core import interrupt
from arfx.core.machine import collect_seldom
from arfx.errors import RenderError
from arfx.run.schedule import steal, work_queues
from arfx.run.source import release
from arfx.run.worker import keep_memory, render_chunk

# one chunk's or stretch's arguments: folder, key, first, last, target
Task = tuple[str, str, int, int, str]
Work = Callable[..., dict[str, Any]]  # work(*task, tick, alone=False): a function of a module; tick() after every frame
Results = Generator[dict[str, Any], None, None]  # to be closed: that stops the workers
# one software-rendering thread and one kernel thread for each of several processes; two processes scale better than two threads
ONE_THREAD = ("LP_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS")
_counter: Any = None


def run_serial(tasks: Iterable[Task], progress: Callable[[int], None], work: Work = render_chunk) -> Results:
    """Work in this process, in order. progress : called with the number of frames done."""
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress(done)

    try:
        for task in tasks:
            yield work(*task, tick, alone=True)
    finally:
        release()


class _StoppedError(Exception):
    """Raised in a working thread to leave its task."""


def run_threads(tasks: Sequence[Task], workers: int, progress: Callable[[int], None], work: Work = render_chunk) -> Results:
    """Work in `workers` threads of this process, in any order. Raises what a thread raises; on the way out all stop."""
    import concurrent.futures as futures

    ticks = itertools.count(1)  # one step of it is atomic
    done, stopped = 0, False
    queues = work_queues(tasks, workers)
    choosing = threading.Lock()
    results: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

    def tick() -> None:
        nonlocal done
        if stopped:
            raise _StoppedError
        done = max(done, next(ticks))

    def next_task(own: deque[Task]) -> Task | None:
        with choosing:
            return steal(own, queues)

    def run(own: deque[Task]) -> None:
        try:
            while (task := next_task(own)) is not None:
                results.put(work(*task, tick))
        finally:
            release()

    pool = futures.ThreadPoolExecutor(len(queues), "worker")
    try:
        running = {pool.submit(run, own) for own in queues}
        while running:
            ready, running = futures.wait(running, timeout=0.2, return_when=futures.FIRST_COMPLETED)
            progress(done)
            while not results.empty():
                yield results.get()
            for future in ready:
                future.result()
        while not results.empty():
            yield results.get()
    finally:
        stopped = True
        pool.shutdown(wait=True, cancel_futures=True)


def _start(counter: Any) -> None:
    """In each worker: leave Ctrl-C to the parent, end with it, look for garbage seldom, and keep libraries from starting a thread
    per core each."""
    global _counter
    _counter = counter
    keep_memory()
    interrupt.in_worker()
    collect_seldom()
    import cv2

    cv2.setNumThreads(1)


def _run(work: Work, task: Task) -> dict[str, Any]:
    def tick() -> None:
        with _counter.get_lock():
            _counter.value += 1

    return work(*task, tick)


class Processes:
    """Worker processes. In `with` they are kept: those that have worked work in the next `run` too.

    Where that is safe (Linux) they are forked, from a server that has imported what they need, and never had a thread or an
    OpenGL context: neither survives a fork. Elsewhere they are spawned."""

    def __init__(self) -> None:
        self._kept, self._pool, self._counter = False, None, None

    def __enter__(self) -> Self:
        self._kept = True
        return self

    def __exit__(self, *_: object) -> None:
        self._kept = False
        self._end()

    def prepare(self) -> Any:
        """Have the server begin to import, which this process need not wait for. Returns the way to start processes."""
        import multiprocessing
        from multiprocessing import forkserver

        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        if sys.platform != "linux":
            return multiprocessing.get_context("spawn")
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["arfx.run.preload"])
        with interrupt.starting_workers():
            forkserver.ensure_running()
        return context

    def run(self, tasks: Iterable[Task], workers: int, progress: Callable[[int], None], work: Work = render_chunk) -> Results:
        """Work in as many processes as there are tasks, up to `workers`, in any order.

        Raises RenderError if a worker dies, and what a worker raises. Unless all is done, the workers are stopped on the way
        out."""
        import concurrent.futures as futures

        if self._pool is None:
            try:
                context = self.prepare()
                self._counter = context.Value("L", 0)
            except OSError:  # no shared memory here (a bare container): the same bytes, one process
                yield from run_serial(tasks, progress, work)
                return
            self._pool = futures.ProcessPoolExecutor(workers, context, _start, (self._counter,))
        kept, before = False, self._counter.value
        try:
            with interrupt.starting_workers():
                waiting = {self._pool.submit(_run, work, task) for task in tasks}
            while waiting:
                ready, waiting = futures.wait(waiting, timeout=0.2, return_when=futures.FIRST_COMPLETED)
                progress(self._counter.value - before)
                for future in ready:
                    yield future.result()
            kept = self._kept
        except futures.process.BrokenProcessPool:
            raise RenderError(
                "a worker process was killed (out of memory?)", "--resume goes on; fewer --workers need less memory"
            ) from None
        finally:
            if not kept:
                self._end()

    def _end(self) -> None:
        pool, self._pool = self._pool, None
        if pool is not None:
            for process in list((pool._processes or {}).values()):  # shutdown alone would wait for whole chunks
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
