"""How many cores may be used, wherever the system says so, and where it does not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from arfx.core import machine
from arfx.measure.costs_output import write_clip
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.media.output import OutputSettings, plan_output
from arfx.media.writer import ChunkWriter, chunk_suffix


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
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    quota: str | None,
    bound_to: int | None,
    cores: int,
) -> None:
    if quota is not None:
        (tmp_path / "cpu.max").write_text(quota + "\n")
    monkeypatch.setattr(machine, "_QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "cpu_count", lambda: 16)
    if bound_to is None:
        monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    else:
        monkeypatch.setattr(
            os, "sched_getaffinity", lambda _: set(range(bound_to)), raising=False
        )
    assert machine.usable_cores.__wrapped__() == cores


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0,
    reason="the encoder does this as root alone",
)
def test_the_av1_encoder_takes_the_machine_from_nobody(tmp_path: Path) -> None:
    def scheduling() -> set[int]:
        return {
            os.sched_getscheduler(thread)
            for thread in map(int, os.listdir("/proc/self/task"))  # noqa: PTH208 - {os.SCHED_BATCH}
        }

    info = probe(write_clip(tmp_path / "clip.mp4", 128, 96, 4))
    plan = plan_output(info, tmp_path / "out.mkv", OutputSettings("av1"))
    path = tmp_path / f"chunk{chunk_suffix(plan)}"
    before = scheduling()
    with ClipReader(info) as reader, ChunkWriter(plan, info, path) as writer:
        for frame in reader.frames():
            writer.write(frame)
        assert scheduling() == before
    assert scheduling() == before
