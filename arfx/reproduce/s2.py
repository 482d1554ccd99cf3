"""Rows of Zhao et al. 2012, depth of field from luminance and depth: equations and numbers
in the order of print.
"""

import math

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
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
from arfx.reproduce.rows import Items, rows_of
from arfx.reproduce.work import Work
from arfx.stages.dof.optics import CircleOfConfusion

row = rows_of("s2")

N, C, F, L = 11.0, 0.035, 200.0, 2500.0  # of the paper's example, mm
LENS = Lens(F, N, L)
OTHER = 5000.0
AT = CircleOfConfusion(1e-3 * LENS.coc_mm_per_dioptre, 1e3 / L, math.inf, 1.0)


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
    # C of infinity is D v / u
    for item, value, other in (
        ("equation (1)", first, true),
        ("equation (2)", picture, infinite * L / (F / N)),
        ("equation (3)", third, true),
        ("equation (7)", seventh, true),
    ):
        yield row(item, (value, other), math.isclose(value, other, rel_tol=1e-9))


def _sharp_mm() -> ndarray:
    """(2, 2) what is sharp before the focus, as printed and corrected, and behind it."""
    both = printed_limits(LENS, C), depth_of_field(LENS, C)
    return np.array([(limits.front_mm, limits.back_mm) for limits in both], float).T


def _limits() -> Items:
    """(4) to (6): the circle where they lie."""
    fronts, backs = _sharp_mm()
    for name, places in (("(4)", L - fronts), ("(5)", L + backs)):
        item = f"equation {name}, circle (3) at this limit"
        yield row(item, circle_of_confusion_mm(places, LENS))
    limits = depth_of_field(LENS, C)
    total = eq6_total(N, C, L, F)
    yield row("equation (6)", (total, limits.total_mm), sums=fronts + backs)
    yield row(
        "equation (5), hyperfocal distance",
        (hyperfocal(N, C, F), limits.hyperfocal_mm),
    )


def _example() -> Items:
    """Section 3.1."""
    fronts, backs = _sharp_mm()
    used = "diameter .035 mm"
    for name, values in {
        "f-number": (N, N),
        "focal length": (F, F),
        "distance": (L / 1e3, L / 1e3),
        "permitted circle": (used, used),
        "front depth of field (4)": fronts,
        "back depth of field (5)": backs,
        "sharp from": (L - fronts) / 1e3,
        "sharp to": (L + backs) / 1e3,
        "depth of field of the composited scene": None,
    }.items():
        yield row(
            f"section 3.1, {name}",
            values,
            as_radius=eq4_front(N, 2 * C, L, F),
            sums=fronts + backs,
            total=eq6_total(N, C, L, F),
        )
    distance = np.linspace(2350, 2680, 400)
    circle = np.array([eq3_circle(F, N, L, d) for d in distance])
    apart = np.abs(circle - circle_of_confusion_mm(distance, LENS)).max()
    yield row(
        "figure 3",
        (f"circles of 0 to {circle.max():.3f} mm", f"{apart:.0e} mm apart from them"),
        apart < 1e-9,
        {
            "by the printed formulas": _plot(
                distance, circle, np.transpose([L - fronts, L + backs])
            )
        },
    )


@styled
def _plot(distance: ndarray, circle: ndarray, limits: ndarray) -> ndarray:
    """(h, w, 3) uint8 of figure 3. limits : of what is sharp, as printed and corrected, mm"""
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
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _blur_factor() -> Items:
    """Section 3.2, and what of it is wrong."""
    words = "dioptres, 0 to 1 / z_near"
    yield row("section 3.2, depth = z / z_far", (words, words))
    infinite = blur_factor(np.array([0.0]), (0.0, 20.0), AT)[0]
    corrected = f"{LENS.coc_at_infinity_mm / C:.0f} × the permitted circle"
    item = "section 3.2, a of infinity, near plane at 50 mm"
    yield row(item, (infinite, corrected))


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
    counted = sum(middle(only) > 100.5 for only in np.delete(more, 4, 0))
    yield row("figure 7, neighbours that count", counted)
    result = middle(around)
    brighter = around[around > 100]
    expected = float(np.average(brighter, weights=brighter - 100))
    yield row(
        "equation (8), 100 among 100, 120, 90, 180, 100, 60, 100, 140",
        result,
        math.isclose(result, expected, rel_tol=1e-5),
    )


def _blocks() -> Items:
    """Figure 8: numbers of a CUDA block, and whether the printed filters fit into it."""
    (rows_px, columns_px), (tall, wide), size = (8, 16), (16, 24), 4
    threads = rows_px * columns_px
    with_border = tall * wide
    parts = {
        "bytes of colour": with_border * 3 * size,
        "bytes of circle": with_border * size,
        "bytes of luminance": with_border * size,
        "bytes of result": threads * 3 * size,
        "bytes of intermediate": threads * size,
    }
    for name, value in {
        **parts,
        "shared memory": sum(parts.values()),
        "blocks of 800 x 800": (800 // rows_px) * (800 // columns_px),
        "threads of a block": threads,
    }.items():
        yield row(f"figure 8, {name}", value)


def _blend() -> Items:
    """(9), the factor 2/3 and its border."""
    over = np.full((1, 1, 3), 80.0)
    under = np.full((1, 1, 3), 40.0)
    blended = eq9_blend(np.array([[0.25]]), over, under)[0, 0, 0]
    yield row("equation (9), 80 over 40 with α = 1/4", blended)
    sharp = sharp_range(AT, F, C)
    inside, outside = within_depth_of_field(AT.focus + np.array([0, 0.1]), sharp, 0.5)
    item = "section 3.4, factor inside the depth of field"
    yield row(item, inside, abs(inside - 2 / 3) < 1e-9)
    yield row("section 3.4, factor outside", outside)
