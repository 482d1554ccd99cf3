"""`make looks`: does the light hold on a telephone's clips? Each against its truth.

Writes looks/table.md. Exit code 1 where a gate is missed."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.looks.gates import LOOKS, Finding, cones, findings

ROOT = Path(__file__).parents[2]


def table(rows: Sequence[Finding]) -> str:
    lines = ["| clip | what | found | at most | |", "|---|---|---|---|---|"]
    for r in rows:
        verdict = "holds" if r.holds else "**missed**"
        lines.append(
            f"| {r.look} | {r.gate} | {r.value:.3g} | {r.most:.3g} | {verdict} |"
        )
    missed = sum(not r.holds for r in rows)
    return "\n".join([*lines, "", f"{len(rows) - missed} of {len(rows)} hold", ""])


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.looks", description=__doc__
    )
    parser.add_argument("--clip", default="", help="clips whose name holds this")
    parser.add_argument(
        "--cones", type=int, default=4, help="clips of each case of lamps"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "looks")
    given = parser.parse_args()
    start = time.monotonic()
    wanted = [(look, of) for look, of in LOOKS if given.clip in look.name]
    with ProcessPoolExecutor(
        given.jobs, multiprocessing.get_context("spawn")
    ) as pool:
        rows = [
            r
            for found in pool.map(findings, *zip(*wanted, strict=True))
            for r in found
        ]
        if given.cones and not given.clip:
            rows.append(pool.submit(cones, given.cones).result())
    given.output.mkdir(parents=True, exist_ok=True)
    text = table(rows)
    (given.output / "table.md").write_text(text, encoding="utf-8")
    print(f"{text}\n{given.output / 'table.md'}, {time.monotonic() - start:.0f} s")
    return 0 if all(r.holds for r in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
