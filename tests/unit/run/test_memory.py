"""Memory is told on every system, and where one tells nothing that is no error."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from arfx.run import memory


def test_the_peak_stays_after_memory_is_given_back() -> None:
    held = np.ones(25_000_000)  # 200 MB
    peak = memory.peak_mb()
    assert peak > held.nbytes / 2**20
    del held
    assert memory.peak_mb() > 0.95 * peak  # Linux counts pages a little late


def test_a_process_counts_its_own_memory_alone() -> None:
    """Not that of the process that started it."""
    held = np.ones(50_000_000)  # 400 MB
    code = "from arfx.run.memory import peak_mb; print(peak_mb())"
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert 5 < float(told.stdout) < held.nbytes / 2**20


def test_a_system_without_a_record_tells_what_is_held_now(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(memory, "_STATUS", Path("/no such file"))
    assert 10 < memory.peak_mb() < 1e6
    monkeypatch.setitem(sys.modules, "resource", None)
    assert 10 < memory.peak_mb() < 1e6

    def nothing(*_: object) -> None:
        raise FileNotFoundError("/proc/meminfo")

    monkeypatch.setattr(psutil, "Process", nothing)
    monkeypatch.setattr(psutil, "virtual_memory", nothing)
    assert memory.peak_mb() == 0 and memory.free_mb() is None


def test_a_container_s_limit_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "_CONTAINER", tmp_path)
    free = memory.free_mb()
    assert free is not None and free > 3
    (tmp_path / "memory.current").write_text(f"{5 << 20}\n")
    (tmp_path / "memory.max").write_text(f"{8 << 20}\n")
    assert memory.free_mb() == 3
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.free_mb() > 3
