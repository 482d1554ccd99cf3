"""An effect in a distribution of its own is a stage like any other, once it is installed;
nothing of arfx's names it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from tests.cli.conftest import Result
from tests.clips import MARKER, write_camera, write_clip, write_model

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FRAMES = 31  # two chunks, so that two processes render
JOB = (
    "clip.mp4",
    "--camera",
    "camera.yaml",
    "--marker",
    str(MARKER),
    "--model",
    "model.glb",
    "--fit",
    "8cm",
)
SEVERAL = """
import contextlib, io, json, pathlib, sys
from arfx.measure import costs
from arfx_cli.main import main

smallest = costs.SCENES.read_text().split("[[scene]]")[2]
costs.SCENES = pathlib.Path("smallest.toml")
costs.SCENES.write_text("[[scene]]" + smallest)
for arguments in json.loads(sys.argv[1]):
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as e:
            code = e.code or 0
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""
MEASURE = "arfx bench --calibrate --stage film_grain"
Run = Callable[..., Result]

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that it is installed into.

    From a copy: building leaves files beside the source.
    """
    d = tmp_path_factory.mktemp("plugin")
    shutil.copytree(HERE / "film_grain", d / "source")
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-index",
        "--no-deps",
        "--no-build-isolation",
    ]
    subprocess.run(
        [*install, "--target", str(d / "site"), str(d / "source")],
        check=True,
        timeout=300,
    )
    return d / "site"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    d = tmp_path_factory.mktemp("job")
    write_clip(d / "clip.mp4", FRAMES)
    write_camera(d / "camera.yaml")
    write_model(d / "model.glb")
    return d


def environment(site: Path, folder: Path) -> dict[str, str]:
    """Of a process that finds the plug-in, with a price list of its own."""
    path = os.pathsep.join([str(site), *(p for p in sys.path if p)])
    return {**os.environ, "PYTHONPATH": path, "XDG_CACHE_HOME": str(folder / "cache")}


@pytest.fixture(scope="module")
def arfx(site: Path, folder: Path) -> Run:
    def run(command: str, *more: str, at: Path = site) -> Result:
        given = [*JOB, *more] if command == "process" else more
        p = subprocess.run(
            [sys.executable, "-m", "arfx_cli", command, *given], cwd=folder, env=environment(at, folder), capture_output=True,
            text=True, check=False, timeout=300,
        )  # fmt: skip
        return Result(p.returncode, p.stdout, p.stderr)

    return run


GRAINY = ("--set", "film_grain.strength=0.05", "--codec", "ffv1", "--overwrite")
AGAIN = (
    *GRAINY,
    "--workers",
    "1",
    "-o",
    "grain.mkv",
    "--job",
    "grain.job",
    "--resume",
)


@pytest.fixture(scope="module")
def rendered(arfx: Run, folder: Path) -> Path:
    """The job's folder; grain.mkv lies beside it."""
    r = arfx(
        "process",
        *GRAINY,
        "--workers",
        "2",
        "-o",
        "grain.mkv",
        "--job",
        "grain.job",
        "--report",
        "report",
    )
    assert r.code == 0, r.err
    return folder / "grain.job"


def key(job: Path) -> str:
    return str(json.loads((job / "seal.json").read_text())["job_key"])


@pytest.fixture(scope="module")
def first_key(rendered: Path) -> str:
    return key(rendered)


