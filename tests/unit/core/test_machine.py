"""How many cores may be used, wherever the system says so, and where it does not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from arfx.core import machine


@pytest.mark.parametrize(
    ("quota", "bound_to", "cores"),
    [
        (None, 6, 6),  # no control groups: what the process is bound to
        ("max 100000", 6, 6),
        ("250000 100000", 6, 2),
        ("50000 100000", 6, 1),
        ("900000 100000", 6, 6),
        ("nonsense", 6, 6),
        (None, None, 16),  # no affinity on this system: all cores
    ],
)
def test_usable_cores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quota: str | None, bound_to: int | None, cores: int
) -> None:
    if quota is not None:
        (tmp_path / "cpu.max").write_text(quota + "\n")
    monkeypatch.setattr(machine, "_QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "cpu_count", lambda: 16)
    if bound_to is None:
        monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    else:
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(bound_to)), raising=False)
    assert machine.usable_cores.__wrapped__() == cores
