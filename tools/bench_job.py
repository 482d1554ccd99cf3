"""`make bench`: whole jobs as ratios to a plain decode and encode with the same codec and
settings, in the same run.

1. a 720p clip whose marker is seen in its first second only       (goal: at most 2.0 x)
2. a 720p clip with a 6,000-triangle model over a tenth of the frame (goal: at most 3.0 x)
3. peak memory of a job of 100 and of 1,000 frames                  (goal: no growth)

Job and plain pass take turns; medians of ratios of whole processes are told, start of
Python included in both."""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import av
import cv2
import numpy as np

from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.measure.bench_scene import COVERED, ball
from arfx.media.cameras import save_camera
from arfx.media.clip import probe
from arfx.media.codecs import CODECS
from arfx.media.output import OutputSettings, plan_output

WIDTH, HEIGHT, FPS = 1280, 720, 30
MARKER = MarkerSpec("36h11", 3, 0.15)
FOCAL_PX, DISTANCE_M = 1150.0, 0.9
# Coded values of ink and paper, whose linear light is as a laser print's reflectances, .04
# and .9: a deeper black would be found to be a camera's negative bias, which no real clip
# has.
PRINT = 51, 225


def camera() -> Camera:
    return Camera(
        WIDTH,
        HEIGHT,
        np.array(
            [
                [FOCAL_PX, 0, (WIDTH - 1) / 2],
                [0, FOCAL_PX, (HEIGHT - 1) / 2],
                [0, 0, 1],
            ]
        ),
    )


def pose(i: int) -> Pose:
    """A hand-held sway around the marker: 2 degrees and 1 cm, about 1 px a frame."""
    t = i / FPS
    turn = rotation_from_euler_deg(180, 0, 0) @ rotation_from_euler_deg(
        -35 + 2 * np.sin(1.1 * t), 0, 0
    )
    turn = turn @ rotation_from_euler_deg(0, 0, 15 + 2 * np.sin(0.7 * t))
    return Pose(
        turn,
        np.array([0.01 * np.sin(0.9 * t), 0.06 + 0.01 * np.sin(1.3 * t), DISTANCE_M]),
    )


def make_clip(path: Path, frames: int, visible: int) -> Path:
    """Textured table with camera noise; the marker lies on it in the first `visible` frames."""
    g = np.random.default_rng(5)
    scale, side, margin, board = 2000.0, 300, 45, 1800
    table = cv2.resize(
        g.integers(70, 180, (board // 12, board // 12, 3)).astype(np.uint8),
        (board, board),
    )
    with_marker = table.copy()
    code = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11),
        MARKER.id,
        side,
    )
    code = np.clip(
        cv2.copyMakeBorder(
            code, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255
        ),
        *PRINT,
    )
    at = board // 2 - code.shape[0] // 2
    with_marker[at : at + code.shape[0], at : at + code.shape[1]] = code[..., None]
    half = board / 2 / scale
    plane = np.array(
        [[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]]
    )
    source = (
        np.array([[0, 0], [board, 0], [board, board], [0, board]], np.float32) - 0.5
    )
    noise = g.normal(0, 2, (4, HEIGHT, WIDTH, 3)).astype(np.float32)
    cam = camera()
    with av.open(str(path), "w") as out:
        stream = out.add_stream(
            "libx264", rate=FPS, options={"crf": "18", "preset": "veryfast"}
        )
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for i in range(frames):
            corners = cam.project(pose(i).apply(plane)).astype(np.float32)
            warp = cv2.getPerspectiveTransform(source, corners)
            picture = cv2.warpPerspective(
                with_marker if i < visible else table,
                warp,
                (WIDTH, HEIGHT),
                flags=cv2.INTER_AREA,
                borderValue=(96, 100, 104),
            )
            picture = np.clip(picture + noise[i % 4], 0, 255).astype(np.uint8)
            out.mux(
                stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24"))
            )
        out.mux(stream.encode(None))
    return path


def write_model(path: Path) -> Path:
    import trimesh

    (part,) = ball().parts
    from PIL import Image

    skin = trimesh.visual.TextureVisuals(
        uv=part.uv * [1, -1] + [0, 1],
        image=Image.fromarray(part.material.base_texture.picture),
    )
    mesh = trimesh.Trimesh(
        part.vertices,
        part.faces,
        vertex_normals=part.normals,
        visual=skin,
        process=False,
    )
    mesh.export(path)
    return path


def plain_command(clip: Path, out: Path) -> list[str]:
    """Decode and encode with the codec and settings that `arfx process` uses by default,
    and as many threads as cores.
    """
    plan = plan_output(probe(clip), out, OutputSettings())
    settings = {
        "encoder": CODECS[plan.codec].encoder, "options": dict(plan.options), "pixel_format": plan.pixel_format,
        "threads": os.cpu_count() or 1, "rate": FPS,
    }  # fmt: skip
    return [
        sys.executable,
        str(Path(__file__).with_name("plain_pass.py")),
        str(clip),
        str(out),
        json.dumps(settings),
    ]


