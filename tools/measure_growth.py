"""What a frame costs as clips get longer: whole jobs over the same loop of film, repeated,
marker in and out of view.

Processor seconds by phase, whoever does the work. Growth is a frame's cost in the longest
job over that in the job of --base
frames: in shorter ones, what is paid once for a job counts.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from bench_job import PRINT, write_model

from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.media.cameras import save_camera
from arfx.run.memory import peak_mb

WIDTH, HEIGHT, FPS, LOOP = 160, 120, 30, 100
FOCAL_PX = 150.0
MARKER = MarkerSpec("36h11", 3, 0.15)
PHASES = (
    "stretches",
    "their join",
    "end of analysis",
    "plan",
    "keys of chunks",
    "render",
    "join",
    "report",
    "page",
    "all else",
)


def make_loop(path: Path, turned: bool) -> None:
    """LOOP frames that go on from their end to their beginning, with two cuts: to other
    pictures for a while, and back.

    The camera moves over a table with a print on it, away from it and back; or (`turned`)
    it rests, and the print is moved and turned under a lamp that gets brighter and darker:
    the light's account has many pieces."""
    g = np.random.default_rng(5)
    size, side = 1200, 220  # pixels of the table, and of the print with its margin
    table = cv2.resize(
        g.integers(70, 180, (size // 15, size // 15, 3)).astype(np.uint8),
        (size, size),
    ).astype(np.float32)
    code = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11),
        MARKER.id,
        160,
    )
    code = np.clip(
        cv2.copyMakeBorder(code, 30, 30, 30, 30, cv2.BORDER_CONSTANT, value=255),
        *PRINT,
    ).astype(np.float32)
    noise = g.normal(0, 2, (4, HEIGHT, WIDTH, 3)).astype(np.float32)
    lamp = np.array([0.4, -0.5, -0.77])

    def drawn(picture: np.ndarray, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """A picture at the print's scale, its middle at the pose's origin, as the camera
        sees it, and where it is.
        """
        h, w = picture.shape[:2]
        x, y = np.array([w, h]) / 2 * MARKER.size_m / 160
        corners = (
            camera()
            .project(
                pose.apply(np.array([[-x, y, 0], [x, y, 0], [x, -y, 0], [-x, -y, 0]]))
            )
            .astype(np.float32)
        )
        source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - 0.5
        warp = cv2.getPerspectiveTransform(source, corners)
        seen, where = (
            cv2.warpPerspective(a, warp, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
            for a in (picture, np.ones((h, w, 1), np.float32))
        )
        return seen.reshape(HEIGHT, WIDTH, -1), where[..., None]

    with_print = table.copy()
    at = (size - side) // 2
    with_print[at : at + side, at : at + side] = code[..., None]
    facing = Pose(rotation_from_euler_deg(180, 0, 0), np.array([0, 0, 0.32]))
    with av.open(str(path), "w") as out:
        stream = out.add_stream(
            "libx264", rate=FPS, options={"crf": "16", "g": str(LOOP), "bf": "0"}
        )
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for i in range(LOOP):
            turn = 2 * math.pi * i / LOOP
            place = np.array(
                [-0.18 * (1 - math.cos(turn)), 0.005 * math.sin(turn), 0.32]
            )
            if 40 <= i < 60:
                picture = drawn(table[::-1, ::-1] * 0.8, facing)[0]
            elif turned:
                pose = Pose(
                    rotation_from_euler_deg(
                        180 + 40 * math.sin(2 * turn), 40 * math.cos(3 * turn), 0
                    ),
                    place,
                )
                light = 0.35 + 0.65 * max(0.0, float(pose.rotation[:, 2] @ lamp)) * (
                    1 + 0.3 * math.sin(turn)
                )
                seen, where = drawn(code, pose)
                picture = drawn(table, facing)[0]
                picture += where * (seen * light ** (1 / 2.2) - picture)
            else:
                tilt = rotation_from_euler_deg(
                    205 + 5 * math.sin(2 * turn), 4 * math.sin(turn), 0
                )
                picture = drawn(with_print, Pose(tilt, place))[0]
            picture = np.clip(picture + noise[i % 4], 0, 255).astype(np.uint8)
            out.mux(
                stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24"))
            )
        out.mux(stream.encode(None))


def make_clip(loop: Path, path: Path, frames: int) -> Path:
    """`loop` again and again: its packets with later times, nothing is encoded."""
    with av.open(str(path), "w") as out, av.open(str(loop)) as first:
        source = first.streams.video[0]
        stream = out.add_stream_from_template(source)
        stream.time_base = source.time_base
        step = int(1 / (FPS * source.time_base))
        for start in range(0, frames, LOOP):
            with av.open(str(loop)) as c:
                for k, p in enumerate(
                    p for p in c.demux(c.streams.video[0]) if p.size
                ):
                    if start + k < frames:
                        p.pts = p.dts = (start + k) * step
                        p.stream = stream
                        out.mux(p)
    return path


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


def arguments(folder: Path, clip: Path, workers: int, more: list[str]) -> list[str]:
    return [
        "process", str(clip), "--camera", str(folder / "camera.yaml"), "--marker", str(MARKER), "--fit", "8cm",
        "--model", str(folder / "ball.glb"), "-o", str(folder / "out.mp4"), "--job", str(folder / "job"),
        "--report", str(folder / "report"), "--overwrite", "--workers", str(workers), *more,
    ]  # fmt: skip


def processor_s() -> float:
    own, started = (
        resource.getrusage(who)
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return own.ru_utime + own.ru_stime + started.ru_utime + started.ru_stime


class Phases:
    """Processor seconds by phase, each without those that it calls, of this process and
    those that it started and that ended.
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PHASES, 0.0)
        self.peaks_mb: dict[str, float] = {}
        self._open = [PHASES[-1]]
        self._since = processor_s()

    def _turn(self) -> None:
        now = processor_s()
        self.seconds[self._open[-1]] += now - self._since
        self._since = now

    def of(self, owner: Any, name: str, phase: str) -> None:
        """Count the calls of owner.name to a phase, from now on."""
        whole = getattr(owner, name)

        def timed(*args: Any, **more: Any) -> Any:
            self._turn()
            self._open.append(phase)
            try:
                return whole(*args, **more)
            finally:
                self._turn()
                self._open.pop()
                self.peaks_mb[phase] = peak_mb()

        setattr(owner, name, timed)

    def told(self) -> dict[str, Any]:
        self._turn()
        return {"seconds": self.seconds, "peaks_mb": self.peaks_mb}


def measured_job(told: Path, command: list[str]) -> None:
    """In a process of its own: the command, with its phases timed; what they took goes into
    the file `told`.
    """
    from arfx.measure import report
    from arfx.run import analysis, job
    from arfx_cli import main as cli

    phases = Phases()
    phases.of(analysis, "analyse_stretch", "stretches")
    phases.of(job, "_analyse", "their join")
    phases.of(analysis, "analyse", "end of analysis")
    phases.of(job, "plan_job", "plan")
    phases.of(job, "_chunks", "keys of chunks")
    phases.of(job, "_render", "render")
    phases.of(job, "_join", "join")
    phases.of(job, "build_report", "report")
    phases.of(report, "report_of_job", "page")
    try:
        cli.main(command)
    finally:
        told.write_text(json.dumps(phases.told()))


def run(
    folder: Path, frames: int, turned: bool, workers: int, more: list[str]
) -> dict[str, Any]:
    """A job over `frames` frames in a process of its own, and what it left."""
    clip = make_clip(folder / f"loop{turned:d}.mp4", folder / "clip.mp4", frames)
    told = folder / "told.json"
    start = time.perf_counter()
    command = [
        sys.executable,
        __file__,
        "--job",
        str(told),
        *arguments(folder, clip, workers, more),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    found = {
        "frames": frames,
        **json.loads(told.read_text()),
        "wall_s": time.perf_counter() - start,
    }
    rows = [
        json.loads(line)
        for line in (folder / "job/timings.jsonl").read_text().splitlines()
    ]
    found["workers_mb"] = sorted(
        {
            row["worker"].split()[0]: row["rss_mb"]
            for row in rows
            if row["work"] == "chunk"
        }.values()
    )
    found["job_mb"] = {
        p.name: p.stat().st_size / 1e6
        for p in sorted((folder / "job").iterdir())
        if p.is_file()
    }
    found["report_mb"] = (
        sum(p.stat().st_size for p in (folder / "report").iterdir()) / 1e6
    )
    return found


def main() -> None:
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument(
        "lengths",
        nargs="*",
        type=int,
        default=[100, 1000, 10_000],
        help="frames of each job",
    )
    p.add_argument(
        "--turned",
        action="store_true",
        help="the camera rests, the print is turned under a lamp that changes",
    )
    p.add_argument(
        "--workers",
        type=int,
        default=1,
        help="processes; of several the seconds are not counted",
    )
    p.add_argument(
        "--base",
        type=int,
        default=1000,
        help="frames of the job that growth is counted from",
    )
    p.add_argument(
        "--option",
        action="append",
        default=[],
        help="of `arfx process`, such as --option=--budget=20",
    )
    p.add_argument("--json", metavar="FILE", help="write all figures here")
    given = p.parse_args()
    found = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_loop(folder / f"loop{given.turned:d}.mp4", given.turned)
        write_model(folder / "ball.glb")
        save_camera(folder / "camera.yaml", camera())
        for frames in given.lengths:
            found.append(
                run(folder, frames, given.turned, given.workers, given.option)
            )
            print(f"{frames} frames: {found[-1]['wall_s']:.0f} s", flush=True)
            if given.json:
                Path(given.json).write_text(json.dumps(found, indent=1))
    print(table(found, given.base))


def table(found: list[dict[str, Any]], base: int) -> str:
    """Milliseconds and kilobytes a frame."""
    rows = [["a frame", *(f"{f['frames']:,}" for f in found), "growth"]]

    def row(name: str, of: Callable[[dict[str, Any]], float]) -> None:
        values = {f["frames"]: of(f) / f["frames"] for f in found}
        grown = values[found[-1]["frames"]] / (values.get(base) or math.inf)
        rows.append([name, *(f"{v:.3f}" for v in values.values()), f"{grown:.2f}"])

    for phase in PHASES:
        row(f"{phase}, ms", lambda f, phase=phase: f["seconds"][phase] * 1e3)
    row("all, ms", lambda f: sum(f["seconds"].values()) * 1e3)
    row("job folder, kB", lambda f: sum(f["job_mb"].values()) * 1e3)
    row("report, kB", lambda f: f["report_mb"] * 1e3)
    for name in found[-1]["peaks_mb"]:
        rows.append(
            [
                f"peak memory after {name}, MB",
                *(f"{f['peaks_mb'].get(name, 0):.0f}" for f in found),
                "",
            ]
        )
    rows.append(
        [
            "peak memory of workers, MB",
            *(" ".join(f"{mb:.0f}" for mb in f["workers_mb"]) for f in found),
            "",
        ]
    )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join([r[0].ljust(widths[0]), *map(str.rjust, r[1:], widths[1:])])
        for r in rows
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--job"]:
        measured_job(Path(sys.argv[2]), sys.argv[3:])
    else:
        main()