@pytest.fixture(scope="module")
def told(site: Path, folder: Path, first_key: str) -> dict[str, Result]:
    """What commands say that run, in this order and after `rendered`, in one process: each
    of its own takes seconds to start.
    """
    plan = ["plan", *JOB, "--pipeline", "film_grain"]
    costs = [
        "--pipeline",
        "film_grain",
        "--formula",
        "paper",
        "--frames",
        "1",
        "--json",
    ]
    commands = {
        "plan": plan,
        "in budget": [*plan, "--budget", "60s"],
        "stages": ["stages", "film_grain"],
        "measure": ["bench", "--calibrate", "--stage", "film_grain", "--json"],
        "in budget again": [*plan, "--budget", "60s", "--json"],
        "tradeoff": ["tradeoff", *JOB, *costs],
        "without": [
            "process",
            *JOB,
            "--set",
            "film_grain.strength=0",
            *GRAINY[2:],
            "--workers",
            "1",
            "-o",
            "bare.mkv",
        ],
        "again": ["process", *JOB, *AGAIN],
    }
    p = subprocess.run(
        [sys.executable, "-c", SEVERAL, json.dumps(list(commands.values()))], cwd=folder, env=environment(site, folder),
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert p.returncode == 0, p.stderr
    return dict(
        zip(
            commands,
            (Result(*json.loads(line)) for line in p.stdout.splitlines()),
            strict=True,
        )
    )


def pictures(path: Path) -> np.ndarray:
    """(n, h, w, 3) 0..1, as displayed."""
    with ClipReader(probe(path)) as reader:
        return np.stack([frame.rgb8() for frame in reader.frames()]) / 255.0


def test_it_lies_on_every_frame_as_strong_as_asked_for_and_new_in_each(
    told: dict[str, Result], rendered: Path, folder: Path
) -> None:
    assert told["without"].code == 0, told["without"].err
    grain, bare = pictures(folder / "grain.mkv"), pictures(folder / "bare.mkv")
    noise, middle = (grain - bare)[..., 1], abs(bare[..., 1] - 0.5) < 0.1
    assert len(noise) == FRAMES and noise[middle].std() == pytest.approx(
        0.05, rel=0.15
    )
    assert abs(noise[middle].mean()) < 0.003, "it neither lightens nor darkens"
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02, (
        "new in every frame"
    )
    assert (
        np.corrcoef(noise[0][:, 1:].ravel(), noise[0][:, :-1].ravel())[0, 1] > 0.3
    ), "a grain is wider than a pixel"


def test_the_report_tells_what_it_did(rendered: Path, folder: Path) -> None:
    row = next(
        s
        for s in json.loads((rendered / "report.json").read_text())["stages"]
        if s["name"] == "film_grain"
    )
    assert (
        row["frames_run"] == FRAMES
        and row["measured_s"] > 0
        and row["predicted_s"] is None
    ), "no price is made up"
    assert "film_grain" in (folder / "report" / "report.html").read_text()


def test_what_another_version_of_it_rendered_is_not_used_again(
    arfx: Run,
    told: dict[str, Result],
    rendered: Path,
    first_key: str,
    site: Path,
    tmp_path: Path,
) -> None:
    assert told["again"].code == 0 and key(rendered) == first_key
    shutil.copytree(site, tmp_path / "other")
    with (tmp_path / "other" / "arfx_film_grain.py").open("a") as f:
        f.write("# another\n")
    assert (
        arfx("process", *AGAIN, at=tmp_path / "other").code == 0
        and key(rendered) != first_key
    )


def test_without_a_price_a_plan_says_so_and_a_budget_is_refused_until_it_is_measured(
    told: dict[str, Result],
) -> None:
    planned, refused, listed, r, again = (
        told[k] for k in ("plan", "in budget", "stages", "measure", "in budget again")
    )
    assert (
        planned.code == 0
        and f"unknown: film_grain has no price here; `{MEASURE}` measures it"
        in planned.err + planned.out
    )
    assert (
        "film_grain.strength = 0.02" in listed.out and "price unknown" in listed.out
    )
    assert (
        refused.code == 2
        and "film_grain has no price here" in refused.err
        and MEASURE in refused.err
    )
    assert r.code == 0, r.err
    assert {row["entry"] for row in r.json["prices"]} == {
        "film_grain/standard",
        "prepare film_grain/standard",
    }
    assert again.code == 0, again.err
    assert again.json["predicted"]["wall"]["s"] > 0
    assert again.json["predicted"]["calibrated"] is False, (
        "the others' prices are still another machine's"
    )


def test_what_accuracy_costs_is_measured_with_it(told: dict[str, Result]) -> None:
    assert told["tradeoff"].code == 0, told["tradeoff"].err
    pipelines = told["tradeoff"].json["pipelines"]
    assert pipelines and all("film_grain" in row["levels"] for row in pipelines)


def test_it_keeps_the_laws_of_every_stage(site: Path, folder: Path) -> None:
    """The contract's tests run over the table, and it is in it."""
    p = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "tests/contract/test_stages.py", "-k", "film_grain"],
        cwd=ROOT, env=environment(site, folder), capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert p.returncode == 0, p.stdout
    assert "7 passed" in p.stdout
