"""Imports run one way, modules stay small, nothing is called by an empty name."""

from __future__ import annotations

import ast
import graphlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FIRST = {"errors", "core"}
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "core": {"errors"},
    "config": FIRST,
    "media": FIRST,
    "calibrate": FIRST,
    "stages": FIRST,
    "analyse": FIRST,
    "synth": FIRST | {"media"},
    "plan": FIRST,
}
ALLOWED["papers"] = FIRST | {"stages", "analyse"}
ALLOWED["run"] = FIRST | {
    "config",
    "media",
    "calibrate",
    "synth",
    "stages",
    "analyse",
    "papers",
    "plan",
}
ALLOWED["measure"] = ALLOWED["run"] | {"run"}
ALLOWED["reproduce"] = ALLOWED["measure"] | {"measure"}
ALLOWED["arfx_cli"] = ALLOWED["reproduce"] | {"reproduce"}
CORE_LIBRARIES = {"cv2", "numpy", "pydantic", "pydantic_core", "scipy"}
EMPTY_NAMES = {
    "utils",
    "util",
    "helpers",
    "helper",
    "manager",
    "base",
    "misc",
    "common",
}
# Lines of those that are still to be split: they may only get shorter.
LONG = {
    "arfx/media/clip.py": 425,
    "arfx/run/job.py": 488,
    "arfx/synth/description.py": 402,
}
MODULES = sorted(
    [*(ROOT / "arfx").rglob("*.py"), *(ROOT / "cli" / "arfx_cli").rglob("*.py")]
)


def room(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    if parts[0] == "cli":
        return "arfx_cli"
    return parts[1].removesuffix(".py")


def imported(tree: ast.AST) -> list[str]:
    out: list[str] = []
    for n in ast.walk(tree):
        if isinstance(n, ast.ImportFrom):
            assert n.level == 0, "relative imports hide where a name comes from"
            if n.module == "arfx":
                out += [f"arfx.{a.name}" for a in n.names]
            elif n.module:
                out.append(n.module)
        elif isinstance(n, ast.Import):
            out += [a.name for a in n.names]
    return out


def wrong_imports(source: str, here: str) -> list[str]:
    bad = []
    for name in imported(ast.parse(source)):
        top, *rest = name.split(".")
        if top not in ("arfx", "arfx_cli"):
            if (
                here == "core"
                and top not in {"__future__", *CORE_LIBRARIES}
                and top not in __import__("sys").stdlib_module_names
            ):
                bad.append(name)
            continue
        there = "arfx_cli" if top == "arfx_cli" else (rest[0] if rest else "")
        if there in ("", "__version__") or there == here:
            continue
        if there not in ALLOWED[here]:
            bad.append(name)
    return bad


@pytest.mark.parametrize(
    "path",
    [p for p in MODULES if p != ROOT / "arfx" / "__init__.py"],
    ids=lambda p: str(p.relative_to(ROOT)),
)
def test_imports_go_one_way(path: Path) -> None:
    assert not wrong_imports(path.read_text(), room(path))


def test_the_import_rule_rejects_a_wrong_import() -> None:
    assert wrong_imports("from arfx.run import job", "stages") == ["arfx.run"]
    assert wrong_imports("import av", "core") == ["av"]
    assert wrong_imports("from arfx.core.rect import Rect", "media") == []


def module_name(path: Path) -> str:
    parts = (
        path.relative_to(ROOT / "cli" if room(path) == "arfx_cli" else ROOT)
        .with_suffix("")
        .parts
    )
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def circle(uses: dict[str, set[str]]) -> list[str]:
    """Modules that import each other, [] if there are none."""
    try:
        graphlib.TopologicalSorter(uses).prepare()
    except graphlib.CycleError as e:
        return list(e.args[1])
    return []


def test_no_modules_import_each_other() -> None:
    """Wherever an import is written, in a function or for types alone too."""
    sources = {module_name(path): ast.parse(path.read_text()) for path in MODULES}
    uses: dict[str, set[str]] = {}
    for name, tree in sources.items():
        found = {
            f"{n.module}.{a.name}"
            for n in ast.walk(tree)
            if isinstance(n, ast.ImportFrom) and n.module
            for a in n.names
        }
        names = {
            full if full in sources else full.rpartition(".")[0] for full in found
        }
        uses[name] = (names & sources.keys()) - {name}
    assert not circle(uses)


def test_a_circle_is_found() -> None:
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"a"}})) == {
        "a",
        "b",
        "c",
    } and not circle({"a": {"b"}, "b": set()})


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_modules_stay_small_and_named(path: Path) -> None:
    most = LONG.get(str(path.relative_to(ROOT)), 400)
    assert len(path.read_text().splitlines()) <= most, (
        "split it along a seam that a newcomer would expect"
    )
    assert path.stem not in EMPTY_NAMES
    if path.stem != "__init__":
        assert ast.get_docstring(ast.parse(path.read_text())), (
            "a module's header says what it does"
        )


def test_scipy_is_imported_where_it_is_called() -> None:
    """It takes a quarter of a second, in every process of a job.

    References are loaded by who asks for them.
    """
    rooms = ("analyse", "media", "run", "stages")
    files = [
        p
        for room in rooms
        for p in (ROOT / "arfx" / room).rglob("*.py")
        if p.name != "reference.py"
    ]
    early = [
        p.name
        for p in files
        if re.search(
            r"^(from|import) scipy", p.read_text(encoding="utf-8"), re.MULTILINE
        )
    ]
    assert len(files) > 100 and not early
