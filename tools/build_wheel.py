"""Build a wheel that carries compiled code, for this Python's minor version: an installed
one compiles nothing.

    python tools/build_wheel.py [-o dist]

The plain wheel is unpacked, all of arfx/run/kernels.json is compiled into it from an empty
cache, numba is pinned to the version that compiled it, and it is packed again with the tags
of this Python and system. A minute or two."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMPILE = """
import sys
from arfx.core import compiled
from arfx.run import kernels
assert compiled.target_cpu(), "this processor cannot run what the wheel is to hold: " + compiled.TARGET
wanted = [kernel for kernel in kernels.listed_kernels() if kernel.module.startswith(sys.argv[1])]
kernels.compile_missing(wanted, lambda phase, done, total: print(f"compiled {done} of {total}", flush=True))
assert wanted and all(kernel.is_cached for kernel in wanted), "not all was compiled"
"""


def run(*command: object, **more: object) -> None:
    subprocess.run([str(c) for c in command], check=True, **more)  # type: ignore[call-overload]


def with_compiled_code(plain: Path, out: Path, modules: str = "arfx.") -> Path:
    """plain : wheel without compiled code;  modules : how the names begin of those that are
    compiled. Returns the new wheel.
    """
    with tempfile.TemporaryDirectory() as aside:
        run(sys.executable, "-m", "wheel", "unpack", "-d", aside, plain)
        (tree,) = Path(aside).iterdir()
        here = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        here |= {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
        run(sys.executable, "-c", COMPILE, modules, env=here, cwd=tree)
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
