"""A thin lens: blur circle, depth of field and hyperfocal distance, as Zhao et al. 2012 print them and as they should be.

Distances run along the optical axis from the lens. In dioptres (1 / distance) the blur circle is affine: there is no
pole at infinity and none at the hyperfocal distance. Source: docs/methods/dof.md#lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from arfx.core.numerics import divide
from arfx.errors import InputError

PAPER, CORRECTED = "paper", "corrected"
# A surface nearer to the lens than this share of the focal length is treated as if it stood there: the blur circle of
# Equation 3 grows without bound as the distance goes to 0. At the bound it is about 100 apertures wide.
NEAREST_SHARE = 1e-2


@dataclass(frozen=True, slots=True)
class Lens:
    """focal_mm, fnumber > 0;  focus_mm : distance that is sharp, > focal_mm, inf allowed.

    Raises InputError otherwise. fnumber = inf is a pinhole: no blur anywhere.
    """

    focal_mm: float
    fnumber: float
    focus_mm: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.focal_mm) and self.focal_mm > 0):
            raise InputError(f"focal length must be above 0 mm, is {self.focal_mm:g} mm")
        if not self.fnumber > 0:
            raise InputError(f"f-number must be above 0, is {self.fnumber:g}", "for example 2.8")
        if not self.focus_mm > self.focal_mm:
            raise InputError(
                f"a lens of {self.focal_mm:g} mm cannot be focused at {self.focus_mm:g} mm",
                "the focus distance must be beyond the focal length",
            )

    @property
    def coc_at_infinity_mm(self) -> float:
        """Diameter of the blur circle of something infinitely far: F^2 / (N (U - F))."""
        return self.focal_mm / self.fnumber * self.focal_mm / (self.focus_mm - self.focal_mm)

    @property
    def coc_mm_per_dioptre(self) -> float:
        """Growth of the blur circle's diameter, mm, with |1/U - 1/L| in 1/mm: F^2 U / (N (U - F))."""
        share = 1.0 if math.isinf(self.focus_mm) else self.focus_mm / (self.focus_mm - self.focal_mm)
        return self.focal_mm / self.fnumber * self.focal_mm * share


def circle_of_confusion_mm(distance_mm: np.ndarray | float, lens: Lens) -> np.ndarray:
    """Diameter of the blur circle of a thin lens, on the sensor.

    distance_mm : (...) float, > 0; inf allowed
    Returns (...) float64 mm, >= 0, finite for every input: nearer than NEAREST_SHARE of the focal length counts as
    there; a NaN or a distance <= 0 gives 0 (no surface).
    Source: docs/methods/dof.md#lens.
    """
    d = np.asarray(distance_mm, float)
    known = d > 0
    dioptre = 1.0 / np.maximum(np.where(known, d, 1.0), NEAREST_SHARE * lens.focal_mm)
    return np.where(known, lens.coc_mm_per_dioptre * np.abs(1.0 / lens.focus_mm - dioptre), 0.0)


@dataclass(frozen=True, slots=True)
class Limits:
    """What looks sharp before and behind the focus distance, mm; None = not defined (`paper` at its pole and beyond)."""

    front_mm: float | None
    back_mm: float | None
    total_mm: float | None
    hyperfocal_mm: float
    coc_at_infinity_mm: float


def depth_of_field(lens: Lens, coc_mm: float, formula: str = CORRECTED) -> Limits:
    """Depth of field around the focus distance for the largest blur circle `coc_mm`, a diameter, that passes as sharp.

    corrected : near and far limits where the blur circle is exactly coc_mm; back and total are inf from the hyperfocal
        distance on
    paper : equations 4 to 6 as printed (docs/methods/dof.md#errata), with the object's distance in place of distance less focal
    length; back and total are None where they have a pole or are negative

    Raises InputError unless coc_mm is above 0 and finite, and the focus distance is finite.
    """
    if not (math.isfinite(coc_mm) and coc_mm > 0):
        raise InputError(f"the circle of confusion must be above 0 mm, is {coc_mm:g} mm")
    if math.isinf(lens.focus_mm):
        raise InputError("depth of field needs a finite focus distance")
    return _printed(lens, coc_mm) if formula == PAPER else _corrected(lens, coc_mm)


def hyperfocal_mm(focal_mm: float, fnumber: float, coc_mm: float, formula: str = CORRECTED) -> float:
    """Nearest focus distance at which infinity still passes as sharp: F^2 / (N c), and + F as it should be."""
    return focal_mm / fnumber * focal_mm / coc_mm + (focal_mm if formula == CORRECTED else 0.0)


def _corrected(lens: Lens, coc_mm: float) -> Limits:
    u = lens.focus_mm
    far = hyperfocal_mm(lens.focal_mm, lens.fnumber, coc_mm)
    # share = N c (U - F) / F^2: 1 at the hyperfocal distance. The limits stand at dioptres (1 + share) / U, (1 - share) / U
    share = float(divide(coc_mm, lens.coc_at_infinity_mm, where_zero=math.inf))
    front = u * (1.0 if math.isinf(share) else share / (1.0 + share))
    back = u * share / (1.0 - share) if share < 1.0 else math.inf
    return Limits(front, back, front + back, far, lens.coc_at_infinity_mm)


def _printed(lens: Lens, coc_mm: float) -> Limits:
    f2, length = lens.focal_mm**2, lens.focus_mm
    k = lens.fnumber * coc_mm * length
    front = k * length / (f2 + k) if math.isfinite(k) else length
    back = total = None
    if k < f2:
        back = k * length / (f2 - k)
        spread = f2**2 - lens.fnumber**2 * coc_mm**2 * length  # (6) as printed: the last factor is not squared
        total = 2.0 * f2 * k * length / spread if spread > 0 else None
    return Limits(front, back, total, hyperfocal_mm(lens.focal_mm, lens.fnumber, coc_mm, PAPER), lens.coc_at_infinity_mm)
