"""One job by one worker, threads, processes and a local Dask cluster: the same bytes? Wall
and processor seconds of each.

    measure_executors.py                           the whole job, four ways
    measure_executors.py --analysis                its analysis by two threads and two
    processes, against one worker

Take the machine for it: times of a machine that does other things say little.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench_job import FPS, arfx_command, camera, make_clip, write_model

from arfx.media.cameras import save_camera

JOBS = {
    "one worker": ["--workers", "1"], "threads, one per core": [], "2 processes": ["--workers", "2"],
    "Dask, 2 workers of this machine": ["--executor", "local:2"],
}  # fmt: skip
ANALYSES = {
    "one worker, one decoder thread": [1, 0, 0], "one worker": [1, 0, 1], "2 threads": [2, 1, 0], "2 processes": [2, 0, 0],
}  # fmt: skip


def timed(command: list[str]) -> tuple[float, float]:
    """Wall seconds of a process, and processor seconds of it and of all that it started:
    what it leaves behind, as the server that forked its workers, becomes a child of this
    process."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wall_s = time.perf_counter() - start
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def compare_jobs(command: list[str], folder: Path, keep: Path | None) -> None:
    print(f"{'':36}{'wall s':>8}{'processor s':>13}  sha256 of the output")
    found = set()
    timed([*command, "--workers", "2"])  # compiles, and fills the caches of the disk
    for name, more in JOBS.items():
        kept = (
            ["--job", str(keep), "--overwrite"]
            if keep is not None and name == "one worker"
            else []
        )
        wall_s, cpu_s = timed([*command, *more, *kept])
        found.add(sha256(folder / "out.mp4"))
        print(
            f"{name:36}{wall_s:8.1f}{cpu_s:13.1f}  {sha256(folder / 'out.mp4')[:16]}",
            flush=True,
        )
    print("the same bytes" if len(found) == 1 else "OTHER BYTES")


def compare_analyses(command: list[str], folder: Path) -> None:
    print(f"{'':36}{'wall s':>8}{'speed-up':>10}  sha256 of facts.jsonl")
    base, found = 0.0, set()
    for name, how in ANALYSES.items():
        out = folder / "told"
        timed(
            [
                sys.executable,
                __file__,
                "--one",
                *map(str, how),
                str(out),
                *command[3:],
                "--job",
                str(folder / "job"),
            ]
        )
        wall_s, facts = json.loads(out.read_text())
        base = base or wall_s
        found.add(facts)
        print(
            f"{name:36}{wall_s:8.2f}{base / wall_s:10.2f}  {facts[:16]}", flush=True
        )
    print("the same facts" if len(found) == 1 else "OTHER FACTS")


def one_analysis(
    workers: int, threads: bool, decoders: bool, told: Path, command: list[str]
) -> None:
    """In a process of its own: the analysis alone, once to load compiled code and once
    measured, with workers that start anew.
    """
    from arfx.run import job, stretches

    if not decoders:
        import cv2

        frames = stretches.clip_frames
        stretches.clip_frames = lambda info, first_pts, alone, *more: frames(
            info, first_pts, False, *more
        )
        if workers == 1:
            cv2.setNumThreads(1)
    job.worker_count = lambda pixels, stated=None: (workers, threads)
    analyse = job._analyse

    def measured(
        inputs: object,
        folder: job.JobFolder,
        key: str,
        options: job.Options,
        log: object,
        cluster: object,
    ) -> None:
        rest = key, options, log, cluster
        analyse(inputs, folder, *rest)
        options.processes._end()
        folder.clear("stretches")
        folder.stretches.mkdir()
        start = time.perf_counter()
        analyse(inputs, folder, *rest)
        told.write_text(
            json.dumps([time.perf_counter() - start, sha256(folder.facts)])
        )
        raise SystemExit(0)

    job._analyse = measured
    from arfx_cli import main

    main.main(command)


def main() -> None:
    if sys.argv[1:2] == ["--one"]:
        workers, threads, decoders = map(int, sys.argv[2:5])
        one_analysis(
            workers, bool(threads), bool(decoders), Path(sys.argv[5]), sys.argv[6:]
        )
        return
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("--frames", type=int, default=1000)
    p.add_argument("--analysis", action="store_true")
    p.add_argument(
        "--keep", type=Path, help="job folder of the job by one worker, to be kept"
    )
    given = p.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip = make_clip(folder / "clip.mp4", given.frames, given.frames - 10 * FPS)
        model, lens = write_model(folder / "ball.glb"), folder / "camera.yaml"
        save_camera(lens, camera())
        print(f"{os.cpu_count()} cores, 1280x720, {given.frames} frames", flush=True)
        command = arfx_command(clip, model, lens, folder / "out.mp4", None)
        if given.analysis:
            compare_analyses(command, folder)
        else:
            compare_jobs(command, folder, given.keep)


if __name__ == "__main__":
    main()
