"""What Figure 12 of Zhao et al. 2012 holds against their own method in Figure 13: a Gaussian
filter, which does not ask how
bright the neighbours are. All else, depth, blend and border, is the same (s2_dof.py), so that the
figures differ by (8) alone.

Not stated is its size: it has the standard deviation of the mean filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from arfx.papers.s2_dof import PrintedDof, PrintedDofParams, mean_filter


@dataclass(frozen=True)
class GaussianDofParams(PrintedDofParams):
    """mean_px : side of the mean filter that has the Gaussian's standard deviation, odd"""

    formula: str = field(default="gaussian", init=False)


class GaussianDof(PrintedDof):
    Params = GaussianDofParams

    @property
    def weights(self) -> np.ndarray:
        variance = (self.params.mean_px**2 - 1) / 12  # of n even weights, px^2
        x = np.arange(-(reach := math.ceil(3 * math.sqrt(variance))), reach + 1)
        return np.exp(-(x**2) / (2 * max(variance, 1e-9))).astype(np.float32)

    def blurred(self, colour: np.ndarray, dioptre: np.ndarray) -> np.ndarray:
        return mean_filter(colour, dioptre, self.weights)
