"""Runs attacks one after the other, each in a fork of a process that has imported and
compiled everything.

Reads names of cases from standard input, a line each, and answers each with a line of JSON.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any, NoReturn

import psutil

from arfx_cli.__main__ import start
from tests.fuzz import cameras, faults, jobs, kills, models, names, settings, videos
from tests.fuzz.case import Case, process
from tests.fuzz.judge import Ended, judge, snapshot
from tests.fuzz.material import digest, make
from tests.fuzz.trace import Trace

MOST_SECONDS, MOST_BYTES = 60.0, 2 << 30
LONGEST = 600.0  # of the clock, however little the machine gave
BLOCKED = 0.01  # seconds of work in a second: less is waiting for something that does not come
KINDS = {
    "videos": (videos, 17), "models": (models, 20), "cameras": (cameras, 18), "jobs": (jobs, 15), "settings": (settings, 16),
    "names": (names, 5), "faults": (faults, 4), "kills": (kills, 5),
}  # fmt: skip
EVENTS = (
    "os.rename",
    "os.remove",
    "os.mkdir",
    "os.rmdir",
    "os.link",
    "shutil.rmtree",
)


def case_of(name: str, folder: Path, material: Path) -> Case:
    """`videos/one frame`: a named case;  `7:123` or, of one kind alone, `7:123:videos`:
    that number of that seed.
    """
    kind, rng = kind_of(name), random.Random(name)
    seed = name.partition("/")[2]
    case: Case = (KINDS[kind][0].SEEDS[seed] if seed else KINDS[kind][0].any_case)(
        rng, folder, material
    )
    case.kind = kind
    return case


def kind_of(name: str) -> str:
    """Of which kind a case is, by its name."""
    if "/" in name:
        return name.partition("/")[0]
    told = name.partition(":")[2].partition(":")[2]
    return (
        told
        or random.Random(f"kind of {name}").choices(
            list(KINDS), [weight for _, weight in KINDS.values()]
        )[0]
    )


class Worker:
    """place : a folder of its own;  material : what cases are made from"""

    def __init__(self, place: Path, material: Path, keep: bool) -> None:
        self.place, self.material, self.keep = place, material, keep
        self.trace = Trace(place)

    def warm_up(self) -> None:
        """Jobs with each costly effect in this process; then, in a fork, the job that is
        killed later: how long it takes.
        """
        import cv2

        cv2.setNumThreads(1)  # its threads would not be there after a fork
        folder = self.place / "warm-up"
        folder.mkdir()
        with contextlib.chdir(folder):
            for effect in ("dof", "watercolor", "gi"):
                run(
                    [
                        *process(
                            folder, self.material, pipeline=f"lightmap,{effect}"
                        ),
                        "--overwrite",
                        "--quiet",
                    ]
                )
            run(process(folder, self.material, o="small.mp4"))
        known = self.material / "long.json"
        if not known.exists():
            whole = kills.long_job(folder, self.material)
            whole.args += ["--overwrite"]
            whole.count = folder / "events"
            first, second = (
                self.attempt(whole, whole.args),
                self.attempt(whole, whole.args),
            )
            assert first.code == second.code == 0, first.err
            cold = self.attempt(
                Case(folder, [], None, cold=True), ["process", "--help"]
            )
            placed, events = map(int, whole.count.read_text().split())
            facts = {
                "digest": digest(folder / "out.mp4"), "short": digest(folder / "small.mp4"),
                "placed": placed, "events": events,
                "seconds": second.seconds, "cold_seconds": cold.seconds,
            }  # fmt: skip
            known.with_suffix(".new").write_text(json.dumps(facts))
            known.with_suffix(".new").rename(known)
        shutil.rmtree(folder)

    def case(self, name: str) -> dict[str, Any]:
        folder, outside = (
            self.place / "case" / "here",
            self.place / "case" / "outside",
        )
        shutil.rmtree(folder.parent, ignore_errors=True)
        folder.mkdir(parents=True)
        shutil.copytree(self.material / "outside", outside)
        case = case_of(name, folder, self.material)
        before, beside = snapshot(folder), snapshot(outside)
        self.trace.clear()
        ended = []
        if case.beside is not None:
            both = [self.start(case, args) for args in (case.args, case.beside)]
            ended = [self.watch(case, *one) for one in both]
        else:
            ended.append(self.attempt(case, case.args, case.stop))
            if case.stop is not None:
                case.note += f", {phase_of(folder / 'out.mp4')}"
            complete = case.stop and (
                ended[0].code == 0 or (folder / "out.mp4").exists()
            )
            if case.after is not None and not complete and not ended[0].why:
                if case.between is not None:
                    case.between()
                if case.stop_again is not None:
                    ended.append(self.attempt(case, case.after, case.stop_again))
                if not (folder / "out.mp4").exists():
                    ended.append(self.attempt(case, case.after))
        found = judge(case, ended, before, self.trace.read(case))
        if snapshot(outside) != beside or {
            p.name for p in folder.parent.iterdir()
        } > {
            "here",
            "outside",
            "here.job",
        }:
            found.append(("input changed", "in the folder beside"))
        if not self.keep:
            shutil.rmtree(folder.parent, ignore_errors=True)
        return {
            "name": name, "kind": case.kind, "found": found, "codes": [e.code for e in ended],
            "seconds": sum(e.seconds for e in ended), "bytes": max(e.most_bytes for e in ended),
            "note": case.note, "args": case.args, "said": ended[-1].err[-2000:],
        }  # fmt: skip

    def attempt(
        self, case: Case, args: list[str], stop: tuple[int, str, float] | None = None
    ) -> Ended:
        return self.watch(case, *self.start(case, args, stop), stop)

    def start(
        self, case: Case, args: list[str], stop: tuple[int, str, float] | None = None
    ) -> tuple[int, float, list[Any]]:
        """A child that runs the command: its process id, when it began, and its standard
        output and error.
        """
        streams = [tempfile.TemporaryFile(dir=self.place / "tmp") for _ in range(2)]  # noqa: SIM115
        sys.stderr.flush()
        pid = os.fork()
        if pid == 0:
            self._child(case, args, stop, [s.fileno() for s in streams])
        return pid, time.monotonic(), streams

    def _child(
        self,
        case: Case,
        args: list[str],
        stop: tuple[int, str, float] | None,
        streams: list[int],
    ) -> NoReturn:
        try:
            os.setsid()
            os.chdir(case.folder)
            os.dup2(os.open("/dev/null", os.O_RDONLY), 0)
            for source, descriptor in zip(streams, (1, 2), strict=True):
                os.dup2(source, descriptor)
            if case.start is not None:
                case.start()
            if case.cold:
                os.execv(sys.executable, [sys.executable, "-m", "arfx_cli", *args])
            sys.stdin = io.TextIOWrapper(io.FileIO(0, closefd=False))
            sys.stdout = io.TextIOWrapper(
                io.FileIO(1, "w", closefd=False), "utf-8", write_through=True
            )
            sys.argv = ["arfx", *args]
            self.trace.listen()
            count_events(stop, case.count)
            start()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(99)

    def watch(
        self,
        case: Case,
        pid: int,
        started: float,
        streams: list[Any],
        stop: tuple[int, str, float] | None = None,
    ) -> Ended:
        """Wait for a child, send it what is to stop it, and end it where it takes too long
        or too much memory.
        """
        why, most, wait_s, sent, child = "", 0, 0.001, None, psutil.Process(pid)
        while True:
            done, status, usage = os.wait4(pid, os.WNOHANG)
            seconds = time.monotonic() - started
            if done:
                break
            if stop is not None and stop[1] == "time" and seconds >= stop[2]:
                with contextlib.suppress(
                    ProcessLookupError
                ):  # it has no group of its own yet
                    (os.killpg if stop[0] == signal.SIGINT else os.kill)(pid, stop[0])
                    stop, sent = None, time.time()
            with contextlib.suppress(psutil.Error):  # it has just ended
                most = child.memory_info().rss
                if most > MOST_BYTES:
                    why = "memory"
                elif (
                    seconds > MOST_SECONDS
                ):  # of the clock: whether it works, or waits for what does not come
                    worked = [
                        sum(p.cpu_times()[:2])
                        for p in (child, *child.children(recursive=True))
                    ]
                    why = (
                        "hang"
                        if worked[0] > MOST_SECONDS
                        or sum(worked) < BLOCKED * seconds
                        or seconds > LONGEST
                        else ""
                    )
            if why:
                os.kill(pid, signal.SIGKILL)
                _, status, usage = os.wait4(pid, 0)
                break
            time.sleep(wait_s)
            wait_s = min(1.3 * wait_s, 0.03)
        if why or stop is None:
            with contextlib.suppress(
                OSError
            ):  # workers that it started; after a kill they are left to themselves
                os.killpg(pid, signal.SIGKILL)
        texts = []
        for stream in streams:
            stream.seek(0)
            texts.append(stream.read(1 << 20).decode(errors="replace"))
            stream.close()
        most = max(most, usage.ru_maxrss * 1024)
        if not why and most > MOST_BYTES:
            why = "memory"
        return Ended(
            None if why else os.waitstatus_to_exitcode(status),
            seconds,
            most,
            texts[0],
            texts[1],
            why,
            sent,
        )


def phase_of(output: Path) -> str:
    """How far a job got, by what it left."""
    job = output.with_name(f"{output.name}.job")
    left = [
        (output, "placed"),
        (job / "joined.part", "join"),
        (job / "seal.json", "render"),
        (job, "analysis"),
    ]
    return next((phase for path, phase in left if path.exists()), "start")


def run(args: list[str]) -> int:
    from arfx_cli.main import main

    try:
        main(args)
    except SystemExit as e:
        return e.code if isinstance(e.code, int) else int(e.code is not None)
    return 0


def count_events(stop: tuple[int, str, float] | None, count: Path | None) -> None:
    """Count what is done to files in this process, and send it a signal at a stated one.
    count : where the number is written, and, before it, which of them put the output in
    place"""
    seen = placed = 0

    def hook(event: str, args: tuple[Any, ...]) -> None:
        nonlocal seen, placed
        if event in EVENTS or (
            event == "open"
            and isinstance(args[1], str)
            and set(args[1]) & set("wax+")
        ):
            seen += 1
            if event == "os.rename" and Path(os.fsdecode(args[1])).name == "out.mp4":
                placed = seen
            if stop is not None and stop[1] == "event" and seen == stop[2]:
                os.kill(os.getpid(), stop[0])

    sys.addaudithook(hook)
    if count is not None:
        atexit.register(lambda: count.write_text(f"{placed} {seen}"))


def main() -> None:
    work, me, keep = Path(sys.argv[1]), sys.argv[2], sys.argv[3] == "True"
    signal.signal(signal.SIGINT, signal.default_int_handler)
    answers, sys.stdout = sys.stdout, sys.stderr
    material = make(work)
    place = work / me
    shutil.rmtree(place, ignore_errors=True)
    (place / "tmp").mkdir(parents=True)
    os.environ["TMPDIR"] = tempfile.tempdir = str(place / "tmp")
    worker = Worker(place, material, keep)
    worker.warm_up()
    threads = sum(1 for _ in Path("/proc/self/task").iterdir())
    print(
        json.dumps({"threads": threads, "trace": worker.trace.how}),
        file=answers,
        flush=True,
    )
    for line in sys.stdin:
        try:
            answer = worker.case(line.rstrip("\n"))
        except Exception:
            answer = {"name": line.rstrip("\n"), "fault": traceback.format_exc()}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
