"""Where compiled code is kept, and when it is stale."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType

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
    (tree / "__pycache__" / "a.f-1.py311.1.nbc").write_bytes(
        b"code of another release"
    )
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


CALLER = (
    "from arfx.callee import (\n    g,\n    SIZE,\n)\nfrom arfx.size import OTHER\n"
)
CALLEE = (
    "from arfx.size import SIZE\n@line_kernel()\ndef g(x):\n    return x + SIZE\n"
)


@pytest.fixture
def stamp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """The stamp of a function in `caller`, which imports of `callee`, as that of `size`."""

    def stamped(**texts: str) -> str:
        texts = {
            "caller": CALLER,
            "callee": CALLEE,
            "size": "SIZE = OTHER = 3\n",
        } | texts
        for name, text in texts.items():
            file = tmp_path / f"{name}.py"
            file.write_text(text)
            module = ModuleType(f"arfx.{name}")
            module.__file__ = str(file)
            monkeypatch.setitem(sys.modules, module.__name__, module)
        compiled._stamp.cache_clear()
        compiled._text.cache_clear()
        made = function(tmp_path / "f.py", "def f():\n    return 0\n")
        return compiled.CacheLocator(
            made, str(tmp_path / "caller.py")
        ).get_source_stamp()

    yield stamped
    compiled._stamp.cache_clear()
    compiled._text.cache_clear()


def test_the_folder_of_compiled_code_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody may clear caches while a job runs."""
    gone = tmp_path / "gone"
    monkeypatch.setattr(compiled, "code_folder", lambda folder: gone)
    made = function(tmp_path / "f.py", "def f():\n    return 0\n")
    compiled.CacheLocator(made, str(tmp_path / "f.py")).ensure_cache_path()
    assert gone.is_dir()


def test_code_is_stale_when_what_it_calls_or_holds_has_changed(
    stamp: Callable[..., str],
) -> None:
    before = stamp()
    assert stamp() == before
    assert stamp(caller=CALLER + "# another\n") != before
    assert stamp(callee=CALLEE.replace("x + SIZE", "x - SIZE")) != before
    assert stamp(size="SIZE = OTHER = 4\n") != before


def test_code_is_stale_when_what_it_calls_is_given_another_value(
    stamp: Callable[..., str],
) -> None:
    caller = "from arfx.callee import g\n"
    assert stamp(caller=caller) != stamp(caller=caller, size="SIZE = 4\n")


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
    stamp: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert numba.config.SLP_VECTORIZE == 1
    before = stamp()
    monkeypatch.setenv("NUMBA_SLP_VECTORIZE", "0")
    assert stamp() != before


def test_every_compiling_module_is_known_as_one() -> None:
    """What such a module imports counts into the stamp of whoever calls it."""
    root = Path(compiled.__file__).parents[1]
    decorated = re.compile(r"^@.*(kernel|jit)\b", re.MULTILINE)
    texts = [file.read_text() for file in root.rglob("*.py")]
    assert sum(map(bool, map(decorated.search, texts))) > 10
    for text in filter(decorated.search, texts):
        assert compiled._COMPILES.search(text)


def test_a_line_kernel_counts_no_references(tmp_path: Path) -> None:
    """If numba drops the flag behind `line_kernel` this fails. Then leave the flag out of
    `line_kernel`: nothing else names it, results stay the same, and kernels that go by
    lines get up to a quarter slower. `arfx bench --stage composite` and `make bench` say
    how much; where it is too much, pass indices in place of parts of arrays."""
    source = "def f(lines, out):\n    for y in range(len(out)):\n        out[y] = g(lines[y])\n"
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
        {
            "empty": b"",
            "cut": whole[: len(whole) // 2],
            "noise": whole[:-8] + b"\xff" * 8,
        }[how]
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
