"""Compile what a job will call before it starts, in several processes, where that was not
done yet; load it beside the analysis.

kernels.json lists, by what brings them into a job, the compiled functions that are called
from Python, with the types of their arguments and the seconds that each takes to compile
(tools/record_kernels.py). Processes, because numba holds a lock while it compiles. What is
not in the list is compiled when it is called, and `warn_if_unlisted` says so."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import queue
import re
import subprocess
import sys
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from arfx.core import compiled, interrupt
from arfx.core.machine import usable_cores
from arfx.core.parallel import ONE_THREAD

COMPILE = "compile"  # the phase that progress is reported for
MANIFEST = Path(__file__).with_suffix(".json")
# Parts of the list; the others are named by the stage that brings them
# SELDOM: what few jobs call, of 10 bits for instance; no job asks for it, the tests' start
# and wheels take all
JOB, SYNTH, SELDOM = "job", "synth", "seldom"
PROCESS_S = 4.0  # of compiling, for each process: it takes one or two seconds to start
Progress = Callable[[str, int, int | None], None]
Notice = Callable[[str], None]


@dataclass(frozen=True)
class Kernel:
    """A compiled function for one list of argument types, as `signature`.

    seconds : it takes to compile
    """

    module: str
    name: str
    types: str
    seconds: float

    @property
    def function(self) -> Any:
        return getattr(import_module(self.module), self.name)

    @property
    def is_cached(self) -> bool:
        """Whether it need not be compiled: numba's own look-up, without loading the code."""
        function, types = self.function, _types(self.types)
        key = function._cache._index_key(types, function.targetctx.codegen())
        return (
            types in function.overloads or key in function._cache._cache_file._load_index()
        )

    def load(self) -> None:
        """Compile and keep it where that was not done."""
        self.function.compile(_types(self.types))


def signature(types: Iterable[Any]) -> str:
    """Types of arguments as numba writes them, a named tuple's class with its module:
    "(int64, arfx.x.Pair(int64, int64))".
    """
    from numba.core.types.containers import BaseNamedTuple, Tuple

    def one(kind: Any) -> str:
        if isinstance(
            kind, Tuple
        ):  # numba writes it in a form that its constructor does not read
            return f"({', '.join(map(one, kind.types))},)"
        if not issubclass(type(kind), BaseNamedTuple):
            return repr(kind)
        made_by = kind.instance_class
        return f"{made_by.__module__}.{made_by.__qualname__}({', '.join(map(one, kind.types))})"

    parts = [one(kind) for kind in types]
    return f"({', '.join(parts)}{',' * (len(parts) == 1)})"


@cache
def _types(text: str) -> tuple[Any, ...]:
    """What `signature` wrote."""
    from numba.core import types

    known = dict(vars(types))
    for module in set(re.findall(r"([\w.]+)\.\w+\(", text)):
        import_module(module)
        known[module.partition(".")[0]] = import_module(module.partition(".")[0])

    def one(kind: Any) -> Any:  # a named tuple's own class made one of types
        return (
            types.containers.BaseTuple.from_types([one(k) for k in kind], type(kind))
            if isinstance(kind, tuple)
            else kind
        )

    return tuple(one(kind) for kind in eval(text, known))


def listed_kernels(parts: Collection[str] | None = None) -> list[Kernel]:
    """The kernels of these parts of the list; None = of all."""
    document = json.loads(MANIFEST.read_text(encoding="utf-8"))
    return [
        Kernel(*row)
        for part, rows in document.items()
        if parts is None or part in parts
        for row in rows
    ]


def compile_ahead(
    parts: Collection[str] | None, progress: Progress, notice: Notice = print
) -> int:
    """Compile what is missing of these parts of the list, None = of all; as `compiling`.
    Returns how many functions that was.
    """
    with compiling(listed_kernels(parts), (), progress, notice) as count:
        return count


