"""Sections 2 and 3.1 of Zhao et al. 2012, as printed: blur circle and depth of field of a thin
lens.

All in mm: F, N, D : focal length, f-number, diameter of the lens;  U_A or L : distance in focus,
V_A : of its picture;
U_B : distance of another thing;  C : diameter of its circle on the sensor. The example prints a
    radius, .035, in place of C.
Deviations: where (5) and (6) have a pole or are negative they are None."""

import math

from arfx.core.lens import Lens, Limits, checked


def eq1_circle(V_A: float, U_A: float, U_B: float, D: float) -> float:
    return V_A / U_A * abs(U_B - U_A) / U_B * D


def eq2_picture(f: float, u: float) -> float:
    """v of 1/f = 1/u + 1/v."""
    return 1 / (1 / f - 1 / u)


def eq3_circle(F: float, N: float, U_A: float, U_B: float) -> float:
    """(2) in (1), with D = F/N."""
    return F**2 / (U_A - F) * abs(U_B - U_A) / (N * U_B)


def eq4_front(N: float, C: float, L: float, F: float) -> float:
    return N * C * L * L / (F**2 + N * C * L) if math.isfinite(N * C * L) else L


def eq5_back(N: float, C: float, L: float, F: float) -> float | None:
    return N * C * L * L / (F**2 - N * C * L) if N * C * L < F**2 else None


def eq6_total(N: float, C: float, L: float, F: float) -> float | None:
    """As printed: L in the denominator is not squared."""
    spread = F**4 - N**2 * C**2 * L if N * C * L < F**2 else 0.0
    return 2 * F**2 * N * C * L * L / spread if spread > 0 else None


def hyperfocal(N: float, C: float, F: float) -> float:
    """Where (5) has its pole."""
    return F / N * F / C


def printed_limits(lens: Lens, C: float) -> Limits:
    """(4) to (6), C in mm. Errors as `core.lens.depth_of_field`."""
    checked(lens, C)
    F = lens.focal_mm
    N = lens.fnumber
    L = lens.focus_mm
    return Limits(
        eq4_front(N, C, L, F),
        eq5_back(N, C, L, F),
        eq6_total(N, C, L, F),
        hyperfocal(N, C, F),
        lens.coc_at_infinity_mm,
    )
