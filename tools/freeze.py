"""What one state of the code gives for many jobs, kept, and held against what another state gives.

`python tools/freeze.py make FOLDER [NAME…] [--tree DIR]` runs the jobs (names may be
patterns: `scene-*`) by the code of a checkout, and keeps of each its facts, plan, report,
output and exit code. Clips are made once, by the first tree that needs them, and kept in
the folder that --clips names: states to be compared must share it, and the machine. `python
tools/freeze.py compare OLD NEW [--expected FILE]` lists what differs, with amounts; exit 1
if anything does that the file does not expect. A line of it is `JOB | WHERE | reason`, the
first two as patterns."""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1]))

from tools.freeze_compare import Difference, compare_jobs

ROOT = Path(__file__).parents[1]
REAL = ROOT.parent / "shared" / "data" / "marker_clips"
PRESET_SCENE = "0041-indirect-light"
PLAIN_SCENE = "0001-orbit"
DEPTH_SCENE = "0022-before-and-behind"
COMMANDS = (
    *(
        "demo",
        "process",
        "plan",
        "batch",
        "tradeoff",
        "inspect",
        "calibrate",
        "target",
        "synth",
        "verify",
    ),
    *("reproduce", "stages", "report", "lens", "bench", "doctor"),
)
KEPT = ("facts.jsonl", "plan.jsonl", "plan_summary.json", "frames.json")


@dataclass(frozen=True)
class Job:
    """One call of arfx, in a folder of its own.

    name : unique, the folder's name;  scene : the sample scene whose clip and job it takes,
    "" = none
    arguments : of the command line; {scene} is the scene's folder;  needs : a file without
    which it is left out
    whole : it renders a clip, whose facts, plan, report and pictures are kept"""

    name: str
    arguments: tuple[str, ...]
    scene: str = ""
    needs: Path | None = None
    whole: bool = True


def scene_job(name: str, scene: str, *more: str) -> Job:
    return Job(name, ("process", "--config", "{scene}/job.toml", *more), scene)


def real_job(name: str, clip: Path, end_s: float, *more: str) -> Job:
    model = str(REAL.parent / "models" / "mikedh-trimesh" / "Duck.glb")
    ends = ("--end", str(end_s)) if end_s else ()
    return Job(
        name, ("process", str(clip), "--model", model, *ends, *more), needs=clip
    )


