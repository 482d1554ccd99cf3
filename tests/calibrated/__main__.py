"""`make calibrated`: is the light's confidence what it says? Random clips, as readings and
through pixels, against their truth.

Writes calibrated/table.md, rows.json and errors.png (error against stated cone). Exit code
1 where a goal is missed. Rows are
kept: a part or a case that is run alone (--only, --case) takes the place of its own.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.calibrated.clips import PIXELS, READINGS, asked, row
from tests.calibrated.scenes import CASES
from tests.calibrated.score import Row, from_json, goals, markdown, plot, to_json

ROOT = Path(__file__).parents[2]
Key = tuple[str, str, int]  # part, case, seed


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.calibrated", description=__doc__
    )
    parser.add_argument("--only", choices=(READINGS, PIXELS))
    parser.add_argument(
        "--case",
        default="",
        help="cases whose name holds this, for example 'two lamps'",
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "calibrated")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    every = [clip for part in (READINGS, PIXELS) for clip in asked(part)]
    wanted = [
        c
        for c in every
        if given.only in (None, c[0]) and given.case in CASES[c[1]].name
    ]
    file = given.output / "rows.json"
    kept: dict[Key, Row] = {}
    if file.is_file():
        kept = {
            (r.part, r.case, r.seed): r
            for r in map(from_json, json.loads(file.read_text(encoding="utf-8")))
        }
    with ProcessPoolExecutor(
        given.jobs, multiprocessing.get_context("spawn")
    ) as pool:
        for r in pool.map(row, wanted):
            kept[r.part, r.case, r.seed] = r
            told = ", ".join(
                f"off {c.off_deg:.2f}° in {c.cone_deg:.2f}°" for c in r.claims
            )
            print(
                f"{r.part}: {r.case} {r.seed}: {r.verdict}; {told or r.reason};"
                f" {r.seconds:.1f} s",
                flush=True,
            )
    rows = [
        kept[key]
        for part, i, seed in every
        if (key := (part, CASES[i].name, seed)) in kept
    ]
    file.write_text(
        json.dumps([to_json(r) for r in rows], indent=1), encoding="utf-8"
    )
    text = markdown(rows)
    (given.output / "table.md").write_text(text, encoding="utf-8")
    (given.output / "errors.png").write_bytes(plot(rows))
    print(f"\n{text}\n{given.output / 'table.md'}")
    return 0 if all(g.holds for g in goals(rows)) else 1


if __name__ == "__main__":
    sys.exit(main())
