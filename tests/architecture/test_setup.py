"""Set-up without network: what make_venv decides, what it reads from a package index, and
what an old Python is told.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "tools" / "make_venv.py"


@pytest.fixture
def make_venv(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The script as a module whose project is an empty folder."""
    spec = importlib.util.spec_from_file_location("make_venv", SCRIPT)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(module, "STAMP", tmp_path / ".venv" / "arfx-installed.json")
    return module


def test_it_imports_only_the_standard_library() -> None:
    import ast

    tree = ast.parse(SCRIPT.read_text())
    names = {
        a.name.split(".")[0]
        for n in ast.walk(tree)
        if isinstance(n, ast.Import)
        for a in n.names
    }
    names |= {
        (n.module or "").split(".")[0]
        for n in ast.walk(tree)
        if isinstance(n, ast.ImportFrom)
    }
    assert names <= sys.stdlib_module_names


def test_an_old_python_gets_a_message() -> None:
    code = (
        "import sys; sys.version_info = (3, 10, 9);"
        f" exec(compile(open({str(SCRIPT)!r}).read(), 'make_venv', 'exec'))"
    )
    got = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (
        got.returncode == 2
        and "Python 3.11 or newer" in got.stderr
        and "help:" in got.stderr
        and "Traceback" not in got.stderr
    )


def test_a_second_call_installs_nothing(
    make_venv: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(make_venv, "install", lambda: calls.append("install"))
    monkeypatch.setattr(
        make_venv,
        "create",
        lambda: (
            calls.append("create"),
            (tmp_path / ".venv" / "bin").mkdir(parents=True),
        ),
    )
    monkeypatch.setattr(make_venv, "runs", lambda *_: True)
    (tmp_path / "pyproject.toml").write_text("a")
    make_venv.main()
    make_venv.venv_python().touch()
    assert calls == ["create", "install"]
    make_venv.main()
    assert calls == ["create", "install"], "nothing has changed"
    (tmp_path / "pyproject.toml").write_text("b")
    make_venv.main()
    assert calls == ["create", "install", "install"], "kept, and brought up to date"
    stamp = make_venv.STAMP
    stamp.write_text(
        json.dumps({**json.loads(stamp.read_text()), "root": "/elsewhere"})
    )
    (tmp_path / ".venv" / "bin" / "python").unlink()
    (tmp_path / ".venv" / "bin").rmdir()
    make_venv.main()
    assert calls[-2:] == ["create", "install"], "a moved tree is made anew"


def test_a_failed_installation_leaves_no_stamp(
    make_venv: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / ".venv").mkdir()
    monkeypatch.setattr(make_venv, "create", lambda: None)
    monkeypatch.setattr(
        make_venv,
        "pip_install",
        lambda *_: (1, "ERROR: Temporary failure in name resolution"),
    )
    with pytest.raises(SystemExit):
        make_venv.main()
    assert not make_venv.STAMP.exists()


def test_constraints_that_do_not_fit_are_left_out(
    make_venv: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[str, ...]] = []

    def pip(*words: str) -> tuple[int, str]:
        calls.append(words)
        return (
            (1, "ERROR: No matching distribution found for numba==0.68.1")
            if "-c" in words
            else (0, "")
        )

    monkeypatch.setattr(make_venv, "pip_install", pip)
    make_venv.install()
    assert ["-c" in c for c in calls] == [True, False]


def test_a_folder_that_is_no_environment_is_left_alone(
    make_venv: ModuleType, tmp_path: Path
) -> None:
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / "precious").write_text("x")
    with pytest.raises(SystemExit):
        make_venv.create()
    assert (tmp_path / ".venv" / "precious").exists()


def test_pip_wheels_are_read_from_both_kinds_of_index_page(
    make_venv: ModuleType,
) -> None:
    minor = sys.version_info[1]
    files = [
        ("pip-23.1-py3-none-any.whl", ">=3.7"),
        ("pip-26.0.1-py3-none-any.whl", ">=3.9"),
        ("pip-99.0-py3-none-any.whl", f">=3.{minor + 1}"),
        ("pip-25.0b1-py3-none-any.whl", ">=3.8"),
        ("pip-26.0.1.tar.gz", ">=3.9"),
    ]
    page = json.dumps(
        {
            "files": [
                {
                    "filename": n,
                    "url": f"../w/{n}",
                    "hashes": {"sha256": "ab"},
                    "requires-python": r,
                }
                for n, r in files
            ]
        }
    )
    rows = "".join(
        f'<a href="../w/{n}#sha256=ab"'
        f' data-requires-python="{r.replace(">", "&gt;")}">{n}</a>\n'
        for n, r in files
    )
    for text in (page, f"<html><body>{rows}</body></html>"):
        wheels = make_venv.wheels_on(text.encode(), "https://index/simple/pip/")
        assert [w[2] for w in wheels] == [
            "pip-23.1-py3-none-any.whl",
            "pip-26.0.1-py3-none-any.whl",
        ]
        assert (
            wheels[-1][1]
            == "https://index/simple/w/pip-26.0.1-py3-none-any.whl#sha256=ab"
        )


def test_a_wheel_with_another_hash_is_refused(
    make_venv: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = json.dumps(
        {
            "files": [
                {
                    "filename": "pip-26.0-py3-none-any.whl",
                    "url": "https://i/p",
                    "hashes": {"sha256": "0" * 64},
                }
            ]
        }
    )
    monkeypatch.setattr(
        make_venv,
        "open_url",
        lambda url, *_: page.encode() if "simple" in url else b"not the wheel",
    )
    with pytest.raises(SystemExit):
        make_venv.bootstrap_pip()


def test_every_dependency_is_pinned_and_explained() -> None:
    import re
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = [re.split(r"[<>=!~\[ ]", d)[0].lower() for d in project["dependencies"]]
    development = [
        re.split(r"[<>=!~\[ ]", d)[0].lower()
        for d in project["optional-dependencies"]["dev"]
    ]
    lines = [
        line
        for line in (ROOT / "constraints.txt").read_text().lower().splitlines()
        if "==" in line
    ]
    pinned = {line.split("==")[0] for line in lines}
    assert set(names + development) <= pinned
    reasons = (ROOT / "docs" / "adr" / "0001-libraries.md").read_text().lower()
    assert [
        n for n in names if f"| {n} " not in reasons and f"| {n} (" not in reasons
    ] == []
