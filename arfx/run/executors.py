"""Who does the work, chunks to render or stretches to analyse: this thread, several threads
of this process, or several processes. The same bytes.

Threads share the model and what the stages prepared, and need no second start of Python:
right for a few cores, as nearly all of a frame's time is spent in code that lets other
threads run. With many they would wait for each other."""

import contextlib
import itertools
import os
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from functools import partial
from typing import Any, Self

import cv2

from arfx.core import interrupt
from arfx.core.machine import collect_seldom
from arfx.core.parallel import ONE_THREAD
from arfx.errors import RenderError
from arfx.run.schedule import next_task, work_queues
from arfx.run.source import release

Done = Callable[[int], None]  # is told how many frames are done
# arguments of a work; of a chunk and a stretch: folder, key, first, last, target
Task = tuple[Any, ...]
# work(*task, tick, alone=False): a function of a module; tick() after every frame
Work = Callable[..., dict[str, Any]]
Results = Generator[
    dict[str, Any], None, None
]  # to be closed: that stops the workers


def run_serial(tasks: Iterable[Task], progress: Done, work: Work) -> Results:
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


def run_threads(
    tasks: Sequence[Task],
    workers: int,
    progress: Done,
    work: Work,
) -> Results:
    """Work in `workers` threads of this process, in any order.

    Raises what a thread raises; on the way out all stop.
    """
    return _in_threads(tasks, [work] * workers, progress)


def _in_threads(
    tasks: Sequence[Task],
    crew: Sequence[Work],
    progress: Done,
    stop: Callable[[], None] = lambda: None,
) -> Results:
    """A thread for each of the crew, who works. stop : called on the way out, unless all is done"""
    ticks = itertools.count(1)  # one step of it is atomic
    done, stopped = 0, False
    queues = work_queues(tasks, len(crew))
    hands = [*zip(queues, crew, strict=False)]
    choosing, own = threading.Lock(), threading.local()

    def tick() -> None:
        nonlocal done
        if stopped:
            raise _StoppedError
        done = max(done, next(ticks))

    def begin() -> None:
        own.queue, own.work = hands.pop(0)

    def do_next() -> dict[str, Any]:
        with choosing:
            task = next_task(own.queue, queues)
        result: dict[str, Any] = own.work(*task, tick)
        return result

    pool = ThreadPoolExecutor(len(queues), "worker", begin)
    # OpenCV's own threads only get in the way of each other where all cores have work
    opencv_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        running = {pool.submit(do_next) for _ in tasks}
        while running:
            ready, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
            progress(done)
            for future in ready:
                yield future.result()
    except BaseException:
        stopped = True
        stop()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        cv2.setNumThreads(opencv_threads)


def _serve(pipe: Any) -> None:
    """A worker process: leaves Ctrl-C to the parent, ends with it, looks for garbage
    seldom, and keeps libraries from starting a thread per core each. It is sent work and
    tasks; it answers None after each frame, then what came of it."""
    interrupt.in_worker()
    collect_seldom()
    cv2.setNumThreads(1)
    sys.stdout = sys.stderr  # for results of the command
    with contextlib.suppress(EOFError, OSError):  # the parent has ended
        while True:
            work, task = pipe.recv()
            try:
                answer = work(*task, lambda: pipe.send(None))
            except Exception as e:
                e.add_note(traceback.format_exc())
                answer = e
            pipe.send(answer)


class _Worker:
    """A worker process, seen from here."""

    def __init__(self, context: Any) -> None:
        self._pipe, its = context.Pipe()
        self.process = context.Process(target=_serve, args=(its,), daemon=True)
        self.process.start()
        its.close()

    def do(self, work: Work, *given: Any) -> dict[str, Any]:
        """work(*given), of which the last is called after each frame.

        Raises what that raises; RenderError if the worker dies.
        """
        *task, tick = given
        try:
            self._pipe.send((work, task))
            while (answer := self._pipe.recv()) is None:
                tick()
        except (EOFError, OSError):
            raise RenderError(
                "a worker process was killed (out of memory?)",
                "--resume goes on; fewer --workers need less memory",
            ) from None
        if isinstance(answer, Exception):
            raise answer
        return answer


@contextlib.contextmanager
def _starting() -> Iterator[None]:
    """Processes that start in the body have the environment of workers, and import from
    where this one does.
    """
    theirs = {name: os.environ.get(name, one) for name, one in ONE_THREAD.items()}
    theirs |= {
        "PYTHONSAFEPATH": "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
    ours = {name: os.environ.get(name) for name in theirs}
    with interrupt.starting_workers():
        os.environ.update(theirs)
        try:
            yield
        finally:
            for name, value in ours.items():
                os.environ.pop(name)
                os.environ.update({} if value is None else {name: value})


class Processes:
    """Worker processes. In `with` they are kept: those that worked work in the next `run` too.

    Where that is safe (Linux) they are forked, from a server that has imported what they
    need, and never had a thread or an OpenGL context: neither survives a fork. Elsewhere
    they are spawned."""

    def __init__(self) -> None:
        self._workers: list[_Worker] = []
        self._kept = False

    def __enter__(self) -> Self:
        self._kept = True
        return self

    def __exit__(self, *_: object) -> None:
        self._kept = False
        self._end()

    def prepare(self) -> Any:
        """Have the server begin to import, which this process need not wait for.

        Returns how processes are made.
        """
        import multiprocessing

        if sys.platform != "linux":
            return multiprocessing.get_context("spawn")
        from multiprocessing import forkserver

        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["arfx.run.preload"])
        with _starting():
            forkserver.ensure_running()
        return context

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        progress: Done,
        work: Work,
    ) -> Results:
        """Work in `workers` processes, in any order.

        Raises RenderError if a worker dies, and what a worker raises. On the way out the
        workers are stopped, unless all is done and they are kept."""
        context, wanted = self.prepare(), min(workers, len(tasks))
        try:
            with _starting():
                while len(self._workers) < wanted:
                    self._workers.append(_Worker(context))
            crew = [partial(worker.do, work) for worker in self._workers[:wanted]]
            yield from _in_threads(tasks, crew, progress, self._end)
        finally:
            if not self._kept:
                self._end()

    def _end(self) -> None:
        while self._workers:
            process = self._workers.pop().process
            process.terminate()  # it would do the whole chunk otherwise
            process.join()
