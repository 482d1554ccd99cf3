"""The table of stages takes in those of other distributions, in their places, and says what
is wrong with one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Step
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage, Stage, View
from arfx.errors import ConfigError, RenderError
from arfx.plan.planner import plan_frame
from arfx.run import parameters
from arfx.run.folder import code_digest
from arfx.run.frame import run_frame
from arfx.stages import Table

BUILT_IN = {
    "raster": "arfx.stages.raster.Raster", "composite": "arfx.stages.composite.Composite", "dof": "arfx.stages.dof.Dof",
}  # fmt: skip
STAGE = """
from arfx.core.layers import Layer
from arfx.core.stage import Stage

class Effect(Stage):
    name = "{name}"

    def run(self, view, prepared):
        return {{}}
"""
NEEDS = """
from arfx.core.settings import Settings
from arfx.core.stage import Stage

class Needed(Settings):
    must: int

class Effect(Stage):
    name, Params = "mist", Needed

    def run(self, view, prepared):
        return {{}}
"""
Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Puts a distribution on the path whose module holds a stage."""
    monkeypatch.syspath_prepend(tmp_path)

    def run(
        dist: str,
        name: str,
        source: str = STAGE,
        cls: str = "Effect",
    ) -> Path:
        module = tmp_path / f"{dist.replace('-', '_')}_of_{name}.py"
        monkeypatch.delitem(sys.modules, module.stem, raising=False)
        module.write_text(source.format(name=name))
        info = tmp_path / f"{dist.replace('-', '_')}-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {dist}\nVersion: 1.2\n"
        )
        (info / "entry_points.txt").write_text(
            f"[arfx.stages]\n{name} = {module.stem}:{cls}\n"
        )
        return module

    return run


def test_they_come_last_by_name(install: Install) -> None:
    install("one", "mist")
    module = install("two", "haze")
    table = Table(BUILT_IN)
    assert list(table) == [*BUILT_IN, "haze", "mist"] and len(table) == 5
    assert "haze" in table and "fog" not in table and table["mist"].name == "mist"
    assert table.source("haze") == (module, "1.2")


def test_source_and_version_tell_one_state_of_it_from_another(
    install: Install,
) -> None:
    module = install("one", "mist")
    first = code_digest(module, "1.2")
    code_digest.cache_clear()
    assert code_digest(module, "1.2") == first != code_digest(module, "1.3")
    module.write_text(module.read_text() + "\n")
    code_digest.cache_clear()
    assert code_digest(module, "1.2") != first


def test_a_name_is_taken_once(install: Install) -> None:
    install("one", "mist")
    install("two", "mist")
    with pytest.raises(
        ConfigError, match=r"'mist' is in (one|two) 1\.2 and in (two|one) 1\.2"
    ):
        list(Table(BUILT_IN))


def test_a_built_in_name_is_taken(install: Install) -> None:
    install("one", "dof")
    with pytest.raises(ConfigError, match=r"'dof' is in arfx itself and in one 1\.2"):
        list(Table(BUILT_IN))


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (
            {"source": "import a_module_that_is_not_there"},
            r"'mist' of one 1\.2 cannot be loaded: ModuleNotFoundError",
        ),
        (
            {"source": "class Effect: pass"},
            r"one_of_mist:Effect of one 1\.2 is not a Stage named 'mist'",
        ),
        (
            {"source": "raise SystemExit(0)"},
            r"'mist' of one 1\.2 cannot be loaded: SystemExit: 0",
        ),
        ({"cls": "Other"}, r"'mist' of one 1\.2 cannot be loaded: AttributeError"),
        (
            {"source": NEEDS},
            r"'mist' of one 1\.2 cannot be loaded: ValidationError: .*\n.*must",
        ),
    ],
)
def test_what_is_wrong_with_one_is_said_in_one_message(
    install: Install, what: dict[str, str], said: str
) -> None:
    install("one", "mist", **what)
    table = Table(BUILT_IN)
    with pytest.raises(ConfigError, match=said):
        table["mist"]
    assert list(table) == list(BUILT_IN), "jobs that do not name it go on"
    assert list(table.broken) == ["mist"]


def test_prints_of_a_plug_in_that_is_loaded_are_no_results(
    install: Install, capsys: pytest.CaptureFixture[str]
) -> None:
    install("one", "mist", source="print('hello')\n" + STAGE)
    assert "mist" in list(Table(BUILT_IN))
    assert capsys.readouterr() == ("", "hello\n")


class Plug(Stage):
    name, distribution = "plug", "one 1.2"
    result: Any = SystemExit(0)

    def run(self, view: View, prepared: Any) -> Any:
        if isinstance(self.result, BaseException):
            raise self.result
        return self.result


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (SystemExit(0), r"'plug' of one 1\.2 fails in frame 7: SystemExit: 0"),
        (
            ZeroDivisionError("by 0"),
            r"'plug' of one 1\.2 fails in frame 7: ZeroDivisionError: by 0",
        ),
        (
            {"imaeg": None},
            r"'plug' of one 1\.2 fails in frame 7: .*layer 'imaeg'; it writes image",
        ),
        (
            None,
            r"'plug' of one 1\.2 fails in frame 7: .*returns NoneType; it must return {Layer",
        ),
        (
            {Layer.IMAGE: np.zeros((4, 4, 1), np.float32)},
            r"'plug' of one 1\.2 fails in frame 7: .*shape \(4, 4, 1\); it must be \(4, 4, 3\)",
        ),
    ],
)
def test_what_a_plug_in_raises_or_returns_wrong_names_it_and_the_frame(
    result: Any, said: str
) -> None:
    stage, rect = Plug(), Rect(0, 0, 4, 4)
    stage.result = result
    scene, facts = SimpleNamespace(seed=0), SimpleNamespace(index=7)
    ready = {"plug": ReadyStage.of(stage, scene, "standard")}
    plan = FramePlan(
        7, rect, rect, (Step("plug", "standard", rect, rect, "", None),), ()
    )
    with pytest.raises(RenderError, match=said):
        run_frame(np.zeros((4, 4, 3), np.float32), facts, plan, ready)


def test_a_plug_in_whose_demand_is_no_demand_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rect = Rect(0, 0, 4, 4)
    monkeypatch.setattr(Plug, "without_object", True)
    monkeypatch.setattr(Plug, "demand", lambda *_: rect)
    facts: Any = SimpleNamespace(index=7, present=False)
    said = r"'plug' of one 1\.2 fails when frame 7 is planned: .*its demand is a Rect"
    with pytest.raises(RenderError, match=said):
        plan_frame([Plug()], {"plug": "standard"}, facts, SimpleNamespace(), rect)


def test_a_plug_in_that_cannot_be_made_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: Any) -> None:
        raise ZeroDivisionError("by 0")

    monkeypatch.setattr(Plug, "__init__", fails)
    monkeypatch.setattr(parameters, "_printed", lambda name: {})
    monkeypatch.setattr(parameters, "STAGES", {"plug": Plug})
    said = r"'plug' of one 1\.2 fails while it is made: ZeroDivisionError: by 0"
    with pytest.raises(RenderError, match=said):
        parameters.stage_of("plug", None)
