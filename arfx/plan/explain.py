"""The plan of a clip in words and numbers: what runs how often, on how much of the picture,
and why not elsewhere.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

from arfx.core.numerics import divide
from arfx.core.plan import FramePlan
from arfx.plan.levels import sum_correlated

_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])")


def summarise(
    plans: Iterable[FramePlan], names: Iterable[str], frame_area: int
) -> list[dict[str, Any]]:
    """One row per stage, in the fields of report.json's `stages`, without the measured time.

    area_fraction : mean over the frames in which the stage runs of its output area / picture area
    reasons : why it was left out, by text, with the number of frames; equal but for numbers
    = one text with ranges
    """
    every, rows = list(plans), []
    for name in names:
        steps = [s for plan in every for s in plan.steps if s.stage == name]
        reasons = [
            s.reason for plan in every for s in plan.skipped if s.stage == name
        ]
        costs = [s.cost for s in steps if s.cost is not None]
        cost = sum_correlated(costs) if len(costs) == len(steps) else None
        out = sum(s.out.area for s in steps)
        rows.append(
            {
                "name": name,
                "levels": dict(Counter(s.level for s in steps)),
                "frames_run": len(steps),
                "frames_skipped": len(reasons),
                "area_fraction": float(divide(out, frame_area * len(steps))),
                "predicted_s": None if cost is None else cost.seconds,
                "predicted_between_s": None if cost is None else list(cost[1:]),
                "reasons": group_reasons(reasons),
            }
        )
    return rows


def group_reasons(reasons: Iterable[str]) -> dict[str, int]:
    """Count reasons, folding those that differ only in their numbers: 'circle 0.2…0.6 px'.
    Most frequent first.
    """
    groups: dict[str, list[str]] = defaultdict(list)
    for reason in reasons:
        groups[_NUMBER.sub("#", reason)].append(reason)
    out = {}
    for same in sorted(groups.values(), key=len, reverse=True):
        ranges = map(_range, zip(*(_NUMBER.findall(r) for r in same), strict=True))
        out[_NUMBER.sub(lambda _, it=ranges: next(it), same[0])] = len(same)  # type: ignore[misc]
    return out


def _range(texts: Sequence[str]) -> str:
    low, high = min(texts, key=float), max(texts, key=float)
    return low if float(low) == float(high) else f"{low}…{high}"


def without_price(stages: Sequence[str]) -> tuple[str, str]:
    """In words: what is not known, and the command that measures it."""
    one = len(stages) == 1
    command = "arfx bench --calibrate" + (f" --stage {stages[0]}" if one else "")
    return (
        f"{', '.join(stages)} {'has' if one else 'have'} no price here",
        f"`{command}` measures it",
    )
