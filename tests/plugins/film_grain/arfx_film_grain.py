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
from typing import Any

import cv2
import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.settings import Fraction, Settings, setting
from arfx.core.stage import Demand, Stage, View


class FilmGrainParams(Settings):
    strength: Fraction = setting(
        0.02, "standard deviation in middle grey, in display values"
    )
    size_px: float = setting(1.6, "diameter of a grain", ge=0.5, le=16)
    monochrome: bool = setting(True, "the same grain in all three channels")


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
        kernel = cv2.getGaussianKernel(
            2 * self.padding_px + 1, p.size_px / 2, cv2.CV_32F
        )
        even = [
            view.noise(c) - np.float32(0.5) for c in range(1 if p.monochrome else 3)
        ]
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
