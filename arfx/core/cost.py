"""Predicted cost: a price list fitted on a machine, and predictions that carry their interval.

A price is linear in a few terms of the work, with coefficients >= 0, so that more work
never costs less:

frames 1 per run · mpx pixels given, millions · object_mpx those of them in the object's box
· texture_mpx these times the textures of a face, in the mean · mfaces triangles, millions
· lamps lights with a direction · lamp_mpx these times object_mpx · depth_mpx those of mpx in
a frame with measured depth · new_directions, new_lights 1 where the frame's light is not one
that was met before"""

from __future__ import annotations

import contextlib
import math
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from arfx.core.codec import Document
from arfx.core.machine import cache_folder, processor_name, usable_cores

TERMS = (
    "frames",
    "mpx",
    "object_mpx",
    "texture_mpx",
    "mfaces",
    "lamps",
    "lamp_mpx",
    "depth_mpx",
    "new_directions",
    "new_lights",
)
# An interval covers nine in ten where the logarithm of measured / predicted is normal with
# standard deviation `spread`.
_Z_90 = 1.645
UNCALIBRATED = 0.7  # spread of a price from another machine: a factor of 3 either way
FORMAT = 1


class Prediction(NamedTuple):
    """seconds, expected;  low_s, high_s : nine in ten lie between"""

    seconds: float
    low_s: float
    high_s: float

    def to_json(self) -> dict[str, float]:
        return {"s": self.seconds, "low_s": self.low_s, "high_s": self.high_s}

    def times(self, factor: float) -> Prediction:
        return Prediction(*(factor * seconds for seconds in self))


def measured(seconds: float) -> Prediction:
    """What is known because it was measured."""
    return with_spread(seconds, 0)


def with_spread(seconds: float, spread: float) -> Prediction:
    low, high = math.exp(-_Z_90 * spread), math.exp(_Z_90 * spread)
    return Prediction(seconds, seconds * low, seconds * high)


def sum_independent(parts: Iterable[Prediction]) -> Prediction:
    """The sum of predictions whose errors have nothing to do with each other: their widths
    add in quadrature.
    """
    predictions = list(parts)
    total = sum(p.seconds for p in predictions)
    below = math.hypot(*(p.seconds - p.low_s for p in predictions))
    above = math.hypot(*(p.high_s - p.seconds for p in predictions))
    return Prediction(total, max(total - below, 0.0), total + above)


@dataclass(frozen=True)
class Price(Document):
    """coefficients : seconds per unit of each term, >= 0;  spread : of log(measured /
    predicted);  runs : fitted to so many
    """

    coefficients: Mapping[str, float]
    spread: float
    runs: int = 0

    def __post_init__(self) -> None:
        """Raises ValueError for what is no price."""
        if not all(
            t in TERMS and math.isfinite(c) and c >= 0
            for t, c in self.coefficients.items()
        ):
            raise ValueError("a price of unknown terms, or below 0")

    def seconds(self, terms: Mapping[str, float]) -> float:
        return float(sum(c * terms.get(t, 0.0) for t, c in self.coefficients.items()))


@dataclass(frozen=True)
class Prices(Document):
    """The price list. prices : by "stage/level", "prepare stage/level", "edit", "encode
    codec", "join"
    threads : how many worked at once when it was fitted;  source : where it comes from, in words
    calibrated : measured on this machine; what that had no time for has a spread of
    UNCALIBRATED at least
    alone : time of one that works alone, as a fraction of its time among `threads`"""

    prices: Mapping[str, Price]
    threads: int = 1
    source: str = "shipped defaults"
    calibrated: bool = False
    alone: float = 1.0
    format: int = FORMAT

    def __post_init__(self) -> None:
        """Raises ValueError for a list of another format."""
        if self.format != FORMAT or not 0 < self.alone <= 1:
            raise ValueError("price list of another format")

    def predict(self, key: str, terms: Mapping[str, float]) -> Prediction | None:
        """None = not known."""
        if (price := self.prices.get(key)) is None:
            return None
        least = 0 if self.calibrated else UNCALIBRATED
        return with_spread(price.seconds(terms), max(price.spread, least))

    def with_stage(self, stage: str, own: Prices) -> Prices:
        """These, but for one stage, which `own` prices."""
        source = f"{self.source.partition(';')[0]}; {stage} {own.source}"
        return replace(self, prices={**self.prices, **own.prices}, source=source)


def prices_file() -> Path:
    """Where this machine's price list lies: in the user's cache folder, under a name of
    processor and cores.
    """
    name = "".join(
        c if c.isalnum() else "-"
        for c in f"{platform.machine()}-{processor_name()}-{usable_cores()}"
    )
    return cache_folder() / f"costs-{name}.json"


def load_prices(file: Path | None = None) -> Prices:
    """This machine's price list where `arfx bench --calibrate` left one, else the shipped one."""
    with contextlib.suppress(
        OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError
    ):
        return Prices.from_line((file or prices_file()).read_text(encoding="utf-8"))
    return shipped_prices()


def shipped_prices() -> Prices:
    text = Path(__file__).with_name("default_costs.json").read_text(encoding="utf-8")
    return Prices.from_line(text)
