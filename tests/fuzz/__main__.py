"""`make fuzz`: hostile videos, models, cameras, job files, settings, names and faults, by
the thousand.

Named cases, each an attack that once broke something, run first, then as many random ones
as are asked for. Case N of seed S is the same on every machine and in every order: `--case
S:N`, or `--case "videos/one frame"`, runs it again and shows all it said. Exit code 1 where
anything is found."""

from __future__ import annotations

import argparse
import collections
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from tests.fuzz.judge import signature
from tests.fuzz.trace import ROOT, strace
from tests.fuzz.worker import KINDS, kind_of

PATIENCE_S = 1500.0  # for one answer: longer than the longest case


class Hands:
    """One worker process, started again where it dies."""

    def __init__(self, work: Path, name: str, keep: bool, traced: bool) -> None:
        self._work, self._name, self._keep, self._traced = work, name, keep, traced
        self.begin()

    def begin(self) -> None:
        log = self._work / f"{self._name}.strace"
        log.unlink(missing_ok=True)
        command = [
            *(strace(log) if self._traced else ()),
            sys.executable,
            "-m",
            "tests.fuzz.worker",
            str(self._work),
            self._name,
            str(self._keep),
        ]
        pipe = subprocess.PIPE
        # threads that numpy, or a pool of ours, started before a fork are not there after it
        environment = {
            **os.environ,
            "OPENBLAS_NUM_THREADS": "1",
            "NUMBA_NUM_THREADS": "1",
            "ARFX_DEBUG": "",
        }
        with log.with_suffix(".log").open("w") as told:
            self.process = subprocess.Popen(
                command, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=told, text=True, env=environment, start_new_session=True
            )  # fmt: skip
        self.told = self._answer()

    def ask(self, case: str) -> dict[str, Any]:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{case}\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        timer = threading.Timer(PATIENCE_S, self.process.kill)
        timer.start()
        line = self.process.stdout.readline()
        timer.cancel()
        if not line:
            raise RuntimeError(f"the worker ended with {self.process.wait()}")
        answer: dict[str, Any] = json.loads(line)
        return (
            _fault(answer["name"], answer["fault"]) if "fault" in answer else answer
        )

    def end(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def main() -> int:
    given = arguments()
    cases: queue.SimpleQueue[str] = queue.SimpleQueue()
    kinds = given.only.split(",") if given.only else list(KINDS)
    named = given.case or [
        f"{kind}/{seed}"
        for kind in kinds
        if not given.no_named
        for seed in KINDS[kind][0].SEEDS
    ]
    for name in named:
        cases.put(name)
    count = len(named) if given.case else max(given.cases, len(named))
    for number in range(count - len(named)):
        cases.put(
            f"{given.seed}:{number}"
            + (f":{kinds[number % len(kinds)]}" if given.only else "")
        )
    work = Path(given.work or tempfile.mkdtemp(prefix="arfx-fuzz-"))
    work.mkdir(exist_ok=True)
    work.chmod(0o755)  # some cases run as a user who may do little
    answers: list[dict[str, Any]] = []
    until = None
    print(
        f"{len(named)} named cases, then random ones of seed {given.seed}; in {work}",
        flush=True,
    )

    def work_off(name: str) -> None:
        nonlocal until
        hands: dict[bool, Hands] = {}
        while until is None or time.monotonic() < until:
            try:
                case = cases.get_nowait()
            except queue.Empty:
                break
            traced = (
                kind_of(case) != "kills"
            )  # strace may hold a process that was killed, and its workers, for minutes
            try:
                if traced not in hands:
                    hands[traced] = Hands(
                        work,
                        f"{name}{'' if traced else 'k'}",
                        given.keep or bool(given.case),
                        traced,
                    )
                    told = hands[traced].told["trace"]
                    print(
                        (
                            f"opened files are told by: {told}"
                            if traced
                            else "kills are not traced"
                        ),
                        flush=True,
                    )
                if until is None:
                    until = (
                        time.monotonic() + given.seconds
                        if given.seconds
                        else float("inf")
                    )
                answer = hands[traced].ask(case)
            except (RuntimeError, OSError) as e:
                answer = _fault(case, str(e))
                if hands.pop(traced, None) is None:  # it never began
                    answers.append(answer)
                    break
            answers.append(answer)
            show(answer, len(answers), bool(given.case))
            if given.log:
                with given.log.open("a") as f:
                    f.write(json.dumps(answer) + "\n")
        for one in hands.values():
            one.end()

    threads = [
        threading.Thread(target=work_off, args=(f"w{i}",))
        for i in range(min(given.jobs, count))
    ]
    for thread in threads:
        thread.start()
        time.sleep(0.5)
    for thread in threads:
        thread.join()
    found = report(answers)
    if not (given.keep or given.case):
        shutil.rmtree(work, ignore_errors=True)
    return 1 if found or not answers else 0


def arguments() -> argparse.Namespace:
    kept = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=kept
    )
    parser.add_argument(
        "--cases",
        type=int,
        default=0,
        help="so many, the named ones among them; default those alone",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        help="stop after so long, from when everything is compiled",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help=f"kinds: {','.join(KINDS)}")
    parser.add_argument("--no-named", action="store_true", help="random cases alone")
    parser.add_argument(
        "--case",
        action="append",
        help="this one, with all it said; its folder is kept",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=min(os.cpu_count() or 1, 4),
        help="processes at once",
    )
    parser.add_argument(
        "--work", help="folder for what is made; default a temporary one"
    )
    parser.add_argument(
        "--keep",
        action="store_true",
        help="leave the folder of the last case of each process",
    )
    parser.add_argument(
        "--log", type=Path, help="append a line of JSON for each case"
    )
    given = parser.parse_args()
    if given.seconds and not given.cases:
        given.cases = 10_000
    return given


