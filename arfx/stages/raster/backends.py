"""Which back ends exist, which open here, and why not.

Probing OpenGL opens a context in this process, which it then keeps (one context per process, FINDINGS.md); nothing is
probed before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from arfx.errors import ConfigError

BACKENDS = ("rays",)


@dataclass(frozen=True)
class Backend:
    """name;  renderer(mesh, camera, samples) makes a Renderer;  notice : why it is not the one asked for, or empty"""

    name: str
    renderer: Callable[..., Any]
    notice: str = ""


@dataclass(frozen=True)
class BackendState:
    """opens : usable in this process;  detail : version, or why not;  fix : what would make it open, may be empty"""

    name: str
    opens: bool
    detail: str
    fix: str = ""


def choose_backend(wanted: str = "auto") -> Backend:
    """The back end to use. Raises RenderError where the one asked for by name cannot open, ConfigError if unknown."""
    if wanted not in ("auto", *BACKENDS):
        raise ConfigError(f"unknown raster back end {wanted!r}", "one of auto, " + ", ".join(BACKENDS))
    from arfx.stages.raster.rays import RayRenderer

    return Backend("rays", RayRenderer)


def backend_report() -> list[BackendState]:
    """State of every back end here, for `arfx doctor`."""
    return [_rays_state()]


def _rays_state() -> BackendState:
    try:
        import embreex
    except ImportError as e:
        return BackendState("rays", False, f"embreex cannot be imported: {e}", "pip install embreex")
    return BackendState("rays", True, f"embreex {getattr(embreex, '__version__', '')}".strip())