@contextlib.contextmanager
def compiling(
    first: Sequence[Kernel],
    then: Sequence[Kernel],
    progress: Progress,
    notice: Notice = print,
) -> Iterator[int]:
    """Compile what is missing: what the body itself calls before it runs, the others beside
    it; the end waits for them.

    Yields how many functions are missing. progress : phase "compile", functions done, of how many
    notice : called where compiled code cannot be cached"""
    with interrupt.deferred():  # to look at a kernel imports its module
        needed = [kernel for kernel in first if not kernel.is_cached]
        missing = needed + [kernel for kernel in then if not kernel.is_cached]
    if compiled.open_folders:
        notice(
            f"compiled code in {compiled.open_folders[0]} is not used, others may write"
            " there: chmod go-w takes that from them"
        )
        compiled.open_folders.clear()
    if missing:
        if not compiled.cache_persists():
            notice(
                "compiled code cannot be kept, every run compiles again: set"
                " NUMBA_CACHE_DIR to a folder that can be written"
            )
        progress(COMPILE, 0, len(missing))
    groups = _by_module(missing, needed)
    processes = min(
        usable_cores(),
        len(groups),
        int(sum(kernel.seconds for kernel in missing) / PROCESS_S),
    )
    with contextlib.closing(
        _in_processes(groups, processes) if processes > 1 else _in_this_process(groups)
    ) as work:
        done: set[Kernel] = set()

        def until(wanted: Sequence[Kernel]) -> None:
            while not done.issuperset(wanted) and (kernel := next(work, None)) is not None:
                done.add(kernel)
                progress(COMPILE, len(done), len(missing))

        until(needed if processes > 1 else missing)
        yield len(missing)
        until(missing)


def _in_this_process(groups: deque[list[Kernel]]) -> Generator[Kernel]:
    for kernel in itertools.chain.from_iterable(groups):
        with interrupt.deferred():
            kernel.load()
        yield kernel


def _by_module(kernels: Sequence[Kernel], needed: Sequence[Kernel]) -> deque[list[Kernel]]:
    """What is needed first, then the longest.

    Functions of one module call the same others, which are compiled once this way.
    """
    groups = defaultdict(list)
    for kernel in kernels:
        groups[kernel.module].append(kernel)
    first = {kernel.module for kernel in needed}
    return deque(
        sorted(
            groups.values(),
            key=lambda group: (
                group[0].module not in first,
                -sum(k.seconds for k in group),
            ),
        )
    )


def _in_processes(groups: deque[list[Kernel]], count: int) -> Generator[Kernel]:
    """Yields what is done. What a process leaves undone is compiled when it is called."""
    environment = {
        **os.environ,
        **ONE_THREAD,
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
    command = [sys.executable, "-P", "-c", "from arfx.run.compiler import serve; serve()"]
    done: queue.SimpleQueue[Kernel] = queue.SimpleQueue()
    helpers: list[subprocess.Popen[str]] = []

    def feed(helper: subprocess.Popen[str]) -> None:
        assert helper.stdin and helper.stdout
        with contextlib.suppress(
            OSError, IndexError, ValueError
        ):  # it died; no group is left; it was ended
            while True:
                for kernel in groups.popleft():
                    helper.stdin.write(
                        json.dumps([kernel.module, kernel.name, kernel.types]) + "\n"
                    )
                    helper.stdin.flush()
                    if not helper.stdout.readline():
                        return
                    done.put(kernel)

    try:
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        with interrupt.deferred():
            for _ in range(count):
                helpers.append(
                    subprocess.Popen(
                        command,
                        stdin=pipe,
                        stdout=pipe,
                        stderr=nowhere,
                        text=True,
                        env=environment,
                    )
                )
        threads = [
            threading.Thread(target=feed, args=(helper,), daemon=True) for helper in helpers
        ]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads) or not done.empty():
            with contextlib.suppress(queue.Empty):
                yield done.get(timeout=0.2)
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()


@contextlib.contextmanager
def loading(parts: Collection[str]) -> Iterator[None]:
    """Load compiled code in a thread beside the body, which leaves a core idle; the end
    waits for it, except after an error.
    """

    def load() -> None:
        with contextlib.suppress(Exception):  # raised again where it is called
            for kernel in listed_kernels(parts):
                kernel.load()

    thread = threading.Thread(target=load, name="load-compiled", daemon=True)
    thread.start()
    yield
    thread.join()


@contextlib.contextmanager
def warn_if_unlisted(notice: Notice) -> Iterator[None]:
    """Says once if, in the body, something is compiled that is not in the list, which may
    take some seconds.
    """
    from numba.core import event

    local = threading.local()  # depth : of functions being compiled, one for the other
    seldom = set(listed_kernels((SELDOM,)))
    known = {(k.module, k.name, k.types) for k in listed_kernels() if k not in seldom}

    class Listener(event.Listener):
        warned = False

        def on_start(self, started: Any) -> None:
            local.depth = getattr(local, "depth", 0) + 1
            if local.depth > 1 or self.warned:
                return
            function, types = (
                started.data["dispatcher"].py_func,
                signature(started.data["args"]),
            )
            if (function.__module__, function.__qualname__, types) not in known:
                self.warned = True
                notice(
                    "compiling further kernels, once: this clip or its settings need them"
                )

        def on_end(self, ended: Any) -> None:
            local.depth -= 1

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
