"""How far each level of each stage is from its reference, in grey levels: the shipped
table, or what `arfx tradeoff` measured on a clip.

The shipped table is made by tools/measure_errors.py on many clips. Nine in ten of them lie
between `low` and `high` of a level; the upper end is what a plan counts with, so that what
it promises holds on most clips."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arfx.core.opener import parse_json, read_text
from arfx.errors import InputError

UNKNOWN = 255.0  # grey levels: no two pictures differ by more


@dataclass(frozen=True)
class Errors:
    """by_level : stage -> level -> mean grey levels over the pixels that the stage's levels
    differ in or change
    source : where it was measured, in words"""

    by_level: Mapping[str, Mapping[str, float]]
    source: str

    def known(self, stage: str, level: str, best: str) -> float | None:
        """Grey levels, >= 0; 0 for the stage's best level, None where it was not measured."""
        return 0.0 if level == best else self.by_level.get(stage, {}).get(level)

    def of(self, stage: str, level: str, best: str) -> float:
        """The same, UNKNOWN where it was not measured."""
        found = self.known(stage, level, best)
        return UNKNOWN if found is None else found


def shipped_errors() -> Errors:
    """Upper ends of what was found on sample scenes and real clips."""
    return _read(
        Path(__file__).with_name("default_errors.json").read_text(encoding="utf-8")
    )


def errors_of_clip(file: Path) -> Errors:
    """From a tradeoff.json; what that did not measure, from the shipped table. Raises
    InputError.
    """
    text = read_text(file, "tradeoff")
    try:
        own, shipped = _read(text), shipped_errors()
    except (ValueError, KeyError, TypeError, AttributeError) as e:
        raise InputError(
            f"{file} is not a tradeoff.json: {e}",
            "make one: arfx tradeoff CLIP … --report DIR",
        ) from None
    return Errors({**shipped.by_level, **own.by_level}, own.source)


def _read(text: str) -> Errors:
    document = parse_json(text)
    found: dict[str, dict[str, float]] = {}
    for stage, levels in document["errors"].items():
        for level, value in levels.items():
            if value is not None:
                found.setdefault(stage, {})[level] = _upper_end(
                    value, f"{stage} {level}"
                )
    return Errors(found, str(document["source"]))


def _upper_end(value: float | Mapping[str, Any], of: str) -> float:
    """value : of one clip, or {low, mean, high} of many"""
    upper = value["high"] if isinstance(value, Mapping) else value
    if not (math.isfinite(upper) and upper >= 0):
        raise ValueError(f"error of {of} is {upper}")
    return float(upper)
