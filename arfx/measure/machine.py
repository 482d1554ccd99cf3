"""What works on this machine: Python and packages, renderer back ends, codecs (each tried),
cores, memory, disk.

Every check is made, not looked up: a back end is opened, a codec encodes four frames and
they are read back.
Cost: about 1 s."""

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

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
# of packages that share their folder with one of PACKAGES
RIVALS = (
    "opencv-python",
    "opencv-python-headless",
    "opencv-contrib-python",
    "pyrender",
)
# a 1080p job peaks near 700 MB a worker; an hour of 1080p H.264 takes a few GB
LOW_MEMORY_MB, LOW_DISK_MB = 1500, 2000


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
        if wrong is None:
            yield Check("plug-in", name, True, "loads")
        else:
            yield Check("plug-in", name, False, wrong.message, wrong.hint)


def essentials_work(checks: list[Check]) -> bool:
    """Whether all essential checks pass, and at least one renderer works."""
    return all(c.ok for c in checks if c.essential) and any(
        c.ok for c in checks if c.group == "renderer"
    )


def _python() -> Iterator[Check]:
    ok = sys.version_info >= (3, 11)
    here = f"{platform.python_version()}, {platform.platform()}"
    fix = "" if ok else "install Python 3.11 or newer"
    yield Check("python", "python", ok, here, fix, essential=True)
    yield Check("python", "arfx", True, arfx.__version__)
    for name in PACKAGES:
        found = _version(name)
        fix = "" if found else f"pip install {name}"
        said = found or "not installed"
        yield Check("package", name, bool(found), said, fix, essential=True)
    for name in filter(_version, RIVALS):
        said = "installs over the same folder as a package that arfx needs"
        fix = f"pip uninstall {name}, then install its counterpart above again"
        yield Check("package", name, False, said, fix)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _codecs() -> Iterator[Check]:
    import av

    from arfx.measure.costs_output import write_clip
    from arfx.media.clip import probe
    from arfx.media.codecs import CODECS
    from arfx.media.frames import ClipReader
    from arfx.media.output import OutputSettings, plan_output
    from arfx.media.writer import ChunkWriter, chunk_suffix

    with tempfile.TemporaryDirectory() as scratch:
        for name, codec in CODECS.items():
            out = Path(scratch) / (f"%03d.{name}" if codec.sequence else "out.mkv")
            try:
                info = probe(write_clip(Path(scratch) / "clip.mp4", 128, 96, 4))
                plan = plan_output(info, out, OutputSettings(name))
                path = Path(scratch) / f"{name}{chunk_suffix(plan)}"
                with (
                    ClipReader(info) as reader,
                    ChunkWriter(plan, info, path) as writer,
                ):
                    for frame in reader.frames():
                        writer.write(frame)
                if codec.sequence:
                    got = len(list(path.glob(f"*.{name}")))
                else:
                    with av.open(path) as back:
                        got = len(list(back.decode(video=0)))
                why = "" if got == 4 else f"{got} of 4 frames came back"
            except (ArfxError, av.error.FFmpegError, OSError, ValueError) as e:
                why = str(e).splitlines()[0]
            package = "opencv-contrib-python-headless" if codec.sequence else "av"
            said = why or f"{codec.encoder or name}, wrote and read back"
            fix = f"pip install --force-reinstall {package}" if why else ""
            yield Check("codec", name, not why, said, fix, essential=name == "h264")


def _resources(folder: Path) -> Iterator[Check]:
    cores = f"{usable_cores()} usable of {os.cpu_count()}, {processor_name()}"
    yield Check("machine", "cores", True, cores)
    free = free_mb()
    if free is not None:
        ok = free >= LOW_MEMORY_MB
        fix = "" if ok else "close programs, or --workers 1"
        yield Check("machine", "memory", ok, f"{free:.0f} MB free", fix)
    try:
        disk = shutil.disk_usage(folder).free / 1e6
    except OSError as e:
        fix = "run it in a folder that exists"
        yield Check("machine", "disk", False, f"{folder}: {e.strerror}", fix)
        return
    ok = disk >= LOW_DISK_MB
    fix = "" if ok else "free space for outputs"
    yield Check("machine", "disk", ok, f"{disk:.0f} MB free in {folder}", fix)


def _compiled() -> Check:
    processor = compiled.target_cpu() or "this very processor"
    said = f"for {processor}, kept in {compiled.code_folder()}"
    return Check("machine", "compiled code", True, said, "")
