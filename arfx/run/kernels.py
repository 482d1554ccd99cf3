"""Compile what a job will call before it starts, in several processes, where that was not
done yet; load it beside the analysis.

kernels.json lists, by what brings them into a job, the compiled functions that are called
from Python, with the types of their arguments and the seconds that each takes to compile
(tools/record_kernels.py). Processes, because numba holds a lock while it compiles. What is
not in the list is compiled when it is called, and `warn_if_unlisted` says so."""

from __future__ import annotations

import contextlib
import json
import re
import threading
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from arfx.core import compiled, interrupt
from arfx.core.machine import usable_cores
from arfx.core.waiting import Notice, Progress
from arfx.errors import RenderError
from arfx.run.executors import Processes, run_serial

COMPILE = "compile"  # the phase that progress is reported for
MANIFEST = Path(__file__).with_suffix(".json")
# Parts of the list; the others are named by the stage that brings them, or hold what few
# jobs call
JOB, SYNTH = "job", "synth"
PROCESS_S = (
    4.0  # of compiling, for each process: it takes one or two seconds to start
)
_AHEAD = threading.Event()  # while kernels are compiled ahead in this process


@dataclass(frozen=True)
class Kernel:
    """A compiled function for one list of argument types, as numba writes them, a named
    tuple's class with its module: "(int64, arfx.x.Pair(int64, int64))".

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
            types in function.overloads
            or key in function._cache._cache_file._load_index()
        )

    def load(self) -> None:
        """Compile and keep it where that was not done."""
        self.function.compile(_types(self.types))


@cache
def _types(text: str) -> tuple[Any, ...]:
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
    """Compile what is missing of these parts of the list, None = of all. Returns how many
    functions that was.
    """
    return compile_missing(listed_kernels(parts), progress, notice)


def compile_missing(
    kernels: Sequence[Kernel], progress: Progress, notice: Notice = print
) -> int:
    """progress : phase "compile", functions done, of how many
    notice : called where compiled code cannot be cached"""
    with interrupt.deferred():  # to look at a kernel imports its module
        missing = [kernel for kernel in kernels if not kernel.is_cached]
    if compiled.open_folders:
        notice(
            f"compiled code in {compiled.open_folders[0]} is not used, others may write"
            " there: chmod go-w takes that from them"
        )
        compiled.open_folders.clear()
    if not missing:
        return 0
    if not compiled.cache_persists():
        notice(
            "compiled code cannot be kept, every run compiles again: set"
            " NUMBA_CACHE_DIR to a folder that can be written"
        )
    groups = defaultdict(list)
    for kernel in missing:  # of one module: they call the same others
        groups[kernel.module].append(kernel)
    longest_first = sorted(
        groups.values(), key=lambda group: -sum(k.seconds for k in group)
    )
    tasks = [(group,) for group in longest_first]
    seconds = sum(kernel.seconds for kernel in missing)
    processes = min(usable_cores(), len(tasks), int(seconds / PROCESS_S))

    def tell(done: int) -> None:
        progress(COMPILE, done, len(missing))

    tell(0)
    results = (
        Processes().run(tasks, processes, tell, _compile)
        if processes > 1
        else run_serial(tasks, tell, _compile)
    )
    # what a process that dies leaves undone is compiled when it is called
    with contextlib.closing(results), contextlib.suppress(RenderError):
        for _ in results:
            pass
    return len(missing)


def _compile(
    kernels: Sequence[Kernel], tick: Callable[[], None], alone: bool = False
) -> dict[str, Any]:
    """Compile and keep these."""
    _AHEAD.set()
    for kernel in kernels:
        # an error is raised again where it is called
        with interrupt.deferred(), contextlib.suppress(Exception):
            kernel.load()
        tick()
    _AHEAD.clear()
    return {}


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
    """Says once if, in the body, something is compiled that was not compiled ahead, which
    may take some seconds.
    """
    from numba.core import event

    told = threading.Event()

    class Listener(event.Listener):
        def on_start(self, started: event.Event) -> None:
            if not (told.is_set() or _AHEAD.is_set()):
                told.set()
                notice(
                    "compiling further kernels, once: this clip or its settings need them"
                )

        def on_end(self, ended: event.Event) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
