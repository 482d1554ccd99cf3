"""Settings of the stage watercolor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from arfx.core.colour import LUMA_COEFFICIENTS
from arfx.errors import ConfigError, require_within


@dataclass(frozen=True)
class WatercolorParams:
    """formula : corrected, or paper: Jia, Tang 2013 as printed
    cell_px : size of a cell, px of the picture
    nearer_finer : how strongly cells get finer as what they lie on comes nearer (the object; the real scene where its depth is
    measured, else the marker's plane): 0 = all the same size, 1 = in proportion
    detail : how strongly cells shrink where the picture has detail, and grow where it has none
    anchored : cells move with the things under them; false = they stay fixed on the screen
    two_patterns : paint the pattern of cells that is carried forward through the clip and the one that is carried back, and fade
    from one to the other, so that neither bends much: twice the time, softer borders
    wash : how readily similar neighbours merge into one wash: 0 = single cells, 1 = large washes
    lightness : how far the paint is thinned so that the paper shows: 0 = as in the picture;  saturation : factor on saturation
    deepest : coded value of the darkest wash, so that none is black
    toon : three flat tones on the virtual object
    toon_thresholds : cosines of the angle between normal and light at which the tone changes
    toon_factors : brightness of the three tones, brightest first
    lines : opacity of lines, 0 = none;  ink_rgb : linear colour of lines;  line_width_px : width of lines
    line_smooth_px : how much the picture is smoothed before edges are detected
    line_low : edge strength below which no line is drawn, coded value per px
    line_high : edge strength from which a line is opaque, coded value per px
    alpha : weight of U and V in the edges of YUV;  beta : weight of YUV in all edges
    line_hold : blend in the edges of the frame before, moved with the things under them: a third to a half fewer pixels of lines
    flicker, for about a fifth more time (not in a draft)
    yuv : matrix of Y'UV: bt601, bt709
    pigment : simulate pigment and paper with the settings below; false = flat cells
    edge_darkening : how much darker pigment gets at the border of a wash;  flow : strength of slow turbulence
    flow_px : size of the turbulence;  wobble_px : how far borders waver;  grain : strength of the paper's grain
    grain_px : size of the grain;  dry_brush : how much the grain shows in lines"""

    formula: str = field(default="corrected", init=False)
    cell_px: float = 7.0
    nearer_finer: float = 0.5
    detail: float = 1.0
    anchored: bool = True
    two_patterns: bool = False
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
    line_smooth_px: float = 3.0
    line_low: float = 0.02
    line_high: float = 0.06
    line_hold: bool = False
    alpha: float = 0.5
    beta: float = 0.5
    yuv: str = "bt601"
    pigment: bool = True
    edge_darkening: float = 0.45
    flow: float = 0.22
    flow_px: float = 160.0
    wobble_px: float = 1.5
    grain: float = 0.3
    grain_px: float = 2.0
    dry_brush: float = 0.7

    def __post_init__(self) -> None:
        require_within(
            "watercolor",
            self,
            cell_px=(0.5, 4096),
            nearer_finer=(0, 1),
            detail=(0, 1),
            wash=(0, 1),
            lightness=(0, 2),
            deepest=(0, 0.5),
            saturation=(0, 3),
            lines=(0, 1),
            line_width_px=(0.5, 16),
            line_low=(0, 1),
            line_high=(0, 2),
            line_smooth_px=(0, 10),
            alpha=(0, 1),
            beta=(0, 1),
            edge_darkening=(0, 1),
            wobble_px=(0, 8),
            flow=(0, 1),
            flow_px=(8, 4096),
            grain=(0, 1),
            grain_px=(1, 32),
            dry_brush=(0, 2),
        )
        if self.yuv not in LUMA_COEFFICIENTS:
            raise ConfigError(
                f"watercolor.yuv {self.yuv!r} is unknown", "one of " + ", ".join(LUMA_COEFFICIENTS)
            )
        if self.line_high < self.line_low:
            raise ConfigError(
                f"watercolor.line_high must not be below line_low ({self.line_low:g}), is {self.line_high:g}"
            )
        upper, lower = self.toon_thresholds
        if not -1 <= lower <= upper <= 1:
            raise ConfigError(
                f"watercolor.toon_thresholds must fall and lie in -1..1, are {upper:g}, {lower:g}"
            )
        for name in ("toon_factors", "ink_rgb"):
            values = np.asarray(getattr(self, name), float)
            if not (np.isfinite(values).all() and (values >= 0).all() and (values <= 1).all()):
                raise ConfigError(
                    f"watercolor.{name} must lie in 0..1, are {', '.join(f'{v:g}' for v in values)}"
                )
