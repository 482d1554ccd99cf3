"""Settings of the stage watercolor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from arfx.errors import ConfigError, require_within


@dataclass(frozen=True)
class WatercolorParams:
    """formula : corrected, or paper: Jia, Tang 2013 as printed
    cell_px : size of a cell, px of the picture
    nearer_finer : how strongly cells get finer as what they lie on comes nearer (the object; the
        real scene where its depth is measured, else the marker's plane): 0 = all the same size,
        1 = in proportion
    wash : how readily similar neighbours merge into one wash: 0 = single cells, 1 = large washes
    lightness : how far the paint is thinned so that the paper shows: 0 = as in the picture
    deepest : coded value of the darkest wash, so that none is black
    saturation : factor on saturation
    toon : three flat tones on the virtual object
    toon_thresholds : cosines of the angle between normal and light at which the tone changes
    toon_factors : brightness of the three tones, brightest first
    lines : opacity of lines, 0 = none;  ink_rgb : linear colour of lines
    line_width_px : width of lines
    line_low : edge strength below which no line is drawn, coded value per px
    line_high : edge strength from which a line is opaque, coded value per px
    edge_darkening : how much darker pigment gets at the border of a wash
    flow : strength of slow turbulence;  wobble_px : how far borders waver
    grain : strength of the paper's grain, in washes and in lines"""

    formula: str = field(default="corrected", init=False)
    cell_px: float = 7.0
    nearer_finer: float = 0.5
    wash: float = 0.6
    lightness: float = 0.25
    deepest: float = 0.12
    saturation: float = 1.15
    toon: bool = True
    toon_thresholds: tuple[float, float] = (0.5, 0.2)
    toon_factors: tuple[float, float, float] = (1.0, 0.4, 0.1)
    lines: float = 0.6
    ink_rgb: tuple[float, float, float] = (0.03, 0.025, 0.035)
    line_width_px: float = 2.0
    line_low: float = 0.02
    line_high: float = 0.06
    edge_darkening: float = 0.45
    flow: float = 0.22
    wobble_px: float = 1.5
    grain: float = 0.3

    def __post_init__(self) -> None:
        require_within(
            "watercolor",
            self,
            cell_px=(0.5, 4096),
            nearer_finer=(0, 1),
            wash=(0, 1),
            lightness=(0, 2),
            deepest=(0, 0.5),
            saturation=(0, 3),
            lines=(0, 1),
            line_width_px=(0.5, 16),
            line_low=(0, 1),
            line_high=(0, 2),
            edge_darkening=(0, 1),
            flow=(0, 1),
            wobble_px=(0, 8),
            grain=(0, 1),
        )
        if self.line_high < self.line_low:
            raise ConfigError(
                f"watercolor.line_high must not be below line_low ({self.line_low:g}), "
                f"is {self.line_high:g}"
            )
        require_tones("watercolor", self.toon_thresholds, self.toon_factors)
        require_colour("watercolor.ink_rgb", self.ink_rgb)


def require_tones(
    stage: str, thresholds: tuple[float, float], factors: tuple[float, float, float]
) -> None:
    """Raises ConfigError where thresholds do not fall within -1..1, or factors are not 0..1."""
    upper, lower = thresholds
    if not -1 <= lower <= upper <= 1:
        raise ConfigError(
            f"{stage}.toon_thresholds must fall and lie in -1..1, are {upper:g}, {lower:g}"
        )
    require_colour(f"{stage}.toon_factors", factors)


def require_colour(name: str, values: tuple[float, float, float]) -> None:
    """Raises ConfigError where one is not within 0..1."""
    array = np.asarray(values, float)
    if not (np.isfinite(array).all() and (array >= 0).all() and (array <= 1).all()):
        numbers = ", ".join(f"{v:g}" for v in values)
        raise ConfigError(f"{name} must lie in 0..1, are {numbers}")
