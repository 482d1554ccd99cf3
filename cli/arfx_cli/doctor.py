"""`arfx doctor`: what works here, and the fix for what does not."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from arfx_cli.console import detail, emit_json, message_options, verbose


@click.command()
@message_options
def command(as_json: bool) -> None:
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
    if as_json:
        emit_json(
            {"ok": essentials_work(checks), "checks": [c.to_json() for c in checks]}
        )
    else:
        for group in dict.fromkeys(c.group for c in checks):
            click.echo(group)
            for c in (c for c in checks if c.group == group):
                mark = (
                    click.style("ok  ", fg="green")
                    if c.ok
                    else click.style("no  ", fg="red" if c.essential else "yellow")
                )
                click.echo(f"  {mark}{c.name:32}{c.detail}")
                if c.fix:
                    click.echo(f"      fix: {c.fix}")
    if not essentials_work(checks):
        wrong = [c.name for c in checks if c.essential and not c.ok] or ["every renderer"]
        raise RenderError(
            f"arfx cannot work here: {', '.join(wrong)}",
            "the fix is printed under each check",
        )
    if not as_json:
        broken = [c.name for c in checks if not c.ok]
        click.echo(
            "Clips can be processed here."
            + (f" Missing, not essential: {', '.join(broken)}." if broken else "")
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
