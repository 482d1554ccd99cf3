"""The wheel holds every subpackage and the presets, installs no package called `cli`, and help stays light."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def project_files() -> list[str]:
    """Paths, relative to the root, that git tracks or would track; without git, everything that is not made or hidden."""
    try:
        listed = subprocess.run(
            ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        return listed.stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        made = {"__pycache__", "build", "dist", "out", "demo", "failed"}
        every = [p.relative_to(ROOT) for p in ROOT.rglob("*") if p.is_file()]
        return sorted(
            str(p) for p in every
            if not any(part in made or part.endswith(".egg-info") or (part[0] == "." and part != ".ci") for part in p.parts)
        )  # fmt: skip


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of what git tracks or would track, so that the tree stays clean."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    names = project_files()
    for name in names:
        if not name.startswith(("sample_scenes/", "tests/")) and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-build-isolation", "--no-deps", "-w", str(out), str(source)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return next(out.glob("*.whl"))


def test_the_wheel_holds_every_module_and_the_presets(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    modules = [*(ROOT / "arfx").rglob("*.py"), *(ROOT / "cli" / "arfx_cli").rglob("*.py")]
    for path in modules:
        inside = path.relative_to(ROOT / "cli" if "arfx_cli" in path.parts else ROOT)
        assert str(inside) in held
    presets = sorted((ROOT / "configs").glob("*.toml"))
    assert presets and all(f"arfx/config/presets/{p.name}" in held for p in presets)
    assert "arfx/py.typed" in held
    assert {n.split("/")[0] for n in held if not n.startswith("arfx-")} == {"arfx", "arfx_cli"}


def test_installed_it_has_no_package_cli_and_finds_its_presets(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as z:
        z.extractall(tmp_path)

    site = sysconfig.get_paths()["purelib"]

    def python(code: str) -> subprocess.CompletedProcess[str]:
        # -S: the libraries are found, but not the editable install, which only a .pth file names
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); sys.path.append({site!r})\n{code}"
        return subprocess.run([sys.executable, "-I", "-S", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)

    got = python("import cli")
    assert got.returncode != 0 and "No module named 'cli'" in got.stderr, got.stderr
    got = python("import arfx; from arfx.config.presets import presets; print(arfx.__file__); print(sorted(presets()))")
    assert got.returncode == 0 and str(tmp_path) in got.stdout and "preview" in got.stdout, got.stderr


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom arfx_cli.main import main\n"
        "try:\n main(['--help'])\nexcept SystemExit:\n pass\n"
        "heavy = {'numpy', 'numba', 'OpenGL', 'scipy', 'cv2', 'pyrender', 'av', 'matplotlib', 'trimesh'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    got = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert got.returncode == 0, got.stderr
    assert "process" in got.stdout
