"""How loops are compiled: where compiled code is kept, and options of loops that go line by line.

numba alone fails where neither the package nor the home can be written, and passes over compiled code that came with a
package that cannot be written. `prepare`, called before numba is imported, gives it `Place` instead.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path
from types import FunctionType
from typing import Any

# Options of `numba.njit` for a function that counts no references to arrays. Every part of an array that is made or handed on
# costs two locked additions otherwise: a fifth of the time of a kernel that goes by lines, and more where two threads count
# the same array's. Such a function makes no arrays: one that counts makes the room to work in, holds what it is given, and
# calls it.
UNCOUNTED: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False}

_OURS = ("arfx", "arfx_cli")
_NUMBAS = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
_LOCATORS, _FOLDER = "NUMBA_CACHE_LOCATOR_CLASSES", "NUMBA_CACHE_DIR"


def prepare() -> None:
    """Set numba's environment, for this process and those that it starts."""
    ours = f"{__name__}.{Place.__name__}"
    others = os.environ.get(_LOCATORS) or _NUMBAS
    if ours not in others.split(","):
        os.environ[_LOCATORS] = f"{ours},{others}"
    if "numba" in sys.modules:  # imported before arfx
        from importlib import import_module

        import_module("numba.core.config").reload_config()


class Place:
    """numba's "cache locator" of one function of arfx."""

    def __init__(self, function: FunctionType, file: str) -> None:
        self._function, self._file = function, file

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> Place | None:
        ours = py_func.__module__.partition(".")[0] in _OURS and os.path.exists(py_file)  # noqa: PTH110
        return cls(py_func, py_file) if ours else None

    def get_cache_path(self) -> str:
        return str(kept_in(Path(self._file).parent))

    def ensure_cache_path(self) -> None:
        Path(self.get_cache_path()).mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> bytes:
        return _file_digest(self._file)

    def get_disambiguator(self) -> str:
        return str(self._function.__code__.co_firstlineno)


@functools.cache
def _file_digest(file: str) -> bytes:
    return hashlib.sha256(Path(file).read_bytes()).digest()


@functools.cache
def kept_in(folder: Path) -> Path:
    """Where the compiled code of the modules in this folder is kept: the first place that can be written of NUMBA_CACHE_DIR,
    beside the modules, the user's cache folder, and one for this run. Code that came with the package is taken along."""
    beside = folder / "__pycache__"
    came = sorted(beside.glob("*.nb[ic]"))
    state = [str(folder), *((file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in came)]
    name = f"{folder.name}-{hashlib.sha256(repr(state).encode()).hexdigest()[:16]}"
    given = os.environ.get(_FOLDER)
    if given and _filled(Path(given) / name, came):
        return Path(given) / name
    if _filled(beside, []):
        return beside
    users = _users_folder()
    if users and _filled(users / name, came):
        return users / name
    try:
        place = _folder_of_this_run() / name
    except OSError:  # then nothing else can be written either
        return beside
    _filled(place, came)
    return place


def lasting() -> bool:
    """Whether the next run finds the code that this one compiles."""
    kept_in(Path(__file__).parent)
    return not _folder_of_this_run.cache_info().currsize


def _users_folder() -> Path | None:
    try:
        home = Path.home()
    except RuntimeError:  # not known
        return None
    by_system = {"win32": home / "AppData" / "Local", "darwin": home / "Library" / "Caches"}
    return Path(os.environ.get("XDG_CACHE_HOME") or by_system.get(sys.platform, home / ".cache")) / "arfx"


@functools.cache
def _folder_of_this_run() -> Path:
    """For this process and those that it starts; removed when it ends. Raises OSError where there is no temporary folder."""
    folder = tempfile.mkdtemp(prefix="arfx-compiled-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[_FOLDER] = folder
    return Path(folder)


def _filled(place: Path, came: list[Path]) -> bool:
    """Make the folder, with copies of these files if it is new. False if it cannot be written."""
    try:
        if came and not place.exists():
            aside = place.with_name(f"{place.name}.{os.getpid()}")
            aside.mkdir(parents=True, exist_ok=True)
            for file in came:
                shutil.copy2(file, aside / file.name)
            try:
                aside.rename(place)
            except OSError:  # another process was quicker
                shutil.rmtree(aside, ignore_errors=True)
        place.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=place).close()
    except OSError:
        return False
    return True
