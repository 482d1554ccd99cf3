"""What has to be the same in all processes that render a job, and what of it differs."""

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata

import arfx
from arfx.core.compiled import target_cpu
from arfx.core.machine import processor_name
from arfx.errors import RenderError
from arfx.run.folder import code_digest
from arfx.stages import STAGES

# whose code makes pixels or the bytes of a file
LIBRARIES = (
    "av",
    "embreex",
    "llvmlite",
    "numba",
    "numpy",
    "opencv-contrib-python-headless",
    "pyrender-maintained",
    "scikit-image",
    "scipy",
    "trimesh",
)
STAGE = "stage "  # begins the name of a plug-in
PROCESSOR = "the processor"
OPENGL, OPENS = "OpenGL", "opens"
_LOADED = (
    code_digest()
)  # as it is when this process begins to import arfx: later the files may be others


def environment(
    plugins: Sequence[str] = (), processor: bool = False, opengl: bool = False
) -> dict[str, str]:
    """Name -> version or digest, of this process.

    plugins : stages from other packages that the job has;  processor : by which libraries
    choose their code, too;  opengl : whether it opens
    """
    out = {
        "Python": platform.python_version(),
        "arfx": arfx.__version__,
        "arfx's code": code_digest.__wrapped__(),
    }
    for name in LIBRARIES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "none"
    out["the processor that code is compiled for"] = (
        os.environ.get("NUMBA_CPU_NAME") or target_cpu() or processor_name()
    )
    out |= {
        f"{STAGE}{n}": (
            code_digest.__wrapped__(*STAGES.source(n))
            if n in STAGES.plugins
            else "none"
        )
        for n in plugins
    }
    if processor:
        out[PROCESSOR] = processor_name()
    if opengl:
        out[OPENGL] = _opengl()
    if out["arfx's code"] != _LOADED:
        out["arfx's code"] = f"changed since this process started ({_LOADED})"
    return out


def _opengl() -> str:
    from arfx.stages.raster.gl_context import open_context

    try:
        open_context()
    except RenderError as e:
        return e.message
    return OPENS


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> Iterator[str]:
    """In words, of each entry of `here`. there : of a worker"""
    for name, value in here.items():
        if there.get(name) != value:
            yield f"{name} is {there.get(name, 'none')}, here {value}"
