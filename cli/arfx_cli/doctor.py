"""`arfx doctor`: what works here, and the fix for what does not."""

import itertools
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from arfx_cli.console import arfx_command, detail, verbose, wrote_json


@arfx_command("doctor")
def command() -> None:
    """Check Python, packages, renderer back ends, codecs, cores, memory and disk; say the
    fix for what does not work.

    Exits with 0 if clips can be processed here, with 5 if something essential fails.

    \b
    Example:
      arfx doctor"""
    from arfx.errors import RenderError
    from arfx.measure.machine import essentials_work, examine

    checks = examine(Path.cwd())
    if verbose():
        for line in surroundings():
            detail(line)
    works = essentials_work(checks)
    if not wrote_json({"ok": works, "checks": [c.to_json() for c in checks]}):
        for group, members in itertools.groupby(checks, lambda c: c.group):
            click.echo(group)
            for c in members:
                colour = "green" if c.ok else "red" if c.essential else "yellow"
                mark = click.style("ok  " if c.ok else "no  ", fg=colour)
                click.echo(f"  {mark}{c.name:32}{c.detail}")
                if c.fix:
                    click.echo(f"      fix: {c.fix}")
        if works:
            broken = ", ".join(c.name for c in checks if not c.ok)
            missing = f" Missing, not essential: {broken}." if broken else ""
            click.echo(f"Clips can be processed here.{missing}")
    if not works:
        wrong = [c.name for c in checks if c.essential and not c.ok] or [
            "every renderer"
        ]
        raise RenderError(
            f"arfx cannot work here: {', '.join(wrong)}",
            "the fix is printed under each check",
        )


# what changes how arfx and the libraries under it behave
VARIABLES = (
    "ARFX_DEBUG",
    "PYOPENGL_PLATFORM",
    "DISPLAY",
    "LIBGL_ALWAYS_SOFTWARE",
    "__EGL_VENDOR_LIBRARY_DIRS",
    "__EGL_VENDOR_LIBRARY_FILENAMES",
    "LP_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "NUMBA_CACHE_DIR",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "TMPDIR",
)


def surroundings() -> Iterator[str]:
    """Where arfx and Python are, the libraries inside the packages, and the variables that
    are set.
    """
    import av
    import cv2

    import arfx

    yield f"arfx in {Path(arfx.__file__).parent}, run by {sys.executable}"
    yield "FFmpeg: " + ", ".join(
        f"{name} {'.'.join(map(str, v))}" for name, v in av.library_versions.items()
    )
    yield f"OpenCV: {cv2.__version__}, {cv2.getNumThreads()} threads"
    for name in VARIABLES:
        if name in os.environ:
            yield f"{name}={os.environ[name]}"
