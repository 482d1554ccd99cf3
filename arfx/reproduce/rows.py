"""What a paper's module yields: rows of the table, figures and plots."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.measure.difference import level_difference

HOLDS = "holds"
DIFFERS = "differs, explained"
UNDERIVED = "cannot be derived"
VERDICTS = (HOLDS, DIFFERS, UNDERIVED)
BEFORE, PRINTED, CORRECTED, REFERENCE = (
    "before",
    "printed",
    "corrected",
    "reference",
)  # names of a figure's pictures

Value = float | str | None


@dataclass(frozen=True)
class Row:
    """One thing that a paper states, beside what the program gives. The values are numbers,
    or words where there is no number.

    item : where it is printed, unique in its paper: "equation (4)", "table 1, teapot, frame
    rate"
    printed : as the paper has it;  paper_formula : by the printed method here;  corrected :
    by the corrected method,
    None = the corrected method has no such thing
    verdict : HOLDS where all three agree; DIFFERS where one does not, or where the paper
    leaves open what had to be chosen;
    UNDERIVED where something is printed that nothing in the paper leads to
    reason : why, for all but HOLDS

    Raises ValueError where these do not fit together."""

    item: str
    printed: Value
    paper_formula: Value
    corrected: Value
    reason: str = ""
    unit: str = ""
    verdict: str = DIFFERS

    def __post_init__(self) -> None:
        if self.verdict != HOLDS and not self.reason.strip():
            raise ValueError(
                f"{self.item}: the verdict {self.verdict!r} has no reason"
            )
        for value in (self.printed, self.paper_formula, self.corrected):
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(
                    f"{self.item}: {value} is not finite; say it in words"
                )


def half_digit(printed: str) -> float:
    """Half a unit of the last digit of a number as it is printed: "58.7" -> 0.05"""
    return 0.5 * 10.0 ** int(Decimal(printed).as_tuple().exponent)


def row(
    item: str,
    printed: Value,
    values: Any,
    unit: str = "",
    reason: str = "",
    holds: Any = None,
    tolerance: float | None = None,
    below: float | None = None,
) -> Row:
    """A row whose verdict follows from its values.

    values : by the printed and by the corrected method, or by the printed one alone; where
    that is None, UNDERIVED
    reason : why, for all but HOLDS; else it is left out
    holds : whether what is printed was found; None = where the values agree with it: words
    that are the same, or, for a number as it stands there, "58.7", what rounds to its digits
    tolerance : in place of half its last digit;  below : it was found where all values are
    """
    pair = values if np.ndim(values) else (values, None)
    of_paper, corrected = (
        v.item() if isinstance(v, (np.generic, ndarray)) else v for v in pair
    )
    known: list[Any] = [value for value in (of_paper, corrected) if value is not None]
    if below is not None:
        holds = max(known) < below
    if holds is None and isinstance(printed, str):
        number = as_number(printed)
        if number is None:
            holds = all(value == printed for value in known)
        else:
            within = half_digit(printed) if tolerance is None else tolerance
            holds = all(
                isinstance(value, (int, float))
                and abs(value - number) <= within * (1 + 1e-9)
                for value in known
            )
            printed = number
    verdict = UNDERIVED if of_paper is None else HOLDS if holds else DIFFERS
    reason = "" if verdict == HOLDS else reason
    return Row(item, printed, of_paper, corrected, reason, unit, verdict)


def as_number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


class Figure(NamedTuple):
    """Pictures of a figure of a paper, side by side.

    item : of the row that speaks of it;  title : what is seen
    pictures : by name, in order, (h, w, 3) uint8 sRGB, or coded values 0..1, also (h, w).
    BEFORE, PRINTED, CORRECTED and REFERENCE where there are such; any other
    name is its caption. PRINTED and CORRECTED get maps of their difference from REFERENCE,
    without one CORRECTED gets that from PRINTED; those three are of one size"""

    item: str
    title: str
    pictures: Mapping[str, ndarray]


class Plot(NamedTuple):
    """A plot in place of a table or curve.

    item : of a row that speaks of it;  figure : of matplotlib
    """

    item: str
    title: str
    figure: Any


def errors(made: Mapping[str, ndarray], before: ndarray, least: float) -> list[float]:
    """Mean grey levels of the PRINTED and the CORRECTED picture from REFERENCE, where any of them
    changes the frame by more than `least`."""
    on = np.max([level_difference(own, before) for own in made.values()], 0) > least
    return [
        float(level_difference(made[REFERENCE], made[name])[on].mean())
        for name in (PRINTED, CORRECTED)
    ]


def eight_bit(coded: ndarray) -> ndarray:
    """(h, w, 3) uint8 of coded values 0..1, of one channel or three; of uint8 as they are."""
    if coded.dtype == np.uint8:
        return coded
    out = np.round(255 * np.clip(coded, 0, 1)).astype(np.uint8)
    return out if out.ndim == 3 else np.dstack([out] * 3)


Item = Row | Figure | Plot
Items = Iterator[Item]
