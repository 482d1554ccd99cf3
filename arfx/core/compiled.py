"""How loops are compiled: for which processor, where compiled code is kept, when it is
stale, and options of loops by lines.

numba alone compiles for the very processor that it runs on, fails where neither the package
nor the home can be written, passes over compiled code that came with a package that cannot
be written, and does not see that a function of another module, which is compiled in, has
changed. `configure_numba`, called before numba is imported, sets the target and
`CacheLocator`."""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

from arfx.core.machine import cache_folder, instructions

FAST = {
    "contract",
    "nsz",
    "arcp",
}  # what the compiler may do to rounding in most loops
_PACKAGES = ("arfx", "arfx_cli")
_NUMBAS = (
    "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,"
    "ZipCacheLocator"
)
# What every x86-64 processor since 2013 (Intel) or 2015 (AMD) can do: code for it can be shipped.
TARGET = "x86-64-v3"
_REQUIRED = {"abm", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"}
# Four channels of a pixel, written one by one, become one vector. Off by default, and not
# part of the index of cached code.
_SLP = "NUMBA_SLP_VECTORIZE"
_IMPORTS = re.compile(r"^from (arfx[\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)
_COMPILES = re.compile(r"^@(line_)?kernel\b", re.MULTILINE)
_LOCATORS, _FOLDER = "NUMBA_CACHE_LOCATOR_CLASSES", "NUMBA_CACHE_DIR"


def configure_numba() -> None:
    """Set numba's environment, for this process and those that it starts."""
    ours = f"{__name__}.{CacheLocator.__name__}"
    others = os.environ.get(_LOCATORS) or _NUMBAS
    if ours not in others.split(","):
        os.environ[_LOCATORS] = f"{ours},{others}"
    os.environ.setdefault(_SLP, "1")
    if target_cpu():
        os.environ.setdefault("NUMBA_CPU_NAME", TARGET)
        os.environ.setdefault("NUMBA_CPU_FEATURES", "")  # those of TARGET
    if "numba" in sys.modules:  # imported before arfx
        import_module("numba.core.config").reload_config()


@functools.cache
def target_cpu() -> str:
    """The processor to compile for: TARGET; "" = this very one, where TARGET's instructions
    are lacking or not known.
    """
    return TARGET if instructions() >= _REQUIRED else ""


def kernel(**options: Any) -> Any:
    """`numba.njit` as all loops here want it: kept, without Python's lock, and without a
    second entry point for C, which would take an eighth of the time to compile.

    options : more of njit"""
    return import_module("numba").njit(
        cache=True, nogil=True, no_cfunc_wrapper=True, **options
    )


def line_kernel(**options: Any) -> Any:
    """A `kernel` that is called for every line or ray and counts no references to arrays.

    Otherwise each array or slice that is made or passed on costs two locked additions: a
    fifth of a line kernel's time, half of the ray tracer's, and more where two threads
    count the same array's. Such a function allocates no arrays: its caller, which counts,
    allocates scratch and owns the arguments."""
    return kernel(_nrt=False, **options)


class CacheLocator:
    """numba's "cache locator" of one function of arfx."""

    def __init__(self, function: FunctionType, file: str) -> None:
        self._function, self._file = function, file

    @classmethod
    def from_function(
        cls, py_func: FunctionType, py_file: str
    ) -> CacheLocator | None:
        _take_damaged_files_for_stale()
        ours = py_func.__module__.partition(".")[0] in _PACKAGES
        there = os.path.exists(py_file)  # noqa: PTH110
        return cls(py_func, py_file) if ours and there else None

    def get_cache_path(self) -> str:
        return str(code_folder(Path(self._file).parent))

    def ensure_cache_path(self) -> None:
        Path(self.get_cache_path()).mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        return _stamp(self._file)

    def get_disambiguator(self) -> str:
        return str(self._function.__code__.co_firstlineno)


@functools.cache
def _take_damaged_files_for_stale() -> None:
    """numba alone fails when it reads one: cut short, or of a type that the code no longer
    has. It is compiled again.
    """
    index_file = import_module("numba.core.caching").IndexDataCacheFile
    load_index, load_data = index_file._load_index, index_file._load_data

    def index_or_empty(self: Any) -> Any:
        try:
            return dict(load_index(self))
        except Exception:  # whatever damaged bytes make `pickle` raise
            return {}

    def data_or_missing(self: Any, name: str) -> Any:
        try:
            return load_data(self, name)
        except Exception as e:
            raise FileNotFoundError(name) from e

    index_file._load_index, index_file._load_data = index_or_empty, data_or_missing


@functools.cache
def _stamp(file: str) -> str:
    """Digest of all that functions compiled in a module depend on: its text, and that of the
    modules of arfx that it imports from, of those that compile too with what these import."""
    text = _text(file)
    names = set[str]()
    for module, imported in _IMPORTS.findall(text):
        names |= {
            module,
            *(f"{module}.{name}" for name in re.findall(r"\w+", imported)),
        }
    parts = [f"{_SLP}={os.environ.get(_SLP)}", text]
    for name in sorted(names & sys.modules.keys()):
        other = str(sys.modules[name].__file__)
        parts.append(
            _stamp(other) if _COMPILES.search(_text(other)) else _text(other)
        )
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@functools.cache
def _text(file: str) -> str:
    return Path(file).read_text(encoding="utf-8")


# Folders of compiled code, of which files are unpickled, that are not used as others may
# write to them.
open_folders: list[Path] = []


@functools.cache
def code_folder(folder: Path) -> Path:
    """Where the compiled code of the modules in this folder is kept: the first place that
    can be written of NUMBA_CACHE_DIR, beside the modules, the user's cache folder, and one
    for this run. Code that was shipped with the package is copied."""
    beside = folder / "__pycache__"
    shipped = sorted(beside.glob("*.nb[ic]"))
    if shipped and _open_to_others(beside):
        shipped = []
    state: list[Any] = [str(folder)]
    for file in shipped:
        status = file.stat()
        state.append((file.name, status.st_size, status.st_mtime_ns))
    name = f"{folder.name}-{hashlib.sha256(repr(state).encode()).hexdigest()[:16]}"
    given = os.environ.get(_FOLDER)
    places = [Path(given) / name, beside] if given else [beside]
    with contextlib.suppress(RuntimeError):  # no home
        places.append(cache_folder() / name)
    for place in places:
        if _prepare_folder(place, shipped):
            return place
    try:
        place = _folder_of_this_run() / name
    except OSError:  # then nothing else can be written either
        return beside
    _prepare_folder(place, shipped)
    return place


def cache_persists() -> bool:
    """Whether the next run finds the code that this one compiles."""
    code_folder(Path(__file__).parent)
    return not _folder_of_this_run.cache_info().currsize


@functools.cache
def _folder_of_this_run() -> Path:
    """For this process and those that it starts; removed when it ends. Raises OSError where
    there is no temporary folder.
    """
    folder = tempfile.mkdtemp(prefix="arfx-compiled-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[_FOLDER] = folder
    return Path(folder)


def _open_to_others(place: Path) -> bool:
    """Whether another user owns the folder, or may write or replace it.

    One of the user's own group may not be another.
    """
    if not hasattr(os, "getuid"):
        return False
    status, above = place.stat(), place.parent.stat()
    user = os.getuid()
    alone = user if user == os.getgid() else None
    shared, replaceable = (
        s.st_mode & (0o002 if s.st_gid == alone else 0o022) for s in (status, above)
    )
    owners = {0, user, Path(__file__).stat().st_uid}
    sticky = above.st_mode & stat.S_ISVTX
    return bool(shared or (replaceable and not sticky) or status.st_uid not in owners)


def _prepare_folder(place: Path, shipped: list[Path]) -> bool:
    """Make the folder, with copies of these files if it is new.

    False if it cannot be written, or others may write to it.
    """
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        if shipped and not place.exists():
            aside = place.with_name(f"{place.name}.{os.getpid()}")
            aside.mkdir(0o755, exist_ok=True)
            for file in shipped:
                shutil.copy2(file, aside / file.name)
            try:
                aside.rename(place)
            except OSError:  # another process was quicker
                shutil.rmtree(aside, ignore_errors=True)
        place.mkdir(0o755, exist_ok=True)
        if _open_to_others(place):
            open_folders.append(place)
            return False
        tempfile.TemporaryFile(dir=place).close()
    except OSError:
        return False
    return True
