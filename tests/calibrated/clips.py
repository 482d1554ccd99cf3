"""One clip to its row. A module, so that processes can run it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from arfx.analyse.job import Analysis
from arfx.analyse.params import LightParams
from tests.calibrated import pixels, readings
from tests.calibrated.scenes import CASES, Clip, drawn
from tests.calibrated.score import REFUSED, Row, claims_of

READINGS, PIXELS = "readings", "pixels"
FIRST_WHOLE = 1000  # seeds of whole clips


def asked(part: str) -> list[tuple[str, int, int]]:
    """(part, number of the case, seed) of every clip."""
    if part == READINGS:
        return [
            (part, i, seed)
            for i, case in enumerate(CASES)
            for seed in range(case.clips)
        ]
    return [
        (part, i, FIRST_WHOLE + k)
        for i, case in enumerate(CASES)
        for k in range(case.whole)
    ]


def row(clip: tuple[str, int, int]) -> Row:
    part, number, seed = clip
    start = time.process_time()
    if part == READINGS:
        truth = drawn(CASES[number], seed)
        return measured(part, truth, partial(readings.lit, truth), start)
    truth = drawn(CASES[number], seed, pixels.FRAMES)
    with tempfile.TemporaryDirectory() as folder:
        return measured(
            part, truth, pixels.Filmed(truth, Path(folder) / "clip").lit, start
        )


def measured(
    part: str, truth: Clip, lit: Callable[[LightParams], Analysis], start: float = 0.0
) -> Row:
    """What is claimed of a clip.

    lit : its analysis;  start : processor time at which work on it began
    """
    found, case = lit(LightParams()), truth.case
    report, alone = found.summary["light"], None
    if report["verdict"] == REFUSED and case.lamps == 1:
        one = claims_of(truth, lit(LightParams(most_lights=1)))
        alone = max(one, key=lambda c: c.frames).error_deg if one else None
    return Row(
        part, case.name, truth.seed, case.lamps, case.owed, case.never, report["verdict"], report["reason"],
        tuple(claims_of(truth, found)), alone, time.process_time() - start,
    )  # fmt: skip
