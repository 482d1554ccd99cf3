"""Where compiled code is kept, and when it is stale."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import FunctionType

import numba
import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile

from arfx.core import compiled


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package's folder with compiled code in it, and a home; nothing is remembered from
    other tests.
    """
    home = tmp_path / "home"
    home.mkdir()
    for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(home))
    beside = tmp_path / "package" / "__pycache__"
    beside.mkdir(parents=True)
    (beside / "a.f-1.py311.nbi").write_bytes(b"index")
    (beside / "a.f-1.py311.1.nbc").write_bytes(b"code")
    for cached in (compiled.code_folder, compiled._folder_of_this_run):
        cached.cache_clear()
    yield beside.parent
    for cached in (compiled.code_folder, compiled._folder_of_this_run):
        cached.cache_clear()


def unwritable(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    """The root user may write anywhere: permissions alone would test nothing for it."""
    filled = compiled._prepare_folder

    def refuses(place: Path, came: list[Path]) -> bool:
        return not any(place.is_relative_to(folder) for folder in folders) and filled(
            place, came
        )

    monkeypatch.setattr(compiled, "_prepare_folder", refuses)


def test_compiled_code_lies_beside_the_modules(tree: Path) -> None:
    assert compiled.code_folder(tree) == tree / "__pycache__"
    assert compiled.cache_persists()


def test_a_named_folder_comes_first_and_holds_what_came_with_the_package(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "named"))
    kept = compiled.code_folder(tree)
    assert kept.is_relative_to(tmp_path / "named")
    assert {p.name: p.read_bytes() for p in kept.iterdir()} == {
        "a.f-1.py311.nbi": b"index",
        "a.f-1.py311.1.nbc": b"code",
    }


def test_a_read_only_package_uses_the_users_folder_and_what_was_compiled_since_stays(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unwritable(monkeypatch, tree)
    kept = compiled.code_folder(tree)
    assert kept.is_relative_to(tmp_path / "home")
    (kept / "a.f-1.py311.nbi").write_bytes(b"index of more")
    compiled.code_folder.cache_clear()
    assert (
        compiled.code_folder(tree) == kept
        and (kept / "a.f-1.py311.nbi").read_bytes() == b"index of more"
    )
    (tree / "__pycache__" / "a.f-1.py311.1.nbc").write_bytes(b"code of another release")
    compiled.code_folder.cache_clear()
    assert (
        compiled.code_folder(tree) / "a.f-1.py311.1.nbc"
    ).read_bytes() == b"code of another release"


def test_where_nothing_can_be_written_a_folder_of_this_run_is_used_and_passed_on(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "home" / "named"))
    unwritable(monkeypatch, tree, tmp_path / "home", Path(compiled.__file__).parent)
    kept = compiled.code_folder(tree)
    assert (kept / "a.f-1.py311.1.nbc").read_bytes() == b"code"
    assert not compiled.cache_persists()
    assert kept.is_relative_to(os.environ["NUMBA_CACHE_DIR"])


@pytest.mark.process
def test_every_module_loads_where_neither_the_package_nor_the_home_can_be_written(
    tmp_path: Path,
) -> None:
    code = """
import pathlib, tempfile, sys
made = tempfile.TemporaryFile
def refuse(*a, dir=None, **k):
    if dir is not None and not str(dir).startswith(sys.argv[1]):
        raise PermissionError(13, "Permission denied", str(dir))
    return made(*a, dir=dir, **k)
tempfile.TemporaryFile = refuse
import arfx.core.rect, arfx.media.samples, arfx.stages.composite
"""
    got = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert got.returncode == 0, got.stderr
    assert not list(tmp_path.iterdir()), "the folder of the run stays behind"


def function(file: Path, source: str, **known: object) -> FunctionType:
    """`f` of this source, written into a file, as a function of arfx; known : what else its
    module holds
    """
    file.write_text(source)
    module = {"__name__": f"arfx.{file.stem}", "numba": numba, "np": np, **known}
    exec(compile(source, str(file), "exec"), module)
    return module["f"]


CALLS = "def f(x):\n    return KIND(g(x) + SIZE + TABLE[0])\n"


def stamp(
    tmp_path: Path,
    caller: str = CALLS,
    callee: str = "@numba.njit\ndef f(x):\n    return x\n",
    size: int = 3,
    kind: type = np.float32,
) -> str:
    compiled._file_digest.cache_clear()
    called = function(tmp_path / "callee.py", callee)
    made = function(
        tmp_path / "caller.py", caller, SIZE=size, TABLE=np.full(2, size), KIND=kind
    )
    made.__globals__["g"] = called  # after it: what it calls may stand further down
    stamp = compiled.CacheLocator(made, str(tmp_path / "caller.py")).get_source_stamp()
    assert stamp == stamp.digest and stamp.__reduce__() == (str, (stamp.digest,))
    return stamp.digest


