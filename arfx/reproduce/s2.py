"""Rows of Zhao et al. 2012, depth of field from luminance and depth: equations and numbers
in the order of print.
"""

import math

import numpy as np
from matplotlib.figure import Figure
from numpy import ndarray

from arfx.core.lens import Lens, circle_of_confusion_mm, depth_of_field
from arfx.measure.plots import INK, styled
from arfx.measure.pose_plot import RAW, SMOOTH
from arfx.papers.s2_dof import (
    blur_factor,
    eq7_circle,
    eq8_bleed,
    eq9_blend,
    sharp_range,
    within_depth_of_field,
)
from arfx.papers.s2_lens import (
    eq1_circle,
    eq2_picture,
    eq3_circle,
    eq4_front,
    eq6_total,
    hyperfocal,
    printed_limits,
)
from arfx.reproduce import s2_figures
from arfx.reproduce.rows import Items, Plot, Row, row
from arfx.reproduce.work import Work
from arfx.stages.dof.optics import CircleOfConfusion

N, C, F, L = 11.0, 0.035, 200.0, 2500.0  # of the paper's example, mm
LENS = Lens(F, N, L)
OTHER = 5000.0
AT = CircleOfConfusion(1e-3 * LENS.coc_mm_per_dioptre, 1e3 / L, math.inf, 1.0)
L_LESS_F = "(4) and (5) have L where (3) implies L - F"


def rows(work: Work) -> Items:
    yield from _circle()
    yield from _limits()
    yield from _example()
    yield from _blur_factor()
    yield from _luminance()
    yield from _blocks()
    yield from _blend()
    yield from s2_figures.rows(work)
    yield from s2_figures.rates(work)


def _circle() -> Items:
    """(1) to (3), (7)."""
    true = float(circle_of_confusion_mm(OTHER, LENS))
    infinite = LENS.coc_at_infinity_mm
    picture = eq2_picture(F, L)
    first = eq1_circle(picture, L, OTHER, F / N)
    third = eq3_circle(F, N, L, OTHER)
    seventh = float(eq7_circle(1e3 / OTHER, AT))
    yield _same("equation (1)", "C = V_A/U_A |U_B - U_A|/U_B D", first, true)
    # C of infinity is D v / u
    yield _same("equation (2)", "1/f = 1/u + 1/v", picture, infinite * L / (F / N))
    yield _same("equation (3)", "C = F²/(U_A - F) |U_B - U_A|/(N U_B)", third, true)
    yield _same("equation (7)", "C = F²/(U - F) |L - U|/(N L)", seventh, true)


def _same(item: str, printed: str, value: float, other: float) -> Row:
    """Two lengths, mm."""
    same = math.isclose(value, other, rel_tol=1e-9)
    return row(item, printed, (value, other), "mm", "another length", same)


def _sharp_mm() -> ndarray:
    """(2, 2) what is sharp before the focus, as printed and corrected, and behind it."""
    both = printed_limits(LENS, C), depth_of_field(LENS, C)
    return np.array([(limits.front_mm, limits.back_mm) for limits in both], float).T


def _limits() -> Items:
    """(4) to (6): the circle where they lie."""
    fronts, backs = _sharp_mm()
    for name, places in (("(4)", L - fronts), ("(5)", L + backs)):
        yield row(
            f"equation {name}, circle (3) at this limit",
            f"{C}",
            circle_of_confusion_mm(places, LENS),
            "mm",
            L_LESS_F,
            tolerance=1e-9,
        )
    limits = depth_of_field(LENS, C)
    parts, true_parts = fronts + backs
    yield row(
        "equation (6)",
        "ΔL1 + ΔL2",
        (eq6_total(N, C, L, F), limits.total_mm),
        "mm",
        "L in the denominator is not squared, the dimensions do not match; the sum of (4)"
        f" and (5) is {parts:.4f}, and by (3) {true_parts:.4f}",
    )
    yield row(
        "equation (5), hyperfocal distance",
        "F²/(N C)",
        (hyperfocal(N, C, F), limits.hyperfocal_mm),
        "mm",
        f"{L_LESS_F}; (5) has its pole there",
    )


def _example() -> Items:
    """Section 3.1."""
    fronts, backs = _sharp_mm()
    of = "section 3.1, "
    for name, value, used, unit in (
        ("f-number", "11", N, ""),
        ("focal length", "200", F, "mm"),
        ("distance", "2.5", L / 1e3, "m"),
    ):
        yield row(f"{of}{name}", value, (used, used), unit)
    as_radius = eq4_front(N, 2 * C, L, F)
    yield row(
        f"{of}permitted circle",
        "radius .035 mm",
        ("diameter .035 mm", "diameter .035 mm"),
        "",
        "the formulas take a diameter, and with .035 as such they give the printed 58.7"
        f" mm; as a radius {as_radius:.1f} mm",
    )
    for name, value, found, unit in (
        ("front depth of field (4)", "58.7", fronts, "mm"),
        ("back depth of field (5)", "61.6", backs, "mm"),
        ("sharp from", "2.4413", (L - fronts) / 1e3, "m"),
        ("sharp to", "2.5616", (L + backs) / 1e3, "m"),
    ):
        yield row(of + name, value, found, unit, L_LESS_F)
    yield row(
        f"{of}depth of field of the composited scene",
        "126.746",
        None,
        "mm",
        f"follows from none of the formulas: (4) + (5) is {fronts[0] + backs[0]:.3f} mm,"
        f" (6) {eq6_total(N, C, L, F):.3f} mm; it"
        " is said to come from the camera's matrix, which is not stated",
    )
    distance = np.linspace(2350, 2680, 400)
    circle = np.array([eq3_circle(F, N, L, d) for d in distance])
    apart = np.abs(circle - circle_of_confusion_mm(distance, LENS)).max()
    yield row(
        "figure 3",
        "circle of a point beside the focus",
        (f"circles of 0 to {circle.max():.3f} mm", f"{apart:.0e} mm apart from them"),
        "",
        "",
        apart < 1e-9,
    )
    yield _plot(distance, circle, np.transpose([L - fronts, L + backs]))