def timed(command: list[str]) -> tuple[float, float]:
    """Wall seconds and peak resident MB of a process (of its largest child, if that is larger)."""
    start = time.perf_counter()
    code = "import resource,subprocess,sys; r=subprocess.run(sys.argv[1:]).returncode; " \
           "print('peak', resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr); sys.exit(r)"  # fmt: skip
    # as after any first run: Python's own bytecode is cached, whatever this environment says
    known = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, "-c", code, *command],
        capture_output=True,
        text=True,
        check=False,
        env=known,
    )
    seconds = time.perf_counter() - start
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stderr}")
    return seconds, float(done.stderr.rsplit("peak", 1)[1]) / 1024


def arfx_command(
    clip: Path, model: Path, lens: Path, out: Path, workers: int | None
) -> list[str]:
    more = [] if workers is None else ["--workers", str(workers)]
    # the ball is a tenth of the frame: pi r^2 = COVERED of it at the marker's distance
    diameter_mm = (
        2e3
        * float(np.sqrt(COVERED * WIDTH * HEIGHT / np.pi))
        * DISTANCE_M
        / FOCAL_PX
        * 0.93
    )
    return [
        sys.executable, "-m", "arfx_cli", "process", str(clip), "--camera", str(lens), "--marker", str(MARKER),
        "--model", str(model), "--fit", f"{diameter_mm:.1f}mm", "-o", str(out), "--overwrite", "--json", *more,
    ]  # fmt: skip


def compare(
    name: str,
    clip: Path,
    parts: tuple[Path, Path],
    folder: Path,
    runs: int,
    goal: float,
    workers: int | None,
) -> dict:
    model, lens = parts
    job = arfx_command(clip, model, lens, folder / "out.mp4", workers)
    base = plain_command(clip, folder / "plain.mp4")
    report = json.loads(
        subprocess.run(job, capture_output=True, text=True, check=True).stdout
    )  # also fills numba's cache
    ratios, jobs, bases = [], [], []
    for _ in range(runs):
        a, b = timed(base)[0], timed(job)[0]
        jobs.append(b)
        bases.append(a)
        ratios.append(b / a)
    row = {
        "case": name, "frames": report["output"]["frames"], "plain_s": statistics.median(bases), "job_s": statistics.median(jobs),
        "ratio": statistics.median(ratios), "goal": goal, "timing": report["timing"],
        "area": {s["name"]: round(s["area_fraction"], 3) for s in report["stages"]},
    }  # fmt: skip
    print(
        f"{name}: {row['job_s']:.2f} s against {row['plain_s']:.2f} s plain ="
        f" {row['ratio']:.2f} x (goal {goal} x)",
        flush=True,
    )
    return row


def main() -> None:
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument(
        "--frames", type=int, default=600, help="length of the two timed clips"
    )
    p.add_argument("--runs", type=int, default=3)
    p.add_argument(
        "--workers",
        type=int,
        help="worker processes of arfx; default: its own choice",
    )
    p.add_argument(
        "--no-memory",
        action="store_true",
        help="leave out the 100 and 1,000 frame jobs",
    )
    p.add_argument("--json", metavar="FILE", help="write all figures here")
    given = p.parse_args()
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = (write_model(folder / "ball.glb"), folder / "camera.yaml")
        save_camera(parts[1], camera())
        print(
            f"{os.cpu_count()} cores, {WIDTH}x{HEIGHT}, {given.frames} frames; making"
            " clips",
            flush=True,
        )
        first = make_clip(folder / "first_second.mp4", given.frames, FPS)
        always = make_clip(folder / "always.mp4", given.frames, given.frames)
        rows.append(
            compare(
                "marker in the first second only",
                first,
                parts,
                folder,
                given.runs,
                2.0,
                given.workers,
            )
        )
        rows.append(
            compare(
                "6,000 triangles over a tenth",
                always,
                parts,
                folder,
                given.runs,
                3.0,
                given.workers,
            )
        )
        if not given.no_memory:
            peaks = {}
            for frames in (100, 1000):
                clip = make_clip(folder / f"{frames}.mp4", frames, frames)
                peaks[frames] = timed(
                    arfx_command(clip, *parts, folder / "out.mp4", 1)
                )[1]
            growth = peaks[1000] / peaks[100]
            print(
                f"peak memory: {peaks[100]:.0f} MB for 100 frames, {peaks[1000]:.0f} MB for"
                f" 1,000 ({growth:.2f} x)",
                flush=True,
            )
            rows.append({"case": "peak memory", "mb": peaks, "ratio": growth})
    if given.json:
        Path(given.json).write_text(json.dumps(rows, indent=1))
    print(
        "(this script itself peaked at"
        f" {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB)"
    )


if __name__ == "__main__":
    main()
