"""What works on this machine: Python and packages, renderer back ends, codecs (each tried),
cores, memory, disk.

Every check is made, not looked up: a back end is opened, a codec encodes four frames and
they are read back.
Cost: about 1 s."""

from __future__ import annotations

import io
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import arfx
from arfx.core import compiled
from arfx.core.codec import Document
from arfx.core.machine import processor_name, usable_cores
from arfx.errors import ArfxError
from arfx.run.memory import free_mb
from arfx.stages import STAGES

PACKAGES = (
    "numpy",
    "opencv-contrib-python-headless",
    "av",
    "scipy",
    "numba",
    "scikit-image",
    "trimesh",
    "embreex",
    "pyrender-maintained",
    "pyopengl",
    "flip-evaluator",
    "jinja2",
    "matplotlib",
    "psutil",
    "pydantic",
    "click",
    "rich",
    "pillow",
    "pyyaml",
    "filelock",
    "tifffile",
)
LOW_MEMORY_MB, LOW_DISK_MB = (
    1500,
    2000,
)  # a 1080p job peaks near 700 MB a worker; an hour of 1080p H.264 takes a few GB


@dataclass(frozen=True)
class Check(Document):
    """One line of the doctor.

    essential : arfx cannot do its main job without it;  fix : empty when ok
    """

    group: str
    name: str
    ok: bool
    detail: str
    fix: str = ""
    essential: bool = False


def examine(folder: Path) -> list[Check]:
    """All checks; `folder` is where outputs would be written (its free space is looked at)."""
    from arfx.stages.raster import backend_report

    renderers = (
        Check("renderer", b.name, b.opens, b.detail, b.fix) for b in backend_report()
    )
    return [
        *_python(),
        *renderers,
        *_codecs(),
        *_resources(folder),
        _compiled(),
        *_plugins(),
    ]


def _plugins() -> Iterator[Check]:
    for name in STAGES.plugins:
        wrong = STAGES.broken.get(name)
        yield Check(
            "plug-in",
            name,
            wrong is None,
            wrong.message if wrong else "loads",
            wrong.hint if wrong else "",
        )


def essentials_work(checks: list[Check]) -> bool:
    """Whether all essential checks pass, and at least one renderer works."""
    return all(c.ok for c in checks if c.essential) and any(
        c.ok for c in checks if c.group == "renderer"
    )


def _python() -> Iterator[Check]:
    ok = sys.version_info >= (3, 11)
    version = f"{platform.python_version()}, {platform.platform()}"
    yield Check(
        "python",
        "python",
        ok,
        version,
        "" if ok else "install Python 3.11 or newer",
        essential=True,
    )
    yield Check("python", "arfx", True, arfx.__version__)
    for name in PACKAGES:
        found = _version(name)
        fix = "" if found else f"pip install {name}"
        yield Check(
            "package", name, bool(found), found or "not installed", fix, essential=True
        )
    for name in filter(
        _version,
        ("opencv-python", "opencv-python-headless", "opencv-contrib-python", "pyrender"),
    ):
        fix = f"pip uninstall {name}, then install its counterpart above again"
        yield Check(
            "package",
            name,
            False,
            "installs over the same folder as a package that arfx needs",
            fix,
        )


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _codecs() -> Iterator[Check]:
    from arfx.media.codecs import CODECS

    for name, codec in CODECS.items():
        if codec.sequence:
            yield _picture_format(name)
            continue
        why = _encode_fails(
            codec.encoder, codec.formats[0], codec.chunk, dict(codec.options)
        )
        fix = (
            ""
            if not why
            else "pip install --force-reinstall av (its wheels hold this encoder)"
        )
        yield Check(
            "codec",
            name,
            not why,
            why or f"{codec.encoder}, wrote and read back",
            fix,
            essential=name == "h264",
        )


def _encode_fails(
    encoder: str, pixel_format: str, chunk: str, options: dict[str, str]
) -> str:
    """Why four frames cannot be encoded and read back; empty where they can."""
    import av

    from arfx.media.codecs import open_encoder

    buffer = io.BytesIO()
    try:
        with av.open(buffer, "w", format="nut" if chunk == ".nut" else "matroska") as out:
            stream: Any = out.add_stream(encoder, rate=25, options=options)
            stream.width, stream.height, stream.pix_fmt = 128, 96, pixel_format
            open_encoder(stream.codec_context)
            for i in range(4):
                picture = np.full((96, 128, 3), 40 * i + 20, np.uint8)
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
                    format=pixel_format
                )
                out.mux(stream.encode(frame))
            out.mux(stream.encode(None))
        buffer.seek(0)
        with av.open(buffer, "r") as back:
            got = len(list(back.decode(video=0)))
    except (av.error.FFmpegError, OSError, ValueError) as e:
        return f"{encoder}: {e}"
    return "" if got == 4 else f"{encoder}: {got} of 4 frames came back"


def _picture_format(name: str) -> Check:
    import tempfile

    from arfx.media import images

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"probe.{name}"
        picture = np.linspace(0, 1, 16 * 8 * 3, dtype=np.float32).reshape(8, 16, 3)
        try:
            if name == "exr":
                images.write_exr(path, picture)
            else:
                images.write_png(path, (picture * 255).astype(np.uint8))
        except (ArfxError, OSError, ValueError) as e:
            return Check(
                "codec",
                name,
                False,
                str(e).splitlines()[0],
                "pip install --force-reinstall opencv-contrib-python-headless",
            )
        return Check("codec", name, path.stat().st_size > 0, "written")


def _resources(folder: Path) -> Iterator[Check]:
    yield Check(
        "machine",
        "cores",
        True,
        f"{usable_cores()} usable of {os.cpu_count()}, {processor_name()}",
    )
    free = free_mb()
    if free is not None:
        ok = free >= LOW_MEMORY_MB
        yield Check(
            "machine",
            "memory",
            ok,
            f"{free:.0f} MB free",
            "" if ok else "close programs, or --workers 1",
        )
    try:
        disk = shutil.disk_usage(folder).free / 1e6
    except OSError as e:
        yield Check(
            "machine",
            "disk",
            False,
            f"{folder}: {e.strerror}",
            "run it in a folder that exists",
        )
        return
    ok = disk >= LOW_DISK_MB
    yield Check(
        "machine",
        "disk",
        ok,
        f"{disk:.0f} MB free in {folder}",
        "" if ok else "free space for outputs",
    )


def _compiled() -> Check:
    lasting = compiled.cache_persists()
    folder = compiled.code_folder(Path(arfx.__file__).parent / "media")
    where = (
        f"in {folder}"
        if lasting
        else "for one run: the next compiles again what did not come with the package"
    )
    fix = "" if lasting else "set NUMBA_CACHE_DIR to a folder that can be written"
    return Check(
        "machine",
        "compiled code",
        lasting,
        f"for {compiled.target_cpu() or 'this very processor'}, kept {where}",
        fix,
    )
