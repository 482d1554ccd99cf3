"""Which back ends exist, which open here, and why not.

Probing OpenGL opens a context in this process, which keeps it; nothing is probed before it
is asked for."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arfx.errors import ConfigError, RenderError

BACKENDS = ("pyrender", "rays")
RAY_SAMPLES = {"draft": 4, "standard": 64, "reference": 256}
# OpenGL draws its samples in all pixels, whether an edge crosses them or not.
GL_SAMPLES = {"draft": 9, "standard": 25}


@dataclass(frozen=True)
class Backend:
    """find_faces : as of `Renderer`;  samples : of a pixel, by level
    why : this one was chosen"""

    name: str
    find_faces: Callable[..., Any]
    samples: Mapping[str, int]
    why: str


@dataclass(frozen=True)
class BackendState:
    """opens : usable in this process;  detail : version, or why not;  fix : what would make
    it open, may be empty
    """

    name: str
    opens: bool
    detail: str
    fix: str = ""


def choose_backend(wanted: str = "auto") -> Backend:
    """The back end to use. Raises RenderError where the one asked for by name cannot open,
    ConfigError if unknown.

    auto : pyrender where OpenGL runs on a graphics card, else rays. OpenGL in software is
    never taken unasked: at the same
    edge quality it takes two to three times as long as rays (measured with llvmpipe)."""
    if wanted not in ("auto", *BACKENDS):
        raise ConfigError(
            f"unknown raster back end {wanted!r}",
            "one of auto, " + ", ".join(BACKENDS),
        )
    if wanted == "rays":
        return _ray_backend("asked for")
    if wanted == "auto" and not _graphics_card():
        return _ray_backend("there is no graphics card here")
    from arfx.stages.raster.gl_context import open_context

    try:
        context = open_context()
    except RenderError as e:
        if wanted == "pyrender":
            raise
        return _ray_backend(e.message)
    if wanted == "auto" and context.software:
        return _ray_backend("OpenGL runs in software here")
    from arfx.stages.raster.gl import GlFaces

    why = (
        "asked for" if wanted == "pyrender" else "OpenGL runs on a graphics card here"
    )
    return Backend("pyrender", GlFaces, GL_SAMPLES, why)


def _ray_backend(why: str) -> Backend:
    from arfx.stages.raster.visible import RayFaces

    return Backend("rays", RayFaces, RAY_SAMPLES, why)


def _graphics_card() -> bool:
    """Is there a device that a driver could render on? Spares each worker a context that
    would be refused anyway.
    """
    if not sys.platform.startswith("linux"):
        return True
    dev = Path("/dev")
    return any(dev.glob("dri/renderD*")) or any(dev.glob("nvidia[0-9]*"))


def backend_report() -> list[BackendState]:
    """State of every back end here, and which of them `auto` takes, for `arfx doctor`."""
    from arfx.stages.raster.gl_context import open_context

    try:
        gl = BackendState("pyrender", True, open_context().detail)
    except RenderError as e:
        gl = BackendState("pyrender", False, e.message, e.hint)
    try:
        import embreex

        rays = BackendState(
            "rays", True, f"embreex {getattr(embreex, '__version__', '')}".strip()
        )
    except ImportError as e:
        rays = BackendState(
            "rays", False, f"embreex cannot be imported: {e}", "pip install embreex"
        )
    chosen = choose_backend()
    state = gl if chosen.name == "pyrender" else rays
    return [
        gl,
        rays,
        BackendState(
            "auto", state.opens, f"takes {chosen.name}: {chosen.why}", state.fix
        ),
    ]
