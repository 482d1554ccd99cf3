"""The plan of a clip in words and numbers: what runs how often, on how much of the picture, and why not elsewhere."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

from arfx.core.plan import FramePlan

_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])")


def summarise(plans: Iterable[FramePlan], names: Sequence[str], frame_area: int) -> list[dict[str, Any]]:
    """One row per stage, in the fields of report.json's `stages` (CLI.md), without the measured time.

    area_fraction : mean over the frames in which the stage runs of its output area / picture area
    reasons : why it was left out, by text, with the number of frames; equal but for numbers = one text with ranges
    """
    runs: dict[str, list[Any]] = defaultdict(list)
    skips: dict[str, list[str]] = defaultdict(list)
    for plan in plans:
        for step in plan.steps:
            runs[step.stage].append(step)
        for skip in plan.skipped:
            skips[skip.stage].append(skip.reason)
    rows = []
    for name in names:
        steps = runs[name]
        levels: dict[str, int] = defaultdict(int)
        for step in steps:
            levels[step.level] += 1
        seconds = [s.seconds for s in steps]
        rows.append(
            {
                "name": name,
                "levels": dict(levels),
                "frames_run": len(steps),
                "frames_skipped": len(skips[name]),
                "area_fraction": sum(s.out.area for s in steps) / (frame_area * len(steps)) if steps else 0.0,
                "predicted_s": None if any(s is None for s in seconds) else float(sum(seconds)),
                "reasons": group_reasons(skips[name]),
            }
        )
    return rows


def group_reasons(reasons: Iterable[str]) -> dict[str, int]:
    """Count reasons, folding those that differ only in their numbers: 'circle 0.2…0.6 px'. Most frequent first."""
    groups: dict[str, list[str]] = defaultdict(list)
    for reason in reasons:
        groups[_NUMBER.sub("#", reason)].append(reason)
    out = {}
    for same in sorted(groups.values(), key=len, reverse=True):
        columns = list(zip(*(_NUMBER.findall(r) for r in same), strict=True))
        ranges = iter([_range(c) for c in columns])
        out[_NUMBER.sub(lambda _, it=ranges: next(it), same[0])] = len(same)  # type: ignore[misc]
    return out


def _range(texts: Sequence[str]) -> str:
    low, high = min(texts, key=float), max(texts, key=float)
    return low if float(low) == float(high) else f"{low}…{high}"


def table(rows: Sequence[dict[str, Any]], frames: int) -> Any:
    """The same rows as a rich table."""
    from rich.table import Table

    out = Table(title=f"plan of {frames} frames", title_justify="left")
    for column, justify in (("stage", "left"), ("runs", "right"), ("level", "left"), ("area", "right"), ("predicted", "right")):
        out.add_column(column, justify=justify)  # type: ignore[arg-type]
    out.add_column("left out, and why", overflow="fold")
    for row in rows:
        why = "\n".join(f"{n} × {text}" for text, n in row["reasons"].items())
        predicted = "unknown" if row["predicted_s"] is None else f"{row['predicted_s']:.2f} s"
        out.add_row(row["name"], str(row["frames_run"]), ", ".join(row["levels"]), f"{row['area_fraction']:.1%}", predicted, why)
    return out
