"""The shaders' folder outlives the process, and is made again where it is not what it should be."""

from __future__ import annotations

from pathlib import Path

import pytest

from arfx.stages.raster.gl_shaders import FRAGMENT, shader_folder


def test_one_folder_in_the_cache_for_every_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = Path(shader_folder())
    assert kept.parent == tmp_path / "arfx" and (kept / "gbuffer.frag").read_text() == FRAGMENT
    (kept / "gbuffer.frag").write_text("cut sh")
    assert Path(shader_folder()) == kept and (kept / "gbuffer.frag").read_text() == FRAGMENT
    assert {p.name for p in kept.iterdir()} == {"gbuffer.vert", "gbuffer.frag"}


def test_a_cache_that_cannot_be_written_costs_a_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "arfx").write_text("a file in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert (Path(shader_folder()) / "gbuffer.frag").read_text() == FRAGMENT
