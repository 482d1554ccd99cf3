"""A thin lens: blur circle, depth of field and hyperfocal distance; limits as printed:
papers/s2_lens.py.

Distances run along the optical axis from the lens. In dioptres (1 / distance) the blur
circle is affine: there is no pole at infinity and none at the hyperfocal distance. Source:
docs/methods/dof.md#lens."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.codec import Document, Unbounded
from arfx.core.numerics import divide
from arfx.errors import InputError

# A surface nearer to the lens than this fraction of the focal length is treated as if it
# were there: the blur circle of Equation 3 grows without bound as the distance goes to 0.
# At the bound it is about 100 apertures wide.
NEAREST_SHARE = 1e-2


@dataclass(frozen=True, slots=True)
class Lens:
    """focal_mm, fnumber > 0;  focus_mm : distance that is sharp, > focal_mm, inf allowed.
    Raises InputError otherwise. fnumber = inf is a pinhole: no blur anywhere."""

    focal_mm: float
    fnumber: float
    focus_mm: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.focal_mm) and self.focal_mm > 0):
            raise InputError(
                f"focal length must be above 0 mm, is {self.focal_mm:g} mm"
            )
        if not self.fnumber > 0:
            raise InputError(
                f"f-number must be above 0, is {self.fnumber:g}", "for example 2.8"
            )
        if not self.focus_mm > self.focal_mm:
            hint = "the focus distance must be beyond the focal length"
            raise InputError(
                f"a lens of {self.focal_mm:g} mm cannot be focused at {self.focus_mm:g} mm",
                hint,
            )

    @property
    def coc_at_infinity_mm(self) -> float:
        """Diameter of the blur circle of something infinitely far: F^2 / (N (U - F))."""
        return (
            self.focal_mm
            / self.fnumber
            * self.focal_mm
            / (self.focus_mm - self.focal_mm)
        )

    @property
    def coc_mm_per_dioptre(self) -> float:
        """Growth of the blur circle's diameter, mm, with |1/U - 1/L| in 1/mm: F^2 U / (N (U
        - F)).
        """
        ratio = (
            1.0
            if math.isinf(self.focus_mm)
            else self.focus_mm / (self.focus_mm - self.focal_mm)
        )
        return self.focal_mm / self.fnumber * self.focal_mm * ratio


def circle_of_confusion_mm(distance_mm: ndarray | float, lens: Lens) -> ndarray:
    """Diameter of the blur circle of a thin lens, on the sensor.
    distance_mm : (...) > 0, inf allowed; a NaN or a distance <= 0 gives 0 (no surface).
    Finite for every input.
    """
    d = np.asarray(distance_mm, float)
    known = d > 0
    dioptre = 1.0 / np.maximum(np.where(known, d, 1.0), NEAREST_SHARE * lens.focal_mm)
    return np.where(
        known, lens.coc_mm_per_dioptre * np.abs(1.0 / lens.focus_mm - dioptre), 0.0
    )


class Limits(NamedTuple):
    """What looks sharp before and behind the focus distance, mm; None = not defined (as
    printed, at a pole and beyond).
    """

    front_mm: float | None
    back_mm: float | None
    total_mm: float | None
    hyperfocal_mm: float
    coc_at_infinity_mm: float


def checked(lens: Lens, coc_mm: float) -> None:
    """Raises InputError unless coc_mm is above 0 and finite, and the focus distance is finite."""
    if not (math.isfinite(coc_mm) and coc_mm > 0):
        raise InputError(
            f"the circle of confusion must be above 0 mm, is {coc_mm:g} mm"
        )
    if math.isinf(lens.focus_mm):
        raise InputError("depth of field needs a finite focus distance")


def depth_of_field(lens: Lens, coc_mm: float) -> Limits:
    """Depth of field around the focus distance for the largest blur circle `coc_mm`, a
    diameter, that passes as sharp: its limits stand where the blur circle is exactly that.
    Back and total are inf from the hyperfocal distance on. Raises InputError as
    `checked`."""
    checked(lens, coc_mm)
    u = lens.focus_mm
    far = hyperfocal_mm(lens.focal_mm, lens.fnumber, coc_mm)
    # ratio = N c (U - F) / F^2: 1 at the hyperfocal distance. The limits are at dioptres (1
    # + ratio) / U, (1 - ratio) / U
    ratio = float(divide(coc_mm, lens.coc_at_infinity_mm, where_zero=math.inf))
    front = u * (1.0 if math.isinf(ratio) else ratio / (1.0 + ratio))
    back = u * ratio / (1.0 - ratio) if ratio < 1.0 else math.inf
    return Limits(front, back, front + back, far, lens.coc_at_infinity_mm)


def hyperfocal_mm(focal_mm: float, fnumber: float, coc_mm: float) -> float:
    """Nearest focus distance at which infinity still passes as sharp: F^2 / (N c) + F."""
    return focal_mm / fnumber * focal_mm / coc_mm + focal_mm


@dataclass(frozen=True, slots=True)
class LensFit(Document):
    """What the footage tells of the lens that it was filmed with.
    known : whether the footage determines it;  reason : why not, or how well
    px_per_dioptre : radius of the blur circle by the distance from the focus, 1/m;  focus :
    dioptre, 1/m
    sharp_px : standard deviation of an edge in the focus
    focus_ci95, px_per_dioptre_ci95 : half widths of the 95 % intervals"""

    known: bool
    reason: str
    px_per_dioptre: float = 0.0
    focus: float = 0.0
    sharp_px: float = 0.0
    px_per_dioptre_ci95: Unbounded = float("inf")
    focus_ci95: Unbounded = float("inf")
