"""What of a job is not a stage's, timed on whole small jobs: editing the planes, encoding, joining."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np

from arfx.config.load import load
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.measure.bench_scene import ball
from arfx.media.cameras import save_camera
from arfx.run.folder import JobFolder, read_lines
from arfx.run.job import Options, process
from arfx.run.parameters import parameters

if TYPE_CHECKING:
    from arfx.measure.costs import Runs

MARKER = MarkerSpec("36h11", 3, 0.15)
FRAMES = 60  # two chunks: two threads are busy
# width, height, what the output is written as
JOBS = ((640, 360, "h264"), (640, 360, "ffv1"), (1280, 720, "h264"), (1280, 720, "ffv1"))


def time_jobs(timed: dict[str, Runs], progress: Callable[[int, int], None]) -> None:
    """Add runs of "edit", "encode CODEC" and "join" to `timed`."""
    with tempfile.TemporaryDirectory(prefix="arfx-calibrate-") as folder:
        place, clips = Path(folder), {}
        model = _write_model(place / "ball.ply")
        for k, (width, height, codec) in enumerate(JOBS):
            if (width, height) not in clips:
                clips[width, height] = write_clip(place / f"{width}.mp4", width, height)
            _time_job(place, clips[width, height], model, codec, timed)
            progress(k + 1, len(JOBS))


def _time_job(place: Path, clip: tuple[Path, Path], model: Path, codec: str, timed: dict[str, Runs]) -> None:
    out = place / f"{clip[0].stem}-{codec}.mkv"
    job: dict[str, Any] = {
        "input": {"clip": str(clip[0]), "camera": str(clip[1])}, "marker": [{"spec": str(MARKER)}],
        "model": {"file": str(model), "fit": "0.15m"}, "pipeline": {"stages": []},
        "output": {"path": str(out), "codec": codec},
    }  # fmt: skip
    folder = JobFolder(place / f"{out.stem}.job")
    report = process(load(None, job, parameters()), Options(folder.path, workers=None, notice=lambda _: None))
    rows = [json.loads(line) for line in folder.timings.read_text(encoding="utf-8").splitlines()]
    chunks = [row["seconds"] for row in rows if row["work"] == "chunk"]
    plans = [p for p in read_lines(folder.plan) if p["steps"]]
    edited = sum(_area(p["rect"]) + _area(p["changed"]) for p in plans) / 1e6
    mpx = report["input"]["width"] * report["input"]["height"] * FRAMES / 1e6
    encode_s = sum(c["encode"] for c in chunks)
    whole = {"frames": float(FRAMES), "mpx": mpx}
    timed["edit"].add({"frames": float(len(plans)), "mpx": edited}, sum(c["edit"] for c in chunks))
    timed[f"encode {codec}"].add(whole, encode_s)
    timed["join"].add(whole, report["timing"]["encode_s"] - encode_s)


def _area(rect: list[int]) -> int:
    x0, y0, x1, y1 = rect
    return (x1 - x0) * (y1 - y0)


def _write_model(path: Path) -> Path:
    import trimesh

    (part,) = ball().parts
    trimesh.Trimesh(part.vertices, part.faces, process=False).export(path)
    return path


def write_clip(path: Path, width: int, height: int, frames: int = FRAMES) -> tuple[Path, Path]:
    """A marker on a textured table with camera noise, swaying as if hand-held. Returns the clip and its calibration."""
    g = np.random.default_rng(5)
    focal, board, scale = 0.9 * width, 1200, 1500.0
    camera = Camera(width, height, np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]]))
    table = cv2.resize(g.integers(70, 180, (board // 12, board // 12, 3)).astype(np.uint8), (board, board))
    side = round(MARKER.size_m * scale)
    code = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), MARKER.id, side)
    code = np.clip(cv2.copyMakeBorder(code, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255), 25, 225)
    at = (board - code.shape[0]) // 2
    table[at : at + code.shape[0], at : at + code.shape[0]] = code[..., None]
    half = board / 2 / scale
    plane = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    corners = np.array([[0, 0], [board, 0], [board, board], [0, board]], np.float32) - 0.5
    noise = g.normal(0, 2, (4, height, width, 3)).astype(np.float32)
    with av.open(str(path), "w") as out:
        stream: Any = out.add_stream("libx264", rate=30, options={"crf": "18", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for i in range(frames):
            t = i / 30
            turn = rotation_from_euler_deg(145 + 2 * np.sin(1.1 * t), 0, 0) @ rotation_from_euler_deg(0, 0, 15 + 2 * np.sin(t))
            pose = Pose(turn, np.array([0.01 * np.sin(0.9 * t), 0.04, 0.7]))
            warp = cv2.getPerspectiveTransform(corners, camera.project(pose.apply(plane)).astype(np.float32))
            picture = cv2.warpPerspective(table, warp, (width, height), flags=cv2.INTER_AREA, borderValue=(96, 100, 104))
            picture = np.clip(picture + noise[i % 4], 0, 255).astype(np.uint8)
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        out.mux(stream.encode(None))
    calibration = path.with_suffix(".json")
    save_camera(calibration, camera)
    return path, calibration
