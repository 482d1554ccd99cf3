"""The rates of the depth-of-field paper again: 1280x1024, `--pipeline dof`, end to end, whole picture and a fifth blurred.

Of jobs of N and 2 N frames the difference is told, so that starting up does not count: wall time, and processor time (on a
busy machine the steadier of the two: what a quiet one with as many cores reaches is near cores / processor time).
Goals on two cores: 14 frames/s with the whole picture blurred (the paper's CPU rate), 25 with at most 20 % of it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import bench_job

from arfx.media.cameras import save_camera

bench_job.WIDTH, bench_job.HEIGHT = 1280, 1024
# The ball stands on the marker, .9 m away; the far part of the table is held in the focus by background_m.
CASES = {
    "whole picture blurred": (14.0, ["dof.focus=10m", "dof.aperture_px=1.7", "dof.max_radius_px=60"]),
    "at most 20 % blurred": (25.0, ["dof.focus=85cm", "dof.aperture_px=20", "dof.background_m=0.85"]),
}


def run(command: list[str]) -> tuple[dict, float, float]:
    """Report, wall seconds and processor seconds of a job."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return json.loads(done.stdout), wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--frames", type=int, default=300, help="N; the longer job has twice as many")
    given = p.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model, lens = bench_job.write_model(folder / "ball.glb"), folder / "camera.yaml"
        save_camera(lens, bench_job.camera())
        clips = [bench_job.make_clip(folder / f"{n}.mp4", n, n) for n in (given.frames, 2 * given.frames)]
        print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
        for case, (goal, settings) in CASES.items():
            more = [part for s in settings for part in ("--set", s)]
            made = [
                run([*bench_job.arfx_command(c, model, lens, folder / "out.mp4", None), "--pipeline", "dof", *more])
                for c in clips
            ]
            wall, cpu = (made[1][k] - made[0][k] for k in (1, 2))
            area = next(s["area_fraction"] for s in made[1][0]["stages"] if s["name"] == "dof")
            seconds = {s["name"]: round(1e3 * s["measured_s"] / 2 / given.frames, 1) for s in made[1][0]["stages"]}
            print(
                f"{case}: {given.frames / wall:.1f} frames/s wall, {1e3 * cpu / given.frames:.1f} ms of processor a frame = "
                f"{2 * given.frames / cpu:.1f} frames/s on two free cores (goal {goal:g}); dof on {area:.0%}; ms {seconds}",
                flush=True,
            )


if __name__ == "__main__":
    main()
