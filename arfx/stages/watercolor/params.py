"""Settings of the stage watercolor."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from arfx.core.settings import Fraction, Settings, setting
from arfx.errors import ConfigError

Cosine = Annotated[float, Field(ge=-1, le=1)]


def _falling(thresholds: tuple[float, float]) -> tuple[float, float]:
    upper, lower = thresholds
    if upper < lower:
        raise ConfigError(f"must fall, are {upper:g}, {lower:g}")
    return thresholds


Thresholds = Annotated[tuple[Cosine, Cosine], AfterValidator(_falling)]
Factors = tuple[Fraction, Fraction, Fraction]


class ToonSettings(Settings):
    """Settings that both formulas have."""

    formula: str = setting(
        "corrected", "corrected, or paper: Jia, Tang 2013 as printed"
    )
    cell_px: float = setting(
        7.0, "size of a cell, px of the picture", ge=0.5, le=4096
    )
    toon: bool = setting(True, "three flat tones on the virtual object")
    toon_thresholds: Thresholds = setting(
        (0.5, 0.2),
        "cosines of the angle between normal and light at which the tone changes",
    )
    toon_factors: Factors = setting(
        (1.0, 0.4, 0.1), "brightness of the three tones, brightest first"
    )


class WatercolorParams(ToonSettings):
    nearer_finer: Fraction = setting(
        0.5,
        "how strongly cells get finer as what they lie on comes nearer (the object; the real"
        " scene where its depth is measured, else the marker's plane): 0 = all the same size,"
        " 1 = in proportion",
    )
    wash: Fraction = setting(
        0.6,
        "how readily similar neighbours merge into one wash: 0 = single cells, 1 = large"
        " washes",
    )
    lightness: float = setting(
        0.25,
        "how far the paint is thinned so that the paper shows: 0 = as in the picture",
        ge=0,
        le=2,
    )
    deepest: float = setting(
        0.12, "coded value of the darkest wash, so that none is black", ge=0, le=0.5
    )
    saturation: float = setting(1.15, "factor on saturation", ge=0, le=3)
    lines: Fraction = setting(0.6, "opacity of lines, 0 = none")
    ink_rgb: Factors = setting((0.03, 0.025, 0.035), "linear colour of lines")
    line_width_px: float = setting(2.0, "width of lines", ge=0.5, le=16)
    line_low: Fraction = setting(
        0.02, "edge strength below which no line is drawn, coded value per px"
    )
    line_high: float = setting(
        0.06,
        "edge strength from which a line is opaque, coded value per px",
        ge=0,
        le=2,
    )
    edge_darkening: Fraction = setting(
        0.45, "how much darker pigment gets at the border of a wash"
    )
    flow: Fraction = setting(0.22, "strength of slow turbulence")
    wobble_px: float = setting(1.5, "how far borders waver", ge=0, le=8)
    grain: Fraction = setting(
        0.3, "strength of the paper's grain, in washes and in lines"
    )

    @model_validator(mode="after")
    def _lines(self) -> WatercolorParams:
        if self.line_high < self.line_low:
            raise ConfigError(
                f"watercolor.line_high must not be below line_low ({self.line_low:g}), is"
                f" {self.line_high:g}"
            )
        return self
