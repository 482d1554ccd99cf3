"""Film grain on the whole picture, real and virtual alike: new in every frame, strongest in
the middle tones.

A film whose grains are many and small against a pixel looks like Gaussian noise, blurred to
the size of a grain, with a variance that is zero where no grain or every grain is exposed:
the limit of a Boolean model of grains (Newson, Delon, Galerne 2017, "A stochastic film
grain model for resolution-independent rendering"). Cost: O(pixels x size). Leaves out:
grains of three dyes with sizes of their own, grain larger than a few pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, View
from arfx.errors import ConfigError


@dataclass(frozen=True)
class FilmGrainParams:
    """strength : standard deviation in middle grey, in display values, 0..1
    size_px : diameter of a grain, 0.5..16
    monochrome : the same grain in all three channels
    """

    strength: float = 0.02
    size_px: float = 1.6
    monochrome: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.strength <= 1:
            raise ConfigError(
                f"film_grain.strength must be between 0 and 1, is {self.strength:g}"
            )
        if not 0.5 <= self.size_px <= 16:
            raise ConfigError(
                f"film_grain.size_px must be between 0.5 and 16, is {self.size_px:g}"
            )


class FilmGrain(Stage):
    name = "film_grain"
    Params = FilmGrainParams
    without_object = True

    def __init__(self, params: FilmGrainParams | None = None) -> None:
        super().__init__(params)
        self.padding_px = math.ceil(
            2 * self.params.size_px
        )  # four standard deviations of the blur

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        return Demand(frame, "grain lies on the whole picture")

    def run(self, view: View, prepared: Any) -> Mapping[Layer, np.ndarray]:
        p, image = self.params, view[Layer.IMAGE]
        kernel = cv2.getGaussianKernel(2 * self.padding_px + 1, p.size_px / 2, cv2.CV_32F)
        even = [view.noise(c) - np.float32(0.5) for c in range(1 if p.monochrome else 3)]
        blurred = np.stack(
            [cv2.sepFilter2D(n, cv2.CV_32F, kernel, kernel) for n in even], -1
        )
        # even noise has a variance of 1/12, of which the blur along both axes leaves (sum
        # of squares)^2: this has one of 1
        grain = blurred * np.float32(math.sqrt(12) / float((kernel**2).sum()))
        # in display values, as a root: the share of the film that is exposed. 2 sqrt(s (1 -
        # s)) is 1 in the middle
        shown = np.sqrt(np.clip(image, 0, 1))
        change = np.float32(2 * p.strength) * np.sqrt(shown * (1 - shown)) * grain
        return {Layer.IMAGE: image + np.clip(shown + change, 0, 1) ** 2 - shown**2}
