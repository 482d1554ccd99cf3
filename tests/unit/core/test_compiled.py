"""Where compiled code is kept, and when it is stale."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import numba
import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile

from arfx.core import compiled

KERNEL = "from arfx.{} import SIZE\n@line_kernel()\ndef f(x):\n    return x + SIZE\n"


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package with compiled code that came with it, and a home; nothing is remembered
    from other tests.
    """
    home, package = tmp_path / "home", tmp_path / "package"
    home.mkdir()
    for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(home))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(compiled, "_PACKAGE", package)
    package.mkdir()
    (package / "size.py").write_text("SIZE = 3\n")
    (package / "loops.py").write_text(KERNEL.format("size"))
    shipped = shipped_in(package)
    shipped.mkdir(parents=True)
    (shipped / "a.f-1.py311.nbi").write_bytes(b"index")
    (shipped / "a.f-1.py311.1.nbc").write_bytes(b"code")
    compiled.code_folder.cache_clear()
    yield package
    compiled.code_folder.cache_clear()


def shipped_in(package: Path) -> Path:
    return package / "__pycache__" / f"compiled-{compiled._digest()}"


def unwritable(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    """The root user may write anywhere: permissions alone would test nothing for it."""
    filled = compiled._prepare_folder

    def refuses(place: Path, came: Path) -> bool:
        return not any(place.is_relative_to(folder) for folder in folders) and filled(
            place, came
        )

    monkeypatch.setattr(compiled, "_prepare_folder", refuses)


def test_compiled_code_lies_beside_the_modules(tree: Path) -> None:
    assert compiled.code_folder() == shipped_in(tree)


def test_a_named_folder_comes_first_and_holds_what_came_with_the_package(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "named"))
    kept = compiled.code_folder()
    assert kept.is_relative_to(tmp_path / "named")
    assert {p.name: p.read_bytes() for p in kept.iterdir()} == {
        "a.f-1.py311.nbi": b"index",
        "a.f-1.py311.1.nbc": b"code",
    }


def test_a_read_only_package_uses_the_users_folder_and_what_was_compiled_since_stays(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unwritable(monkeypatch, tree)
    kept = compiled.code_folder()
    assert kept.is_relative_to(tmp_path / "home")
    (kept / "a.f-1.py311.nbi").write_bytes(b"index of more")
    compiled.code_folder.cache_clear()
    assert compiled.code_folder() == kept
    assert (kept / "a.f-1.py311.nbi").read_bytes() == b"index of more"


def test_where_nothing_else_can_be_written_a_temporary_folder_is_used(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "home" / "named"))
    unwritable(monkeypatch, tree, tmp_path / "home")
    kept = compiled.code_folder()
    assert kept.is_relative_to(tmp_path / "temporary")
    assert (kept / "a.f-1.py311.1.nbc").read_bytes() == b"code"


def test_code_is_stale_when_what_it_calls_or_holds_has_changed(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digests = [compiled._digest()]
    assert compiled._digest() == digests[0]
    (tree / "another.py").write_text("SIZE = 5\n")
    assert compiled._digest() == digests[0]
    (tree / "size.py").write_text("SIZE = 4\n")
    digests.append(compiled._digest())
    (tree / "loops.py").write_text(KERNEL.format("another"))
    digests.append(compiled._digest())
    assert numba.config.SLP_VECTORIZE == 1
    monkeypatch.setenv("NUMBA_SLP_VECTORIZE", "0")
    digests.append(compiled._digest())
    assert len(set(digests)) == 4


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
    assert list(tmp_path.glob("arfx-*/compiled-*"))


def function(file: Path, source: str, **known: object) -> FunctionType:
    """`f` of this source, written into a file, as a function of arfx; known : what else its
    module holds
    """
    file.write_text(source)
    module = {"__name__": f"arfx.{file.stem}", "numba": numba, "np": np, **known}
    exec(compile(source, str(file), "exec"), module)
    return module["f"]


def test_the_folder_of_compiled_code_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody may clear caches while a job runs."""
    gone = tmp_path / "gone"
    monkeypatch.setattr(compiled, "code_folder", lambda: gone)
    made = function(tmp_path / "f.py", "def f():\n    return 0\n")
    compiled.CacheLocator(made).ensure_cache_path()
    assert gone.is_dir()


def test_code_for_a_type_that_is_gone_is_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An update may rename the named tuple that an index of the version before refers to."""
    monkeypatch.syspath_prepend(tmp_path)
    name = f"renamed_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text("class Pair:\n    pass\n")
    module = importlib.import_module(name)
    compiled._numba()
    index = IndexDataCacheFile(str(tmp_path), "a.f-1.py311", "stamp")
    index.save(module.Pair, "code")
    assert index.load(module.Pair) == "code"
    del module.Pair
    assert index.load("another") is None
    index.save("another", "its code")
    assert index.load("another") == "its code"


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
    compiled._numba()
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
    shipped_in(tree).chmod(0o777)
    kept = compiled.code_folder()
    assert kept.is_relative_to(tmp_path / "home") and not [*kept.iterdir()]
    named = tmp_path / "named"
    named.mkdir()
    named.chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(named))
    compiled.code_folder.cache_clear()
    assert compiled.code_folder() == kept
    assert named in {folder.parent for folder in compiled.open_folders}
    named.chmod(0o1777)  # as /tmp is: nobody replaces another's folder
    compiled.code_folder.cache_clear()
    assert compiled.code_folder().parent == named


def test_compiling_is_said_once_with_what_keeps_compiled_code_from_being_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(compiled, "open_folders", [Path("open")])
    notices: list[str] = []
    with compiled.telling(notices.append):
        for number in (1, 1.5, 2):
            numba.njit(lambda x: x + 1)(number)
    numba.njit(lambda x: x + 2)(1)
    compiling, others = notices
    assert compiling.startswith("compiling kernels, once") and "chmod go-w" in others


def test_compiling_is_no_part_of_a_jobs_time() -> None:
    before = compiled.work_clock()
    began = time.perf_counter()
    numba.njit(lambda x: x * 3 + 1)(2.5)
    passed = time.perf_counter() - began
    assert compiled.work_clock() - before < passed / 2
