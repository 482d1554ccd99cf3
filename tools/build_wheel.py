"""Build a wheel that carries compiled code, for this Python's minor version: an installed
one compiles nothing.

    python tools/build_wheel.py [-o dist]

The plain wheel is unpacked, typical jobs are run in it from an empty cache, which compiles
what they call, numba is pinned to the version that compiled it, and it is packed again with
the tags of this Python and system. Some minutes."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from arfx.core import compiled

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "sample_scenes"
JOBS = (
    "demo",
    f"verify {SCENES / '0022-before-and-behind'}",
    f"verify {SCENES / '0030-watercolor'}",
    f"verify {SCENES / '0041-indirect-light'}",
)


def run(*command: object, **more: object) -> None:
    subprocess.run([str(c) for c in command], check=True, **more)  # type: ignore[call-overload]


def with_compiled_code(plain: Path, out: Path, jobs: Sequence[str] = JOBS) -> Path:
    """plain : wheel without compiled code;  jobs : arguments of commands, each run in a
    folder that goes again. Returns the new wheel.
    """
    processor = "this processor cannot run what the wheel is to hold: "
    assert compiled.target_cpu(), processor + compiled.TARGET
    with (
        tempfile.TemporaryDirectory() as aside,
        tempfile.TemporaryDirectory() as made,
    ):
        run(sys.executable, "-m", "wheel", "unpack", "-d", aside, plain)
        (tree,) = Path(aside).iterdir()
        here = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        here |= {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
        for job in jobs:
            command = [sys.executable, "-P", "-m", "arfx_cli", *job.split()]
            run(*command, env=here, cwd=made)
        assert list(tree.rglob("*.nbc")), "nothing was compiled"
        (about,) = tree.glob("*.dist-info")
        metadata = (about / "METADATA").read_text(encoding="utf-8")
        pinned, count = re.subn(
            r"(?m)^Requires-Dist: numba\b.*$",
            f"Requires-Dist: numba=={version('numba')}",
            metadata,
        )
        assert count == 1, "the wheel does not ask for numba"
        (about / "METADATA").write_text(pinned, encoding="utf-8")
        tag = (  # it holds no library of the system's
            f"cp{sys.version_info[0]}{sys.version_info[1]}-none-manylinux_2_17_x86_64"
        )
        wheel = re.sub(
            r"(?m)^Tag: .*$",
            f"Tag: {tag}",
            (about / "WHEEL").read_text(encoding="utf-8"),
        )
        (about / "WHEEL").write_text(wheel, encoding="utf-8")
        out.mkdir(parents=True, exist_ok=True)
        run(sys.executable, "-m", "wheel", "pack", "-d", out, tree)
        return out / f"{about.name.removesuffix('.dist-info')}-{tag}.whl"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "dist")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as aside:
        source = (
            Path(aside) / "source"
        )  # a copy: setuptools takes up what an earlier build has left in the tree
        for name in ("arfx", "cli", "configs"):
            shutil.copytree(
                ROOT / name,
                source / name,
                ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"),
            )
        for name in (
            "pyproject.toml",
            "setup.py",
            "MANIFEST.in",
            "README.md",
            "LICENSE",
        ):
            shutil.copy2(ROOT / name, source / name)
        built = [
            sys.executable,
            "-m",
            "build",
            "--wheel",
            "--no-isolation",
            "-o",
            aside,
            str(source),
        ]
        done = subprocess.run(built, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)
        print(with_compiled_code(next(Path(aside).glob("*.whl")), given.out))


if __name__ == "__main__":
    main()