@styled
def _plot(distance: ndarray, circle: ndarray, limits: ndarray) -> Plot:
    """Of figure 3. limits : of what is sharp, as printed and corrected, mm"""
    figure = Figure((7.6, 3.2))
    axis = figure.subplots()
    axis.plot(distance, circle, label="circle (3)", color=RAW)
    axis.axhline(C, label="permitted", color=INK)
    for sharp, colour in zip(limits, (RAW, SMOOTH), strict=True):
        for limit_mm in sharp:
            axis.axvline(limit_mm, color=colour, ls=":")
    axis.set(
        xlabel="distance, mm; dotted: limits by (4) and (5), and corrected",
        ylabel="mm",
        ylim=0,
    )
    axis.legend()
    title = "circle of confusion and depth of field: N = 11, F = 200 mm, L = 2500 mm"
    return Plot("figure 3", title, figure)


def _blur_factor() -> Items:
    """Section 3.2, and what of it is wrong."""
    words = "dioptres, 0 to 1 / z_near"
    why = "1 / z has no largest distance: what is infinitely far has a place"
    yield row("section 3.2, depth = z / z_far", "0 to 1", (words, words), "", why)
    infinite = blur_factor(np.array([0.0]), (0.0, 20.0), AT)[0]
    yield row(
        "section 3.2, a of infinity, near plane at 50 mm",
        "c / max(c_near, c_far)",
        (infinite, f"{LENS.coc_at_infinity_mm / C:.0f} × the permitted circle"),
        "",
        "C_near of a plane at 50 mm is so large that all else seems sharp: a depends on"
        " planes that nobody sees",
    )


def _luminance() -> Items:
    """(8), with figure 7."""
    around = np.array([[100, 120, 90], [180, 100, 100], [60, 100, 140]], np.float32)
    flat = np.ones((3, 3), np.float32)

    def middle(grey: ndarray) -> np.float32:
        """Of 3 x 3 pixels."""
        bled: np.float32 = eq8_bleed(np.dstack([grey] * 3), flat)[1, 1, 0]
        return bled

    # a little more in one pixel alone: that in the middle is no neighbour of its own
    more = 100 + np.eye(9, dtype=np.float32).reshape(9, 3, 3)
    yield row(
        "figure 7, neighbours that count",
        "8",
        sum(middle(only) > 100.5 for only in np.delete(more, 4, 0)),
    )
    result = middle(around)
    brighter = around[around > 100]
    expected = float(np.average(brighter, weights=brighter - 100))
    yield row(
        "equation (8), 100 among 100, 120, 90, 180, 100, 60, 100, 140",
        "weights 20/140, 80/140, 40/140",
        result,
        "",
        "",
        math.isclose(result, expected, rel_tol=1e-5),
    )


def _blocks() -> Items:
    """Figure 8: numbers of a CUDA block, and whether the printed filters fit into it."""
    (rows_px, columns_px), (tall, wide), size = (8, 16), (16, 24), 4
    threads = rows_px * columns_px
    with_border = tall * wide
    parts = {
        "colour": ("4608", with_border * 3 * size),
        "circle": ("1536", with_border * size),
        "luminance": ("1536", with_border * size),
        "result": ("1536", threads * 3 * size),
        "intermediate": ("512", threads * size),
    }
    shared = sum(value for _, value in parts.values())
    blocks = (800 // rows_px) * (800 // columns_px)
    for name, printed, value, unit in (
        *((f"bytes of {name}", *values, "bytes") for name, values in parts.items()),
        ("shared memory", "9728", shared, "bytes"),
        ("blocks of 800 x 800", "5000", blocks, ""),
        ("threads of a block", "128", threads, ""),
    ):
        why = "of their graphics program"
        yield row(f"figure 8, {name}", printed, value, unit, why)


def _blend() -> Items:
    """(9), the factor 2/3 and its border."""
    over = np.full((1, 1, 3), 80.0)
    under = np.full((1, 1, 3), 40.0)
    yield row(
        "equation (9), 80 over 40 with α = 1/4",
        "50",
        eq9_blend(np.array([[0.25]]), over, under)[0, 0, 0],
    )
    sharp = sharp_range(AT, F, C)
    inside, outside = within_depth_of_field(AT.focus + np.array([0, 0.1]), sharp, 0.5)
    yield row(
        "section 3.4, factor inside the depth of field",
        "2/3",
        inside,
        "",
        "",
        abs(inside - 2 / 3) < 1e-9,
    )
    yield row("section 3.4, factor outside", "1", outside)