def jobs() -> Iterator[Job]:
    scenes = sorted(
        p.parent.name for p in (ROOT / "sample_scenes").glob("*/scene.toml")
    )
    for scene in scenes:
        yield scene_job(f"scene-{scene}", scene)
    for preset in sorted((ROOT / "configs").glob("*.toml")):
        yield scene_job(
            f"preset-{preset.stem}", PRESET_SCENE, "--config", preset.stem
        )
    yield scene_job("formula-paper", PRESET_SCENE, "--formula", "paper")
    yield scene_job("pyrender", PLAIN_SCENE, "--set", "raster.backend=pyrender")
    yield scene_job(
        "effects-draft",
        PRESET_SCENE,
        "--pipeline",
        "lightmap,gi,dof",
        "--quality",
        "draft",
    )
    yield scene_job("workers", PLAIN_SCENE, "--workers", "2")
    yield scene_job("dask", PLAIN_SCENE, "--executor", "local:2")
    poses = ("--anchor", "plane", "--poses", "{scene}/poses.txt")
    yield scene_job("plane-poses", DEPTH_SCENE, *poses)
    picture = (
        "--pattern",
        "{scene}/pattern.png:120mm",
        "--camera",
        "{scene}/camera.yaml",
    )
    model = ("--model", "{scene}/model.glb", "--fit", "13cm")
    yield Job(
        "pattern", ("process", "{scene}/clip.mp4", *picture, *model), PLAIN_SCENE
    )
    wpi = REAL / "wpilibsuite-allwpilib"
    camera = ("--camera", str(wpi / "camera.json"))
    marker = ("--marker", "36h11:3:165.1mm", "--fit", "15cm")
    yield real_job(
        "real-fieldvideo", wpi / "fieldvideo_long.mp4", 2.0, *camera, *marker
    )
    tag = REAL / "SciKit-Surgery-snappysonic" / "aruco_tag.avi"
    yield real_job(
        "real-aruco-tag", tag, 0, "--marker", "4X4_50:0:50mm", "--fit", "5cm"
    )
    dark = REAL / "JunkyByte-deepcharuco" / "video_test.mp4"
    yield real_job(
        "real-deepcharuco", dark, 1.0, "--marker", "4X4_50:0:10mm", "--fit", "2cm"
    )
    batch = (
        "batch",
        "{scene}/clip.mp4",
        "--config",
        "{scene}/job.toml",
        "-o",
        "{stem}-out.mkv",
        "--codec",
        "ffv1",
    )
    yield Job("batch", (*batch, "--json"), PLAIN_SCENE, whole=False)
    yield Job(
        "plan",
        ("plan", "--config", "{scene}/job.toml", "--json"),
        PLAIN_SCENE,
        whole=False,
    )
    yield Job(
        "inspect", ("inspect", "{scene}/clip.mp4", "--json"), PLAIN_SCENE, whole=False
    )
    yield Job("stages", ("stages", "all"), whole=False)
    yield Job("stages-json", ("stages", "--json"), whole=False)
    yield Job(
        "reproduce",
        ("reproduce", "all", "-o", "pages", "--short", "--json"),
        whole=False,
    )
    yield Job("help", ("--help",), whole=False)
    for command in COMMANDS:
        yield Job(f"help-{command}", (command, "--help"), whole=False)
    yield Job("error-usage", ("process", "--no-such-option"), whole=False)
    yield Job("error-input", ("inspect", "missing.mp4"), whole=False)
    other = (
        "process",
        "{scene}/clip.mp4",
        "--marker",
        "4X4_50:7:5cm",
        "--model",
        "{scene}/model.glb",
    )
    yield Job("error-no-marker", (*other, "-o", "out.mkv"), PLAIN_SCENE, whole=False)
    wrong = (
        "process",
        "--config",
        "{scene}/job.toml",
        "--set",
        "dof.nothing=1",
        "-o",
        "out.mkv",
    )
    yield Job("error-setting", wrong, PLAIN_SCENE, whole=False)


def run(
    tree: Path, arguments: list[str], folder: Path
) -> subprocess.CompletedProcess[str]:
    """One call of the tree's arfx, at a fixed width of the terminal."""
    environment = {
        **os.environ,
        "PYTHONPATH": f"{tree}{os.pathsep}{tree / 'cli'}",
        "COLUMNS": "100",
    }
    command = [sys.executable, "-m", "arfx_cli", *arguments]
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def scene_folder(tree: Path, scene: str, clips: Path) -> Path:
    """The scene's clip, made if need be: whole, or not there."""
    folder = clips / scene
    if not folder.is_dir():
        clips.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=clips) as work:
            description = tree / "sample_scenes" / scene / "scene.toml"
            done = run(
                tree, ["synth", str(description), "-o", f"{work}/made", "-q"], clips
            )
            if done.returncode:
                raise SystemExit(
                    f"{scene}: its clip could not be made: {done.stderr}"
                )
            add_inputs(Path(work, "made"))
            Path(work, "made").rename(folder)
    return folder


def add_inputs(folder: Path) -> None:
    """Beside a scene's clip: its camera's path by the truth, and a print as a picture
    without code.
    """
    lines = []
    for line in (folder / "truth.jsonl").read_text().splitlines()[1:]:
        turn, place = np.split(np.array(json.loads(line)["camera_from_room"]), 2)
        room_from_camera = Rotation.from_rotvec(turn).inv()
        numbers = [*-room_from_camera.apply(place), *room_from_camera.as_quat()]
        lines.append(" ".join(f"{v:.9f}" for v in numbers))
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cv2.imwrite(
        str(folder / "pattern.png"), cv2.aruco.generateImageMarker(codes, 3, 400)
    )


