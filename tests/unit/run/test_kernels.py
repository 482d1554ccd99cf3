"""What is compiled ahead: the list fits the code, only what is missing is compiled, and no
failure of it stops a job.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numba
import numpy as np
import pytest

from arfx.run import job, kernels
from arfx.run.folder import JobFolder
from arfx.run.kernels import (
    JOB,
    SYNTH,
    Kernel,
    compile_ahead,
    listed_kernels,
    warn_if_unlisted,
)
from arfx.run.times import WorkLog
from arfx.stages import STAGES
from arfx_cli.console import Progress
from arfx_cli.demo import EFFECTS
from tools.record_kernels import SELDOM, signature

MODULE = """
import numba

@numba.njit(cache=True)
def double(x):
    return 2 * x

@numba.njit(cache=True)
def half(x):
    return x / 2
"""


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Kernel]:
    """Two kernels in modules of their own, one of them for integers too, and a list that
    holds them.
    """
    monkeypatch.syspath_prepend(tmp_path)
    names = [f"first_{tmp_path.name}", f"second_{tmp_path.name}"]
    for name in names:
        (tmp_path / f"{name}.py").write_text(MODULE)
    rows = [
        [names[0], "double", "(float64,)", 9.0],
        [names[0], "double", "(int64,)", 9.0],
        [names[1], "half", "(float64,)", 9.0],
    ]
    (tmp_path / "list.json").write_text(json.dumps({"job": rows[:2], "gi": rows[2:]}))
    monkeypatch.setattr(kernels, "MANIFEST", tmp_path / "list.json")
    return listed_kernels()


def compiled_files(folder: Path) -> int:
    return len(list((folder / "__pycache__").glob("*.nbc")))


@pytest.mark.parametrize("cores", [1, 2])
def test_what_is_missing_is_compiled_and_told_once(
    two: list[Kernel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    monkeypatch.setattr(kernels, "usable_cores", lambda: cores)
    told: list[tuple[str, int, int | None]] = []
    assert compile_ahead(("job", "gi"), lambda *a: told.append(a)) == 3
    assert told[0] == ("compile", 0, 3) and told[-1] == ("compile", 3, 3)
    assert compiled_files(tmp_path) == 3
    told.clear()
    assert compile_ahead(None, lambda *a: told.append(a)) == 0 and not told


def test_only_the_parts_that_a_job_needs_are_compiled(
    two: list[Kernel], tmp_path: Path
) -> None:
    assert compile_ahead(("gi",), lambda *a: None) == 1
    assert [k.is_cached for k in two] == [False, False, True]


def test_a_kernel_that_is_not_there_ends_nothing() -> None:
    told = []
    missing = [Kernel("arfx.no_such_module", "f", "(int64,)", 9.0)] * 2
    kernels._compile(missing, lambda: told.append(1), alone=True)
    assert len(told) == 2


def test_where_nothing_can_be_kept_one_notice_says_so(
    two: list[Kernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels.compiled, "cache_persists", lambda: False)
    notices: list[str] = []
    compile_ahead(("gi",), lambda *a: None, notices.append)
    assert len(notices) == 1 and "NUMBA_CACHE_DIR" in notices[0]


def test_what_is_not_compiled_ahead_is_told_once(
    two: list[Kernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "usable_cores", lambda: 1)
    notices: list[str] = []
    with warn_if_unlisted(notices.append):
        compile_ahead(("job",), lambda *a: None)
        two[0].load()
        assert notices == []
        for number in (1, 1.5 + 1j, True):
            two[0].function(number)
    two[2].function(3)
    assert len(notices) == 1 and "compiling" in notices[0]


def test_the_list_fits_the_code() -> None:
    """Every function that it names is there, is kept on disk, and takes as many arguments
    as it says.
    """
    document = json.loads(kernels.MANIFEST.read_text(encoding="utf-8"))
    assert (
        {SYNTH, JOB, "lightmap", *EFFECTS}
        <= document.keys()
        <= {SYNTH, JOB, SELDOM, *STAGES}
    )
    for kernel in listed_kernels():
        function = kernel.function
        assert (
            len(kernels._types(kernel.types)) == function.py_func.__code__.co_argcount
        ), kernel
        assert kernel.is_cached in (True, False), kernel


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


class Both(NamedTuple):
    pair: Pair
    size: int


def test_types_are_read_as_they_are_written() -> None:
    alike, mixed = (
        Pair(np.zeros(2), np.zeros(2)),
        Pair(np.zeros(2), np.zeros((2, 2), np.uint8)),
    )
    for arguments in (
        (3,),
        (alike, True, np.float32(1)),
        (Both(mixed, 2), alike),
        (),
    ):
        types = tuple(map(numba.typeof, arguments))
        text = signature(types)
        assert kernels._types(text) == types
        assert (
            not any(isinstance(a, Pair) for a in arguments)
            or f"{__name__}.Pair(" in text
        )


@pytest.mark.parametrize("started", [None, 3.0])
def test_compiling_is_no_part_of_a_jobs_time(
    monkeypatch: pytest.MonkeyPatch, started: float | None
) -> None:
    clock = [5.0]

    def compile_for_a_minute(*_: object) -> None:
        clock[0] += 60

    monkeypatch.setattr(job, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(job, "compile_ahead", compile_for_a_minute)
    logs: list[WorkLog] = []

    def log(path: Path, began: float) -> WorkLog:
        logs.append(WorkLog(path, began))
        return logs[0]

    def stop(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(job, "pipeline", lambda _: ())
    monkeypatch.setattr(job, "WorkLog", log)
    monkeypatch.setattr(job, "job_keys", stop)
    config = SimpleNamespace(
        input=SimpleNamespace(clip="clip.mp4"),
        model=SimpleNamespace(file="model.glb"),
    )
    with pytest.raises(KeyboardInterrupt):
        job.plan_job(
            SimpleNamespace(config=config),
            JobFolder(Path("job")),
            job.Options(),
            started,
        )  # type: ignore[arg-type]
    since = 0 if started is None else 5.0 - started
    assert clock[0] - logs[0].began == since


def test_what_is_compiled_is_told_in_words(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with Progress() as progress:
        progress("compile", 12, 31)
        progress("render", 12, 31)
    assert capsys.readouterr().err.splitlines() == [
        "compiling kernels for this processor, once: 12 of 31",
        "render: 12/31 frames",
    ]
