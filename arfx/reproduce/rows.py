"""Rows of a paper's table: what it states, beside what the program gives.

What it states is in NAME.toml beside its module. The file's [[stated]] are groups of items that
share all but what is printed:

printed : words, or a number with its digits, "58.7", or two, "9–13";  unit;  title : of pictures
reason : why it was not found;  tolerance : in place of half the last printed digit
below : it was found where all values are

These texts name in braces what a module gives with its values."""

import tomllib
from collections.abc import Callable, Iterator, Mapping
from decimal import Decimal
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
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
Pictures = Mapping[str, ndarray]
NONE: Pictures = MappingProxyType({})


class Row(NamedTuple):
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
    pictures : of the item, side by side, under a title: by name, in order, (h, w, 3) uint8 sRGB,
    or coded values 0..1, also (h, w). BEFORE, PRINTED, CORRECTED and REFERENCE where there are
    such; any other name is its caption. PRINTED and CORRECTED get maps of their difference from
    REFERENCE, without one CORRECTED gets that from PRINTED; those three are of one size"""

    item: str
    printed: Value
    paper_formula: Value
    corrected: Value
    unit: str
    verdict: str
    reason: str
    title: str
    pictures: Pictures


Items = Iterator[Row]


@cache
def statements(paper: str) -> Mapping[str, Mapping[str, Any]]:
    """What is stated of each item, as in the paper's file."""
    file = Path(__file__).with_name(f"{paper}.toml")
    groups = tomllib.loads(file.read_text(encoding="utf-8"))["stated"]
    return {
        item: {**group, "printed": printed}
        for group in groups
        for item, printed in group["printed"].items()
    }


def rows_of(paper: str) -> Callable[..., Row]:
    """`row` of a paper's items."""
    return partial(row, statements(paper))


def row(
    stated: Mapping[str, Mapping[str, Any]],
    item: str,
    values: Any,
    holds: Any = None,
    pictures: Pictures = NONE,
    **words: Any,
) -> Row:
    """A row whose verdict follows from its values.

    values : by the printed and by the corrected method, or by the printed one alone; where
    that is None, UNDERIVED
    holds : whether what is printed was found; None = where the values agree with it
    words : that the item's texts name
    """
    pair = values if np.ndim(values) else (values, None)
    of_paper, corrected = (
        v.item() if isinstance(v, (np.generic, ndarray)) else v for v in pair
    )
    known = [value for value in (of_paper, corrected) if value is not None]
    own: dict[str, Any] = {
        name: text.format(**words) if isinstance(text, str) else text
        for name, text in stated[item].items()
    }
    printed = own["printed"]
    if holds is None and "below" in own:
        holds = max(known) < own["below"]
    elif holds is None:
        between = range_of(printed, own.get("tolerance"))
        if between is None:
            holds = all(value == printed for value in known)
        else:
            low, high = between
            holds = all(
                isinstance(value, (int, float)) and low <= value <= high
                for value in known
            )
            printed = printed if "–" in printed else float(printed)
    verdict = UNDERIVED if of_paper is None else HOLDS if holds else DIFFERS
    return Row(
        item,
        printed,
        of_paper,
        corrected,
        own.get("unit", ""),
        verdict,
        "" if verdict == HOLDS else own.get("reason", ""),
        own.get("title", ""),
        pictures,
    )


def range_of(
    printed: str, tolerance: float | None = None
) -> tuple[float, float] | None:
    """What rounds to the digits of a number, "58.7", or lies between two, "9–13"; None for
    words. tolerance : in place of half the last digit
    """
    try:
        low, high = (float(end) for end in (printed.split("–") * 2)[:2])
    except ValueError:
        return None
    if low < high:
        return low, high
    half_digit = 0.5 * 10.0 ** int(Decimal(printed).as_tuple().exponent)
    within = (tolerance or half_digit) * (1 + 1e-9)
    return low - within, high + within


def errors(made: Pictures, before: ndarray, least: float) -> list[float]:
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
