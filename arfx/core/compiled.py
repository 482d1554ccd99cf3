"""How loops are compiled: for which processor, where compiled code is kept, when it is
stale, and options of loops by lines.

numba alone compiles for the very processor that it runs on, fails where neither the package
nor the home can be written, passes over compiled code that came with a package that cannot
be written, and does not see that a function of another module, which is compiled in, has
changed. `configure_numba`, called before numba is imported, sets the target; `CacheLocator`
says where code is kept. A folder of compiled code is named by the digest of all that it
depends on."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

from arfx.core.machine import cache_folder, instructions
from arfx.core.waiting import Notice

# What the compiler may do to rounding in most loops
FAST = {"contract", "nsz", "arcp"}
# What every x86-64 processor since 2013 (Intel) or 2015 (AMD) can do: code for it can be shipped.
TARGET = "x86-64-v3"
_REQUIRED = {"abm", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"}
# Four channels of a pixel, written one by one, become one vector. Off by default, and not
# part of the index of cached code.
_SLP = "NUMBA_SLP_VECTORIZE"
_PACKAGE = Path(__file__).parents[1]
_COMPILES = re.compile(r"^@(line_)?kernel\b", re.MULTILINE)


def configure_numba() -> None:
    """Set numba's environment, for this process and those that it starts."""
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
    return _numba().njit(cache=True, nogil=True, no_cfunc_wrapper=True, **options)


def line_kernel(**options: Any) -> Any:
    """A `kernel` that is called for every line or ray and counts no references to arrays.

    Otherwise each array or slice that is made or passed on costs two locked additions: a
    fifth of a line kernel's time, half of the ray tracer's, and more where two threads
    count the same array's. Such a function allocates no arrays: its caller, which counts,
    allocates scratch and owns the arguments."""
    return kernel(_nrt=False, **options)


class CacheLocator:
    """numba's "cache locator" of one function of arfx."""

    def __init__(self, function: FunctionType) -> None:
        self._name = f"{function.__module__}-{function.__code__.co_firstlineno}"

    @classmethod
    def from_function(cls, function: FunctionType, file: str) -> CacheLocator | None:
        ours = function.__module__.startswith("arfx.")
        return cls(function) if ours and Path(file).exists() else None

    def get_cache_path(self) -> str:
        return str(code_folder())

    def ensure_cache_path(self) -> None:
        code_folder().mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        return ""  # the folder's name is one

    def get_disambiguator(self) -> str:
        return self._name


@functools.cache
def _numba() -> Any:
    """numba, which asks `CacheLocator`. By itself it fails when it reads a damaged file, cut
    short or of a type that the code no longer has: that is compiled again.
    """
    caching = import_module("numba.core.caching")
    caching.CacheImpl._locator_classes.insert(0, CacheLocator)
    for name, nothing in (("_load_index", dict), ("_load_data", lambda: None)):
        load = getattr(caching.IndexDataCacheFile, name)
        setattr(caching.IndexDataCacheFile, name, _or_nothing(load, nothing))
    return import_module("numba")


def _or_nothing(load: Any, nothing: Any) -> Any:
    def load_or_nothing(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except Exception:  # whatever damaged bytes make `pickle` raise
            return nothing()

    return load_or_nothing


def _digest() -> str:
    """Of all that compiled code depends on: the text of the modules that hold kernels, and
    of those that these import from, by their names."""
    texts = [(f.stem, f.read_text("utf-8")) for f in sorted(_PACKAGE.rglob("*.py"))]
    kernels = "".join(text for _, text in texts if _COMPILES.search(text))
    imports = " ".join(re.findall("^from arfx.*", kernels, re.MULTILINE))
    used = set(re.findall(r"\w+", imports))
    other = "".join(text for name, text in texts if name in used)
    parts = f"{os.environ.get(_SLP)}\0{kernels}\0{other}"
    return hashlib.sha256(parts.encode()).hexdigest()[:16]


# Folders of compiled code, of which files are unpickled, that are not used as others may
# write to them.
open_folders: list[Path] = []


@functools.cache
def code_folder() -> Path:
    """Where compiled code is kept: the first place that can be written of NUMBA_CACHE_DIR,
    beside the package, the user's cache folder, and the system's folder for temporary files.
    Code that was shipped with the package is copied."""
    name = f"compiled-{_digest()}"
    beside = _PACKAGE / "__pycache__" / name
    places = [beside]
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        places.insert(0, Path(given) / name)
    with contextlib.suppress(RuntimeError):  # no home
        places.append(cache_folder() / name)
    user = getattr(os, "getuid", int)()
    places.append(Path(tempfile.gettempdir(), f"arfx-{user}", name))
    usable = (place for place in places if _prepare_folder(place, beside))
    return next(usable, beside)


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


def _prepare_folder(place: Path, shipped: Path) -> bool:
    """Make the folder, as a copy of another if it is new and that is there.

    False if it cannot be written, or others may write to it.
    """
    try:
        if not place.exists() and shipped.is_dir() and not _open_to_others(shipped):
            # what another process finds half copied is stale, and compiled again
            shutil.copytree(shipped, place, dirs_exist_ok=True)
        place.mkdir(0o755, parents=True, exist_ok=True)
        if _open_to_others(place):  # files in it are unpickled
            open_folders.append(place)
            return False
        tempfile.TemporaryFile(dir=place).close()
    except OSError:
        return False
    return True


@functools.cache
def _compile_timer() -> Any:
    event = import_module("numba.core.event")
    timer = event.TimingListener()
    event.register("numba:compile", timer)
    return timer


def work_clock() -> float:
    """`time.perf_counter`, less the seconds in which this process has compiled since it first
    asked: later work is spared them.
    """
    timer = _compile_timer()
    return time.perf_counter() - (timer.duration if timer.done else 0.0)


@contextlib.contextmanager
def telling(notice: Notice) -> Iterator[None]:
    """Says once if, in the body, something is compiled, which takes some seconds."""
    event = import_module("numba.core.event")
    said: list[str] = []

    def say(*_: object) -> None:
        if not said:
            said.append(
                "compiling kernels, once: this clip or its settings need them"
            )
            notice(said[0])
            if open_folders:
                notice(
                    f"compiled code in {open_folders[0]} is not used, others may write"
                    " there: chmod go-w takes that from them"
                )

    listener = type("", (event.Listener,), {"on_start": say, "on_end": say})()
    with event.install_listener("numba:compile", listener):
        yield
