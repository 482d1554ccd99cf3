"""Stop a job by Ctrl-C and SIGTERM at random times, many times: none may be lost, and the exit code says whether the output is
complete. Every stopped job in ten is resumed and has to give the same bytes.

  .venv/bin/python tools/random_signals.py --runs 200 -- process clip.mp4 --camera camera.json --marker 36h11:3:165mm \\
    --model duck.glb --fit 15cm

The arguments behind -- are those of arfx, without -o. POSIX only. Exits 1 if anything was wrong.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

CODES = {signal.SIGINT: {130, -signal.SIGINT}, signal.SIGTERM: {143, -signal.SIGTERM}}  # negative: before arfx had begun


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def left_over(session: int) -> list[str]:
    """Processes of the job that outlive it by two seconds."""
    end = time.monotonic() + 2
    while True:
        alive = []
        for p in psutil.process_iter():
            try:
                if os.getsid(p.pid) == session and p.status() != psutil.STATUS_ZOMBIE:
                    alive.append(f"{p.pid} {p.name()}")
            except (OSError, psutil.Error):
                continue
        if not alive or time.monotonic() > end:
            return alive
        time.sleep(0.05)


def start(arguments: list[str], out: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "arfx_cli", *arguments, "-o", str(out), *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True)


def one(
    arguments: list[str], out: Path, after_s: float, number: signal.Signals, whole: str, resume: bool, at_end: bool
) -> tuple[str, list[str]]:
    """What came of it, in a word, and what was wrong. number : SIGINT goes to all processes, as from a terminal
    after_s : from the start, or, at_end, from where the output is begun to be written"""
    p = start(arguments, out)
    while at_end and p.poll() is None and not (out.exists() or out.with_name(out.name + ".part").exists()):
        time.sleep(0.0005)
    wrong = []
    try:
        _, said = p.communicate(timeout=after_s)
        return "ended before", [] if p.returncode == 0 and digest(out) == whole else [f"exit {p.returncode} unasked: {said}"]
    except subprocess.TimeoutExpired:
        sent = time.time()
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if number == signal.SIGINT else os.kill)(p.pid, number)
    _, said = p.communicate(timeout=120)
    took, code, there = time.time() - sent, p.returncode, out.exists()
    if there and digest(out) != whole:
        wrong.append("another output")
    if code == 0 and not there:
        wrong.append("exit 0 without output")
    if code == 0 and there and out.stat().st_ctime > sent + 0.02:
        wrong.append(f"signal lost: the output appeared {out.stat().st_ctime - sent:.3f} s later")
    if code != 0 and (code not in CODES[number] or there):
        wrong.append(f"exit {code} {'with' if there else 'without'} output")
    if "Traceback" in said and code >= 0:
        wrong.append("traceback")
    wrong += [f"left over: {name}" for name in left_over(p.pid)]
    folder = out.with_name(out.name + ".job")
    if code in (130, 143) and "--resume" in said and not folder.is_dir():
        wrong.append("says --resume, but there is no job folder")
    if took > 5:
        wrong.append(f"took {took:.1f} s to end")
    if resume and code != 0:
        again = start(arguments, out, "--resume")
        _, more = again.communicate(timeout=300)
        if again.returncode or digest(out) != whole:
            wrong.append(f"resumed: exit {again.returncode} {more}")
    return str(code), [f"{w}; after {after_s:.3f} s, {number.name}\n{said}" for w in wrong]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-end", action="store_true", help="every signal while the output is put in place; else one in three")
    parser.add_argument("arguments", nargs="+", help="of arfx")
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it, and what it starts inherits that
    pick, seen, bad = random.Random(given.seed), collections.Counter(), 0
    with tempfile.TemporaryDirectory(prefix="arfx-signals-") as temporary:
        out = Path(temporary) / "out.mp4"
        for _ in range(2):  # the first may compile
            out.unlink(missing_ok=True)
            began = time.monotonic()
            p = start(given.arguments, out)
            _, said = p.communicate()
            if p.returncode:
                sys.exit(f"the job itself fails: {said}")
            whole_s, whole = time.monotonic() - began, digest(out)
        print(f"the whole job takes {whole_s:.2f} s", flush=True)
        for k in range(given.runs):
            shutil.rmtree(temporary, ignore_errors=True)
            Path(temporary).mkdir()
            number = (signal.SIGINT, signal.SIGTERM)[k % 2]
            at_end = given.at_end or k % 3 == 0
            after_s = pick.uniform(0, 0.3) if at_end else pick.uniform(0, 1.05) * whole_s
            came, wrong = one(given.arguments, out, after_s, number, whole, k % 10 == 0, at_end)
            seen[f"{number.name} {'at the end ' if at_end else ''}-> {came}"] += 1
            bad += bool(wrong)
            for text in wrong:
                print(f"run {k}: {text}", flush=True)
            if k % 20 == 19:
                print(f"{k + 1} runs, {bad} wrong", flush=True)
    print(", ".join(f"{what}: {n}" for what, n in sorted(seen.items())))
    print(f"{given.runs} runs, {bad} wrong")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