def make(folder: Path, tree: Path, clips: Path, names: list[str]) -> None:
    """Each job's folder in `folder`, made anew; what was there under its name goes."""
    for job in jobs():
        if names and not any(fnmatch.fnmatchcase(job.name, name) for name in names):
            continue
        if job.needs is not None and not job.needs.is_file():
            print(f"{job.name}: left out, {job.needs} is not there", flush=True)
            continue
        kept = folder / job.name
        shutil.rmtree(kept, ignore_errors=True)
        kept.mkdir(parents=True)
        source = scene_folder(tree, job.scene, clips) if job.scene else None
        arguments = [a.replace("{scene}", str(source)) for a in job.arguments]
        if job.whole:
            arguments += [
                "-o",
                "out.mkv",
                "--codec",
                "ffv1",
                "--job",
                "job",
                "--report",
                "report",
            ]
        done = run(tree, arguments, kept)
        (kept / "call.json").write_text(
            json.dumps({"exit": done.returncode, "output": done.stdout}, indent=1)
        )
        (kept / "messages.txt").write_text(done.stderr)
        for name in KEPT:
            if (kept / "job" / name).is_file():
                shutil.copyfile(kept / "job" / name, kept / name)
        if (kept / "report" / "report.json").is_file():
            shutil.copyfile(kept / "report" / "report.json", kept / "report.json")
        for scratch in ("job", "report", "pages"):
            shutil.rmtree(kept / scratch, ignore_errors=True)
        print(f"{job.name}: exit {done.returncode}", flush=True)


def read_expected(path: Path | None) -> list[tuple[str, str]]:
    """(pattern of the job, pattern of the place) of every line; a line without a reason is
    an error.
    """
    out = []
    for number, line in enumerate(path.read_text().splitlines() if path else [], 1):
        if not line.strip() or line.startswith("#"):
            continue
        parts = [p.strip() for p in line.split("|")]
        if len(parts) != 3 or not parts[2]:
            raise SystemExit(f"{path}, line {number}: not JOB | WHERE | reason")
        out.append((parts[0], parts[1]))
    return out


def compare(old: Path, new: Path, expected: Path | None) -> int:
    """How many differences nothing explains; all are printed."""
    rules = read_expected(expected)
    names = sorted(
        {p.name for tree in (old, new) for p in tree.iterdir() if p.is_dir()}
    )
    unexplained = 0
    for name in names:
        found: list[Difference] = []
        if not ((old / name).is_dir() and (new / name).is_dir()):
            found = [Difference("job", "is there in one only")]
        else:
            found = compare_jobs(old / name, new / name)
        for difference in found:
            fits = [
                fnmatch.fnmatchcase(name, a)
                and fnmatch.fnmatchcase(difference.where, b)
                for a, b in rules
            ]
            unexplained += not any(fits)
            print(
                f"{name}: {difference.where}:"
                f" {difference.what}{' (expected)' if any(fits) else ''}"
            )
    print(f"{len(names)} jobs, {unexplained} differences that are not expected")
    return unexplained


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("make", "compare"))
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "more",
        nargs="*",
        help="make: names of jobs; compare: the folder of the other state",
    )
    parser.add_argument(
        "--tree", type=Path, default=ROOT, help="checkout whose code runs"
    )
    parser.add_argument(
        "--clips",
        type=Path,
        default=Path(tempfile.gettempdir()) / "arfx-freeze-clips",
    )
    parser.add_argument("--expected", type=Path)
    given = parser.parse_intermixed_args()
    if given.what == "make":
        make(
            given.folder.absolute(),
            given.tree.absolute(),
            given.clips.absolute(),
            given.more,
        )
        return 0
    if len(given.more) != 1:
        parser.error("compare takes two folders")
    return int(compare(given.folder, Path(given.more[0]), given.expected) > 0)


if __name__ == "__main__":
    sys.exit(main())
