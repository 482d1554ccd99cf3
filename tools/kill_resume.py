"""kill -9 at random times of a job, then --resume, again and again until it is done: are the bytes those of an unkilled run?

    python tools/kill_resume.py -n 50 --phase analyse -- process clip.mp4 --camera camera.yaml --marker 36h11:3:165mm …

Takes the arguments of `arfx process` without -o and --job. Processes are forked from this one, so that each starts with
everything imported. By hand: it takes minutes. Exit code 1 where anything differs. (Not on Windows.)
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from arfx.run import analysis
from arfx.run.folder import JobFolder
from arfx_cli.main import main as arfx

PHASES = ("analyse", "render", "join")


def phase(job: JobFolder, chunks: int) -> str:
    """In which the job is; it is "over" where its folder holds nothing that tells. chunks : that it will have"""
    if not job.plan.exists():
        return "analyse"
    if job.report.exists():
        return "over"
    return "render" if sum(p.suffix == ".nut" for p in job.chunks.glob("*")) < chunks else "join"


def start(arguments: list[str], folder: Path, checkpoint_s: float) -> int:
    if pid := os.fork():
        with contextlib.suppress(OSError):  # whoever comes first
            os.setpgid(pid, pid)
        return pid
    code = 99
    try:
        os.setpgid(0, 0)  # worker processes are killed with it
        log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(log, 1)
        os.dup2(log, 2)
        analysis.CHECKPOINT_S = checkpoint_s
        code = arfx(arguments) or 0
    except SystemExit as e:
        code = e.code if isinstance(e.code, int) else 98
    finally:
        os._exit(code)


def digests(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in (folder / "out.mp4", folder / "job" / "facts.jsonl")}


def main() -> int:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("-n", type=int, default=50, help="kills")
    ask.add_argument("--phase", choices=PHASES, default="analyse", help="in which kills come")
    ask.add_argument("--within", type=float, default=1e9, help="seconds, so much at most between the phase's start and the kill")
    ask.add_argument("--seed", type=int, default=0)
    ask.add_argument("--checkpoint", type=float, default=0.2, help="seconds between two of the analysis")
    ask.add_argument("arguments", nargs=argparse.REMAINDER)
    o = ask.parse_args()
    rng, root = random.Random(o.seed), Path(tempfile.mkdtemp(prefix="kill-resume-"))
    given = o.arguments[o.arguments[:1] == ["--"] :]

    def follow(folder: Path, chunks: int, more: list[str], after_s: float | None) -> tuple[str, dict[str, float], int]:
        """(phase at the end, seconds of each, exit code). after_s : killed so long after its phase began"""
        folder.mkdir(exist_ok=True)
        job = JobFolder(folder / "job")
        pid = start([*given, "-o", str(folder / "out.mp4"), "--job", str(job.path), *more], folder, o.checkpoint)
        took, last, now = dict.fromkeys((*PHASES, "over"), 0.0), time.monotonic(), "analyse"
        while not (status := os.waitpid(pid, os.WNOHANG))[0]:
            time.sleep(0.002)
            now, before = phase(job, chunks), last
            last = time.monotonic()
            took[now] += last - before
            if after_s is not None and now == o.phase and took[now] > after_s:
                os.killpg(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                return now, took, -9
        return now, took, os.waitstatus_to_exitcode(status[1])

    whole = root / "whole"
    made = follow(whole, 1 << 30, [], None)
    if made[2]:
        print((whole / "log").read_text())
        return 2
    rows = (whole / "job" / "timings.jsonl").read_text()
    chunks, good = rows.count('"work": "chunk"'), digests(whole)
    took = follow(root / "timed", chunks, [], None)[1]
    print("unkilled:", {p: round(s, 2) for p, s in took.items()}, f"{chunks} chunks", flush=True)
    kills, runs, bad, tries = Counter[str](), 0, int(digests(root / "timed") != good), 0
    while sum(kills.values()) < o.n and tries < 4 * o.n:
        folder, code = root / "killed", -9
        while code == -9:
            tries += 1
            again = ["--resume"] if (folder / "job").exists() else []
            more = rng.uniform(0, min(took[o.phase], o.within)) if sum(kills.values()) < o.n else None
            when, _, code = follow(folder, chunks, again, more)
            if code == -9:
                kills[when] += 1
                print(f"{sum(kills.values())} kills", end="\r", flush=True)
        runs += 1
        if code or digests(folder) != good:
            bad += 1
            print(f"DIFFERS: exit {code}, kept in {root / f'bad{bad}'}", flush=True)
            folder.rename(root / f"bad{bad}")
        shutil.rmtree(folder, ignore_errors=True)
        print(f"{sum(kills.values())} kills {dict(kills)}, {runs} jobs, {bad} differ", flush=True)
    if not bad:
        shutil.rmtree(root)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
