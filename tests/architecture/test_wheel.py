"""The wheel holds every subpackage and the presets, installs no package called `cli`, and
help stays light.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from arfx.core import compiled
from tools.build_wheel import with_compiled_code

ROOT = Path(__file__).parents[2]


def project_files() -> list[str]:
    """Paths, relative to the root, that git tracks or would track; without git, everything
    that is not made or hidden.
    """
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
        if (
            not name.startswith(("sample_scenes/", "tests/"))
            and (ROOT / name).is_file()
        ):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-q",
        "--no-build-isolation",
        "--no-deps",
        "-w",
        str(out),
        str(source),
    ]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return next(out.glob("*.whl"))


def test_the_wheel_holds_every_module_and_the_presets(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    kinds = (".json", ".toml", ".html", ".jinja", ".vert", ".frag", ".glb")
    data = [
        p
        for folder in (ROOT / "arfx", ROOT / "cli" / "arfx_cli")
        for p in folder.rglob("*")
        if p.suffix in kinds and p.name != "ruff.toml"
    ]
    for path in [
        *(ROOT / "arfx").rglob("*.py"),
        *(ROOT / "cli" / "arfx_cli").rglob("*.py"),
        *data,
    ]:
        inside = path.relative_to(ROOT / "cli" if "arfx_cli" in path.parts else ROOT)
        assert str(inside) in held
    presets = sorted((ROOT / "configs").glob("*.toml"))
    assert presets and all(f"arfx/config/presets/{p.name}" in held for p in presets)
    assert "arfx/py.typed" in held
    assert {n.split("/")[0] for n in held if not n.startswith("arfx-")} == {
        "arfx",
        "arfx_cli",
    }


def test_installed_it_has_no_package_cli_and_finds_its_presets(
    wheel: Path, tmp_path: Path
) -> None:
    with zipfile.ZipFile(wheel) as z:
        z.extractall(tmp_path)

    site = sysconfig.get_paths()["purelib"]

    def python(code: str) -> subprocess.CompletedProcess[str]:
        # -S: the libraries are found, but not the editable install, which only a .pth file names
        code = (
            f"import sys; sys.path.insert(0, {str(tmp_path)!r});"
            f" sys.path.append({site!r})\n{code}"
        )
        return subprocess.run(
            [sys.executable, "-I", "-S", "-c", code],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )

    got = python("import cli")
    assert got.returncode != 0 and "No module named 'cli'" in got.stderr, got.stderr
    got = python(
        "import arfx; from arfx.config.load import presets; print(arfx.__file__);"
        " print(sorted(presets()))"
    )
    assert (
        got.returncode == 0
        and str(tmp_path) in got.stdout
        and "preview" in got.stdout
    ), got.stderr


@pytest.mark.process
@pytest.mark.skipif(
    not compiled.target_cpu(), reason=f"a processor without {compiled.TARGET}"
)
def test_a_wheel_with_compiled_code_compiles_nothing_when_installed(
    wheel: Path, tmp_path: Path
) -> None:
    """Of what one small clip needs: `make wheel` takes minutes."""
    sample = (ROOT / "sample_scenes" / "0001-orbit" / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(sample.replace("frames = 24", "frames = 2"))
    job = f"synth {tmp_path / 'scene.toml'} -o clip"
    made = with_compiled_code(wheel, tmp_path / "dist", [job])
    assert f"-cp{sys.version_info[0]}{sys.version_info[1]}-none-" in made.name
    installed, aside = tmp_path / "installed", tmp_path / "aside"
    aside.mkdir()
    with zipfile.ZipFile(made) as z:
        z.extractall(installed)
        assert b"Requires-Dist: numba==" in z.read(
            next(n for n in z.namelist() if n.endswith("METADATA"))
        )
    held = sorted(installed.rglob("*.nbc"))
    assert held and not list(installed.rglob("*.pyc"))
    code = """
import sys, tempfile
sys.path[:0] = [sys.argv[1]]
sys.path.append(sys.argv[2])
made = tempfile.TemporaryFile
def refuse(*a, dir=None, **k):  # the root user may write anywhere
    if sys.argv[3] == "read-only" and str(dir).startswith(sys.argv[1]):
        raise PermissionError(13, "Permission denied", str(dir))
    return made(*a, dir=dir, **k)
tempfile.TemporaryFile = refuse
from arfx_cli.main import main
main(sys.argv[4:])
"""
    environment = {
        k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "PYTHON"))
    }
    environment |= dict.fromkeys(
        ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), str(aside)
    )
    for how in ("writable", "read-only"):
        command = [
            sys.executable,
            "-S",
            "-c",
            code,
            str(installed),
            sysconfig.get_paths()["purelib"],
            how,
            *job.split(),
            "--overwrite",
        ]
        got = subprocess.run(
            command,
            cwd=aside,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert got.returncode == 0, got.stderr
        assert sorted(installed.rglob("*.nbc")) == held
    assert len(list(aside.rglob("*.nbc"))) == len(held), (
        "read-only, it is read from the user's folder"
    )


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom arfx_cli.main import main\ntry:\n main(['--help'])\nexcept"
        " SystemExit:\n pass\nheavy = {'numpy', 'numba', 'OpenGL', 'scipy', 'cv2',"
        " 'pyrender', 'av', 'matplotlib', 'trimesh'} & set(sys.modules)\nassert not heavy,"
        " heavy"
    )
    got = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert got.returncode == 0, got.stderr
    assert "process" in got.stdout
