"""The one OpenGL context of this process, EGL, else OSMesa, through pyrender's platforms,
and the one thread that uses it.

A context is current in one thread at a time: all OpenGL work of a process is handed to a
single thread, whoever asks. The context is opened on first use, stays current there, and is
never deleted: EGL's displays are shared, so that ending one ends others, and a driver may
be unloaded before Python is done. A spawned process opens its own; none survives a fork.
"""

import ctypes
import os
import sys
import types
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from arfx.errors import RenderError

T = TypeVar("T")

FIX = (
    "apt-get install libegl1 libgl1 libgl1-mesa-dri (or libosmesa6), or use the rays back"
    " end, which needs no OpenGL"
)
_LIBRARIES = {"egl": ("libEGL.so.1", "libGL.so.1"), "osmesa": ("libOSMesa.so.8",)}


@dataclass
class GlContext:
    """pyrender : the module;  platform : its EGL or OSMesa platform;  detail : for reports
    software : rendered by the processor (llvmpipe and its kin)"""

    pyrender: Any
    platform: Any
    detail: str
    software: bool = True


_context: GlContext | None = None
_failure = ""
_thread = ThreadPoolExecutor(
    1, "opengl"
)  # Python's end waits for the draw that it is at
_thread.submit(
    int
    # it starts now: Ctrl-C while it starts with work in hand would leave it running beside a
    # second
).result()
_discarded: deque[Callable[[], None]] = deque()
_pid = os.getpid()


def on_gl_thread(work: Callable[..., T], *args: Any) -> T:
    """work(*args) on the thread that has the context; returns what it returns, raises what
    it raises, and RenderError with what the driver said.

    Not to be called from that thread. Raises RenderError in a forked process, which has
    neither thread nor context."""
    if _pid != os.getpid():
        raise RenderError(
            "OpenGL was carried into a forked process",
            "start workers with the spawn method",
        )
    try:
        return _thread.submit(_free_then, work, args).result()
    except Exception as e:
        if all(kind.__module__ != "OpenGL.error" for kind in type(e).__mro__):
            raise
        raise RenderError(
            f"OpenGL failed: {e!r}",
            "the rays back end needs no OpenGL: --set raster.backend=rays",
        ) from e


def discard(free: Callable[[], None]) -> None:
    """Call `free` on the OpenGL thread before its next work.

    Takes no lock: a finalizer may run anywhere.
    """
    _discarded.append(free)


def _free_then(work: Callable[..., T], args: tuple[Any, ...]) -> T:
    while _discarded:
        _discarded.popleft()()
    return work(*args)


def open_context() -> GlContext:
    """The context of this process, opened on first use.

    Raises RenderError with what each platform answered.
    """
    return on_gl_thread(_open_once)


def _open_once() -> GlContext:
    global _context, _failure
    if _context is not None:
        return _context
    if _failure:
        raise RenderError(_failure, FIX)
    answers = []
    # One thread per process: frames are spread over worker processes, and two llvmpipe
    # pools fight for the same cores.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    asked = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    for name in (asked,) if asked in _LIBRARIES else tuple(_LIBRARIES):
        missing = _missing_library(name)
        if missing:
            answers.append(f"{name}: {missing} is not installed")
            continue
        try:
            _context = _open(name)
            return _context
        except (
            Exception
        ) as e:  # drivers and PyOpenGL raise anything, down to AttributeError
            answers.append(f"{name}: {type(e).__name__} {e}".rstrip().split("\n")[0])
            _drop_modules()
    _failure = "no OpenGL context opens here (" + "; ".join(answers) + ")"
    raise RenderError(_failure, FIX)


def _missing_library(name: str) -> str:
    for library in _LIBRARIES[name]:
        try:
            ctypes.CDLL(library)
        except OSError:
            return library
    return ""


def _open(name: str) -> GlContext:
    os.environ["PYOPENGL_PLATFORM"] = (
        name  # PyOpenGL looks at it once, when it is imported
    )
    if (
        "pyrender.viewer" not in sys.modules
    ):  # the real one imports pyglet, which wants a display
        stub = types.ModuleType("pyrender.viewer")
        stub.Viewer = None  # type: ignore[attr-defined]
        stub.__all__ = ["Viewer"]  # type: ignore[attr-defined]
        sys.modules["pyrender.viewer"] = stub
    import pyrender

    platform: Any
    if name == "egl":
        from pyrender.platforms import egl

        device = egl.get_device_by_index(int(os.environ.get("EGL_DEVICE_ID", "0")))
        platform = egl.EGLPlatform(64, 64, device=device)
    else:
        import OpenGL.contextdata as contextdata
        from pyrender.platforms.osmesa import OSMesaPlatform

        _plain_context_ids(contextdata)
        platform = OSMesaPlatform(64, 64)
    platform.init_context()
    platform.make_current()
    from OpenGL import GL

    version = GL.glGetString(GL.GL_VERSION)
    if not version:
        raise RuntimeError("the context has no version")
    renderer = GL.glGetString(GL.GL_RENDERER) or b""
    software = any(
        word in renderer.decode().lower()
        for word in ("llvmpipe", "softpipe", "swrast", "software")
    )
    detail = f"{name}, OpenGL {version.decode()}, {renderer.decode()}"
    platform.delete_context = lambda: (
        None
    )  # its __del__ would call it at Python's end
    return GlContext(pyrender, platform, detail, software)


def _plain_context_ids(contextdata: Any) -> None:
    """Make OSMesa's contexts ints: pyrender keeps shaders by context, and two pointers to
    one context are not equal.
    """
    given = contextdata.getContext

    def as_int(context: Any = None) -> Any:
        c = given(context)
        return c if isinstance(c, int) else ctypes.cast(c, ctypes.c_void_p).value

    contextdata.getContext = as_int


def _drop_modules() -> None:
    """Drop half-initialised modules, so that the next platform can be tried."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [n for n in sys.modules if n.split(".")[0] in ("OpenGL", "pyrender")]:
        del sys.modules[name]