def test_code_is_stale_when_what_it_calls_or_holds_has_changed(tmp_path: Path) -> None:
    before = stamp(tmp_path)
    assert stamp(tmp_path) == before
    assert stamp(tmp_path, size=4) != before
    assert stamp(tmp_path, kind=np.float64) != before
    assert stamp(tmp_path, caller=CALLS + "# another\n") != before
    assert stamp(tmp_path, callee="@numba.njit\ndef f(x):\n    return x + 1\n") != before


def test_code_is_stale_when_a_named_tuple_that_it_takes_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fields are taken by their place: another order would give one array for the other."""
    monkeypatch.syspath_prepend(tmp_path)
    name = f"tuples_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(
        "from typing import NamedTuple\nclass Pair(NamedTuple):\n    a: int\n    b: int\n"
    )
    pair, source = (
        importlib.import_module(name).Pair,
        "def f(pair: Pair):\n    return pair.a\n",
    )
    stamps = []
    for _ in range(2):
        compiled._file_digest.cache_clear()
        stamps.append(
            compiled.CacheLocator(
                function(tmp_path / "takes.py", source, Pair=pair), "takes.py"
            )
            .get_source_stamp()
            .digest
        )
        (tmp_path / f"{name}.py").write_text(
            "from typing import NamedTuple\nclass Pair(NamedTuple):\n    b: int\n    a:"
            " int\n"
        )
    assert stamps[0] != stamps[1]


def test_code_for_a_type_that_is_gone_is_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An update may rename the named tuple that an index of the version before refers to."""
    monkeypatch.syspath_prepend(tmp_path)
    name = f"renamed_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text("class Pair:\n    pass\n")
    module = importlib.import_module(name)
    compiled.CacheLocator.from_function(
        function(tmp_path / "f.py", "def f():\n    return 0\n"), "f.py"
    )
    index = IndexDataCacheFile(str(tmp_path), "a.f-1.py311", "stamp")
    index.save(module.Pair, "code")
    assert index.load(module.Pair) == "code"
    del module.Pair
    assert index.load("another") is None
    index.save("another", "its code")
    assert index.load("another") == "its code"


def test_code_that_was_compiled_without_the_slp_pass_is_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert numba.config.SLP_VECTORIZE == 1
    before = stamp(tmp_path)
    monkeypatch.setenv("NUMBA_SLP_VECTORIZE", "0")
    assert stamp(tmp_path) != before


def test_a_line_kernel_counts_no_references(tmp_path: Path) -> None:
    """If numba drops the flag behind `line_kernel` this fails. Then leave the flag out of
    `line_kernel`: nothing else names it, results stay the same, and kernels that go by
    lines get up to a quarter slower. `arfx bench --stage composite` and `make bench` say
    how much; where it is too much, pass indices in place of parts of arrays."""
    source = (
        "def f(lines, out):\n    for y in range(len(out)):\n        out[y] = g(lines[y])\n"
    )
    first = compiled.line_kernel()(
        function(tmp_path / "first.py", "def f(line):\n    return line[0]\n")
    )
    f = compiled.line_kernel()(function(tmp_path / "calls.py", source, g=first))
    lines, out = np.arange(6.0).reshape(3, 2), np.zeros(3)
    f(lines, out)
    assert list(out) == [0, 2, 4]
    assert "NRT_incref" not in f.inspect_llvm(f.signatures[0])


def test_nothing_else_names_the_flag() -> None:
    root = Path(compiled.__file__).parents[2]
    naming = [
        p.name
        for folder in ("arfx", "cli", "tools")
        for p in (root / folder).rglob("*.py")
        if "_nrt" in p.read_text()
    ]
    assert naming == ["compiled.py"]


@pytest.mark.parametrize("ending", [".nbi", ".1.nbc"])
@pytest.mark.parametrize("how", ["empty", "cut", "noise"])
def test_a_damaged_file_is_stale(tmp_path: Path, ending: str, how: str) -> None:
    compiled.CacheLocator.from_function(
        test_a_damaged_file_is_stale, __file__
    )  # which teaches numba
    kept = IndexDataCacheFile(str(tmp_path), "f", "stamp")
    kept.save("key", list(range(100)))
    file = tmp_path / f"f{ending}"
    whole = file.read_bytes()
    file.write_bytes(
        {"empty": b"", "cut": whole[: len(whole) // 2], "noise": whole[:-8] + b"\xff" * 8}[
            how
        ]
    )
    assert kept.load("key") is None
    kept.save("key", [1])
    assert kept.load("key") == [1], "it is compiled again, and kept"


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_folder_that_others_may_write_to_is_not_used_and_nothing_is_copied_from_it(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "open_folders", [])
    (tree / "__pycache__").chmod(0o777)
    kept = compiled.code_folder(tree)
    assert kept.is_relative_to(tmp_path / "home") and not [*kept.iterdir()]
    named = tmp_path / "named"
    named.mkdir()
    named.chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(named))
    compiled.code_folder.cache_clear()
    assert compiled.code_folder(tree) == kept
    assert named in {folder.parent for folder in compiled.open_folders}
    named.chmod(0o1777)  # as /tmp is: nobody replaces another's folder
    compiled.code_folder.cache_clear()
    assert compiled.code_folder(tree).parent == named
