"""The doctor tries things: what is broken is seen to be broken."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from arfx.errors import ConfigError
from arfx.measure import machine
from arfx.measure.machine import Check, essentials_work, examine
from arfx.media.codecs import CODECS


def test_this_machine_is_examined_in_every_respect(tmp_path: Path) -> None:
    checks = examine(tmp_path)
    assert {c.group for c in checks} == {
        "python",
        "package",
        "renderer",
        "codec",
        "machine",
    }
    assert {"rays", "h264", "ffv1", "exr", "numpy", "cores", "disk"} <= {
        c.name for c in checks
    }
    assert essentials_work(checks), [c for c in checks if not c.ok]
    assert all(c.fix for c in checks if not c.ok) and not any(
        c.fix for c in checks if c.ok
    )


def test_an_encoder_that_does_not_work_is_found_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = replace(CODECS["ffv1"], encoder="nosuchcodec")
    monkeypatch.setitem(CODECS, "ffv1", broken)  # type: ignore[misc]
    checks = {c.name: c for c in machine._codecs()}
    assert "nosuchcodec" in checks["ffv1"].detail and "av" in checks["ffv1"].fix
    assert checks["h264"].ok and checks["h264"].essential and checks["png"].ok


def test_a_missing_package_has_its_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "PACKAGES", ("numpy", "no-such-package-here"))
    good, bad = [c for c in machine._python() if c.group == "package"][:2]
    assert (
        good.ok
        and not bad.ok
        and bad.essential
        and bad.fix == "pip install no-such-package-here"
    )


def test_sound_needs_the_essential_and_one_renderer() -> None:
    rays, gl = (
        Check("renderer", "rays", True, ""),
        Check("renderer", "pyrender", False, "", "apt-get"),
    )
    other = Check("codec", "av1", False, "", "fix")
    assert essentials_work([rays, gl, other])
    assert not essentials_work([gl, other])
    assert not essentials_work(
        [rays, Check("codec", "h264", False, "", "fix", essential=True)]
    )


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    (disk,) = [c for c in machine._resources(tmp_path / "none") if c.name == "disk"]
    assert not disk.ok and disk.fix


def test_a_plug_in_that_does_not_load_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = {
        "mist": ConfigError(
            "stage 'mist' of one 1.2 cannot be loaded", "uninstall it"
        )
    }
    monkeypatch.setattr(
        machine,
        "STAGES",
        SimpleNamespace(plugins={"mist": None, "haze": None}, broken=broken),
    )
    haze, mist = sorted(machine._plugins(), key=lambda c: c.name)
    assert (
        haze.ok
        and not mist.ok
        and "one 1.2" in mist.detail
        and mist.fix == "uninstall it"
    )
