"""`make hard`: every hard scene, every stated hard case, every sweep and every clip towards
a singularity; one table, two plots.

Writes hard/table.md, hard/sweeps.png and hard/clips.png. Exit code 1 where something does
not hold. The table grows row by row, and a part that is run alone (--only) keeps the rows
of the others."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from tests.hard import clips
from tests.hard.cases import CASES
from tests.hard.closed_forms import CLOSED_FORMS
from tests.hard.estimates import ESTIMATES
from tests.hard.pixels import PIXELS
from tests.hard.scenes import Row, scene_row
from tests.hard.sweeps import ANSWER, REFUSAL, Result, plot, run

ROOT = Path(__file__).parents[2]
PARTS = ("scenes", "cases", "sweeps", "clips")


def case_rows(jobs: int) -> list[Row]:
    """All stated cases in one run of pytest, in so many processes."""
    nodes = [node for case in CASES for node in case.tests]
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "junit.xml"
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"--junitxml={told}",
        ]
        shared = ["-n", str(jobs), "--dist", "worksteal"] if jobs > 1 else []
        subprocess.run(
            [*command, *shared, *nodes],
            cwd=ROOT,
            check=False,
            stdout=subprocess.DEVNULL,
        )
        cases = list(ElementTree.parse(told).iter("testcase"))
    rows = []
    for case in CASES:
        names = {node.split("::")[1] for node in case.tests}
        mine = [c for c in cases if c.attrib["name"].split("[")[0] in names]
        faults = [
            fault for c in mine for fault in (*c.iter("failure"), *c.iter("error"))
        ]
        for fault in faults:
            print(fault.text)
        skipped = [c for c in mine if c.find("skipped") is not None]
        verdict = (
            "holds"
            if mine and not faults
            else f"{len(faults)} of {len(mine)} fail"
            if mine
            else "no test ran"
        )
        if skipped:
            verdict += f", {len(skipped)} skipped"
        seconds = sum(float(c.attrib["time"]) for c in mine)
        rows.append((case.name, case.asked, verdict, f"{len(mine)} checks", seconds))
    return rows


def sweep_rows(results: list[Result], seconds: float) -> list[Row]:
    rows = []
    for r in results:
        (answers, answered), (refusals, refused) = r.count(ANSWER), r.count(REFUSAL)
        verdict = (
            "holds" if not r.wrong else f"{len(r.wrong)} WRONG: {'; '.join(r.wrong)}"
        )
        verdict += (
            ", as printed: told, not limited"
            if r.formula in r.sweep.unbounded
            else ""
        )
        either = len(r.points) - answers - refusals
        worst = "none" if r.worst is None else f"{r.worst:.1e} {r.sweep.unit}"
        told = (
            f"answers owed {answers}, given {answered}; refusals owed {refusals}, given"
            f" {refused}; either {either}; wrong {len(r.wrong)}; largest error {worst}"
        )
        name = f"{r.sweep.name}, {r.formula}, {r.kind}"
        rows.append(
            (
                name,
                f"towards {r.sweep.towards}",
                verdict,
                told,
                seconds / len(results),
            )
        )
    return rows


def clip_row(found: clips.Found, seconds: float) -> Row:
    shown = found.opacity > 0
    told = (
        f"{found.held:.0%} of {int(shown.sum())} poses within their 95 %; at most"
        f" {np.nanmax(found.error_deg[shown]):.2g} deg,"
        f" {np.nanmax(found.error_px[shown]):.2g} px; readable in {int(found.owed.sum())}"
        " frames"
    )
    return (
        found.clip.name,
        "pose within what it says, no flips, fades",
        "; ".join(found.wrong) or "holds",
        told,
        seconds,
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=ROOT / "hard",
        help="folder for the table and the plots",
    )
    parser.add_argument("--only", choices=PARTS, help="one part of it")
    parser.add_argument(
        "--jobs",
        type=int,
        default=min(os.cpu_count() or 1, 4),
        help="processes at once",
    )
    parser.add_argument("--scenes", help="of the scenes only these: 0901,0904")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    table = Table(given.output)
    if given.only in (None, "scenes"):
        wanted = tuple(given.scenes.split(",")) if given.scenes else ("",)
        scenes = [
            s
            for s in sorted((ROOT / "sample_scenes").glob("09*"))
            if s.name.startswith(wanted)
        ]
        with ProcessPoolExecutor(
            given.jobs, multiprocessing.get_context("spawn")
        ) as pool:
            for row in pool.map(scene_row, scenes):
                table.add("scenes", [row])
    if given.only in (None, "cases"):
        table.add("cases", case_rows(given.jobs))
    if given.only in (None, "sweeps"):
        results = []
        for sweep in (*CLOSED_FORMS, *ESTIMATES, *PIXELS):
            start = time.perf_counter()
            found = run(sweep)
            table.add("sweeps", sweep_rows(found, time.perf_counter() - start))
            results += found
        (given.output / "sweeps.png").write_bytes(plot(results))
    if given.only in (None, "clips"):
        analysed = []
        for clip in clips.CLIPS:
            start = time.perf_counter()
            analysed.append(clips.analyse(clip))
            table.add("clips", [clip_row(analysed[-1], time.perf_counter() - start)])
        (given.output / "clips.png").write_bytes(clips.plot(analysed))
    rows = table.rows()
    bad = [r for r in rows if not r[2].startswith("holds")]
    print(f"{len(rows) - len(bad)} of {len(rows)} hold; {given.output / 'table.md'}")
    return 1 if bad else 0


class Table:
    """Rows by part, kept in `folder` as rows.json, and as table.md for people.

    A row takes the place of one of the same case.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept, self._parts = folder / "rows.json", {}
        if self._kept.is_file():
            self._parts = json.loads(self._kept.read_text(encoding="utf-8"))

    def rows(self) -> list[Row]:
        return [
            tuple(row) for part in PARTS for row in self._parts.get(part, {}).values()
        ]

    def add(self, part: str, rows: list[Row]) -> None:
        for row in rows:
            print(f"{row[0]}: {row[2]}; {row[3]}; {row[4]:.1f} s", flush=True)
            self._parts.setdefault(part, {})[f"{row[0]}, {row[1]}"] = row
        self._kept.write_text(json.dumps(self._parts), encoding="utf-8")
        head = ("case", "asked", "verdict", "largest deviation", "seconds")
        lines = [f"| {' | '.join(head)} |", "|---|---|---|---|---|"]
        lines += [
            f"| {r[0]} | {r[1]} | {r[2]} | {r[3]} | {r[4]:.1f} |" for r in self.rows()
        ]
        (self._folder / "table.md").write_text(
            "\n".join(lines) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    sys.exit(main())