def _fault(case: str, words: str) -> dict[str, Any]:
    return {
        "name": case,
        "kind": "harness",
        "codes": [],
        "seconds": 0.0,
        "bytes": 0,
        "found": [["harness", words]],
        "note": "",
    }


def show(answer: dict[str, Any], number: int, everything: bool) -> None:
    for kind, words in answer["found"]:
        print(
            f"{answer['name']}: {kind}: {words[:300]}  [{answer['note'][:120]}]",
            flush=True,
        )
    if everything:
        print(
            json.dumps({**answer, "said": None}, indent=1),
            answer.get("said", ""),
            sep="\n",
            flush=True,
        )
    elif number % 200 == 0:
        print(f"{number} cases", flush=True)


def report(answers: list[dict[str, Any]]) -> int:
    """A line for each kind of case, then one for each distinct finding.

    Returns how many cases found something.
    """
    print(
        "\nkind         cases  found   exit 0      2      3      4  other   slowest s "
        " most MB"
    )
    for kind in sorted({a["kind"] for a in answers}):
        mine = [a for a in answers if a["kind"] == kind]
        last = collections.Counter(
            a["codes"][-1] if a["codes"] else None for a in mine
        )
        shown = (
            "".join(f"{last[c]:7}" for c in (0, 2, 3, 4))
            + f"{sum(n for c, n in last.items() if c not in (0, 2, 3, 4)):7}"
        )
        found = sum(bool(a["found"]) for a in mine)
        slowest, most = (
            max(a["seconds"] for a in mine),
            max(a["bytes"] for a in mine) >> 20,
        )
        print(f"{kind:12}{len(mine):6}{found:7}  {shown}{slowest:12.1f}{most:9}")
    distinct: dict[str, list[str]] = {}
    for a in answers:
        for found in a["found"]:
            distinct.setdefault(f"{a['kind']}: {signature(found)}", []).append(
                a["name"]
            )
    for words, names in sorted(distinct.items(), key=lambda item: -len(item[1])):
        print(
            f"{len(names):5} x {words}\n        again: python -m tests.fuzz --case"
            f" {names[0]!r}"
        )
    bad = sum(bool(a["found"]) for a in answers)
    print(f"{len(answers)} cases, {bad} found something, {len(distinct)} distinct")
    return bad


if __name__ == "__main__":
    sys.exit(main())
