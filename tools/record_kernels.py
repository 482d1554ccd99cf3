"""Write arfx/run/kernels.json: which compiled functions jobs call, for which types, and
what each takes to compile.

    python tools/record_kernels.py

Runs typical jobs one after the other, each in a process of its own, and notes every
function that is compiled or loaded because Python calls it; one that an earlier job has
noted is not noted again. The tests' come last. Takes some minutes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from arfx.stages import STAGES

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ROOT / "arfx" / "run" / "kernels.json"

SELDOM = "seldom"  # what few jobs call, of 10 bits for instance
# part of the list -> the arguments of the job that brings what none before it has; a
# stage's own kernels are its own part
JOBS = {
    "synth": "synth sample_scenes/0001-orbit/scene.toml -o MADE/clip",
    "job": "process --config MADE/clip/job.toml -o MADE/job.mp4 --set pipeline.stages=[]",
    "lightmap": "demo -o MADE/demo",
    "hide": "verify sample_scenes/0022-before-and-behind",
    "gi": "verify sample_scenes/0041-indirect-light",
    "watercolor": "verify sample_scenes/0030-watercolor",
    SELDOM: (
        "tests tests/unit/media tests/unit/papers tests/unit/reproduce tests/unit/stages"
        " tests/contract"
    ),
}
SELDOM_S = 0.2  # what takes less is compiled where it is called


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


def record(file: Path, arguments: list[str]) -> None:
    """In the process of one job: run it, and write (module, name, types, seconds) of what
    was called.
    """
    from numba.core.dispatcher import Dispatcher

    from arfx_cli.main import main

    called: dict[tuple[str, str, str], float] = {}
    compile_, here = Dispatcher.compile, threading.local()

    def compile(self: Any, types: Any) -> Any:
        here.depth = getattr(here, "depth", 0) + 1
        start = time.thread_time()
        try:
            return compile_(self, types)
        finally:
            here.depth -= 1
            if not here.depth and self.py_func.__module__.startswith("arfx."):
                key = (
                    self.py_func.__module__,
                    self.py_func.__qualname__,
                    signature(types),
                )
                called.setdefault(key, round(time.thread_time() - start, 2))

    Dispatcher.compile = compile
    try:
        if arguments[0] == "tests":
            sys.exit(pytest.main(["-p", "no:cacheprovider", *arguments[1:]]))
        main(arguments)
    finally:
        file.write_text(
            json.dumps([[*key, seconds] for key, seconds in called.items()])
        )


def run_all() -> dict[str, list[list[Any]]]:
    parts: dict[str, list[list[Any]]] = {}
    noted: set[tuple[str, ...]] = set()
    with tempfile.TemporaryDirectory() as made:
        for name in (
            "arfx",
            "cli",
            "configs",
            "sample_scenes",
            "tests",
        ):  # without what was compiled before
            shutil.copytree(
                ROOT / name,
                Path(made) / "tree" / name,
                ignore=shutil.ignore_patterns("__pycache__"),
            )
        shutil.copy(ROOT / "pyproject.toml", Path(made) / "tree")
        tree = Path(made) / "tree"
        (tree / "arfx" / "run" / "kernels.json").write_text(
            "{}"
        )  # compiled where it is called, so that it is seen
        environment = {
            **os.environ,
            "PYTHONPATH": f"{tree}{os.pathsep}{tree / 'cli'}",
            "OPENBLAS_NUM_THREADS": "1",
        }
        for part, job in JOBS.items():
            file = Path(made) / f"{part}.json"
            command = [
                sys.executable,
                __file__,
                str(file),
                *job.replace("MADE", made).split(),
            ]
            subprocess.run(command, cwd=tree, env=environment, check=True)
            for row in sorted(json.loads(file.read_text())):
                if tuple(row[:3]) not in noted and (
                    part != SELDOM or row[3] >= SELDOM_S
                ):
                    noted.add(tuple(row[:3]))
                    parts.setdefault(
                        (part != SELDOM and part_of(row[0])) or part, []
                    ).append(row)
    return parts


def part_of(module: str) -> str:
    """The part that a module's kernels belong to, most often a stage; "" if to none."""
    package, _, rest = module.partition(".stages.")
    name = rest.partition(".")[0]
    return name if package == "arfx" and name in STAGES else ""


def as_text(parts: dict[str, list[list[Any]]]) -> str:
    """A kernel a line."""
    lines = [
        f' "{part}": [\n'
        + ",\n".join(f"  {json.dumps(row)}" for row in rows)
        + "\n ]"
        for part, rows in parts.items()
    ]
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    if len(sys.argv) > 1:
        record(Path(sys.argv[1]), sys.argv[2:])
    else:
        MANIFEST.write_text(as_text(run_all()))
