"""Rows of Jia, Tang 2013: Voronoi watercolour, in the paper's order.

Both formulas paint the same frame. It is made in `s3_measure`, and so is what is not in it:
cells on a plane, steps of colour, a resting camera."""

import numpy as np
from numpy import ndarray

from arfx.core.layers import Layer
from arfx.papers import s3_watercolor as paper
from arfx.reproduce import s3_measure as measure
from arfx.reproduce.rows import (
    BEFORE,
    CORRECTED,
    PRINTED,
    Items,
    Row,
    rows_of,
)
from arfx.reproduce.s3_measure import FLAT, OBJECTS, Shown, corrected, printed
from arfx.reproduce.work import Work
from arfx.stages.watercolor.labels import label
from arfx.stages.watercolor.sites import make_sites, still_field
from arfx.stages.watercolor.toon import RAMP, tones

row = rows_of("s3")

CELLS_ALONE = {"toon": False, "line_threshold": 2.0}
DRAWN = 0.1  # share of the ink from which a line is seen
BLACK = (0, 0, 0)
WHITE = (1, 1, 1)
RED = (1, 0, 0)
GREEN = (0, 1, 0)
STEPS = {
    "black beside white": (BLACK, WHITE),
    "black beside red": (BLACK, RED),
    "red beside green": (RED, GREEN),
}


def rows(work: Work) -> Items:
    frame = measure.shown(work)
    yield from frame_rows(frame)
    yield from cell_rows(frame)
    yield depth_row(work)
    yield from toon_rows(frame)
    yield from edge_rows(frame)
    yield from picture_rows(frame)
    yield from time_rows(frame, work)


def frame_rows(frame: Shown) -> Items:
    seen = [name for name, where in frame.objects().items() if where.any()]
    words = f"{', '.join(seen)}, from one model file"
    pictures = {"camera": frame.real, BEFORE: frame.image}
    yield row("figure 3, AR frame", (words, words), seen == list(OBJECTS), pictures)


def cell_rows(frame: Shown) -> Items:
    """3.1.1, and 3.1.2 with cones of one size."""
    rect = frame.layers.rect
    m, n = printed().params.grid(rect)
    w = rect.width / n
    h = rect.height / m
    cell_px = float(np.sqrt(w * h))
    sites, labels = paper.voronoi(np.ones((rect.height, rect.width)), rect, m, n, 1)
    field = still_field(rect.width, rect.height, cell_px, 64)
    ours = make_sites(field, 1, 10**6, cell_px)
    own = label(ours, rect).first
    both = ((sites, labels), (ours, own))

    yield row(
        "equation (1), a site in each of m × n rectangles",
        [measure.rectangles_with_site(s, rect, m, n) for s, _ in both],
    )
    item = "figure 2, Voronoi diagram"
    yield row(f"{item}, polygons", len(np.unique(labels)), cells=m * n)
    colours = np.random.default_rng(2).integers(
        60, 250, (len(ours) + m * n, 3), np.uint8
    )
    yield row(
        item,
        [measure.convex_share(found) for _, found in both],
        None,
        {PRINTED: colours[labels], CORRECTED: colours[own]},
    )
    _, many = paper.named_by_colour(frame.image, labels, sites, rect)
    numbers = len(np.unique(ours.key)) / len(ours)
    item = "section 3.1.2, a cell is known by the colour at its site"
    yield row(item, (many / (m * n), numbers), cells=m * n, names=many)

    made = frame.painted(printed(**CELLS_ALONE))
    flat = frame.painted(corrected(cell_px=measure.CELL_PX, **FLAT))
    yield row(
        "figure 4, cells in their mean colour",
        [
            measure.mean_error(frame.image, labels),
            measure.mean_error(frame.layers[Layer.IMAGE], own),
        ],
        None,
        {BEFORE: frame.image, PRINTED: made, CORRECTED: flat},
    )


def depth_row(work: Work) -> Row:
    """3.1.2: the depth buffer decides the cones' size."""
    depth, areas = measure.areas_on_plane(8, work.scaled(10, 2))
    item = "section 3.1.2, nearer is finer"
    return row(item, areas[-1] / areas[0], depth=depth)


def toon_rows(frame: Shown) -> Items:
    """3.2: the listing."""
    p, c = printed().params, corrected().params
    cosine = np.linspace(-1, 1, 20001)
    normal = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], -1).astype(
        np.float32
    )
    one = np.ones((len(cosine), 1), np.float32)
    up = np.array([0, 0, 1.0])
    kinds = (
        paper.toon(one, normal, up, p.toon_thresholds, p.toon_factors)[:, 0],
        tones(cosine, c.toon_thresholds, c.toon_factors),
    )
    low = [_threshold(kind, cosine) for kind in kinds]
    yield row("toon listing, second threshold", low)
    for name, at in (("first", 1.0), ("second", 0.35), ("third", -0.5)):
        k = np.searchsorted(cosine, at - 1e-9)
        yield row(f"toon listing, {name} tone", [kind[k] for kind in kinds])
    counts = [len(np.unique(kind.round(4))) for kind in kinds]
    yield row("toon listing, discrete intensities", counts, ramp=RAMP)


def edge_rows(frame: Shown) -> Items:
    """3.2: (2) to (4)."""
    for equation, beta in (
        ("equation (2)", 1.0),
        ("equation (3)", 0.0),
        ("equation (4), left side", 0.5),
    ):
        for step, colours in STEPS.items():
            yield row(f"{equation}, {step}", measure.edge_of(*colours, beta))
    item = "figure 5, edges of the frame"
    toon_shaded = printed().frame(frame.view(printed()))
    edges = printed().edges(toon_shaded)
    lines = measure.corrected_lines(frame)
    objects = frame.objects().items()
    outlines = {
        f"outline of the {name}": measure.outline(own) for name, own in objects
    }
    outlines["outlines of real things"] = frame.real_outlines()
    strong = edges, lines > DRAWN
    for name, where in outlines.items():
        near = [measure.share_near(where, seen) for seen in strong]
        yield row(f"{item}, {name}", near, min(near) > 0.95)
    black = [seen.mean() for seen in strong]
    drawn = {
        BEFORE: toon_shaded,
        PRINTED: 1.0 - edges,
        CORRECTED: 1 - lines,
        "outlines by depth": 1.0 - np.any(list(outlines.values()), axis=0),
    }
    yield row(item, black, min(black) > 0, drawn)


def picture_rows(frame: Shown) -> Items:
    """3.3."""
    stage = printed()
    view = frame.view(stage)
    coded = stage.frame(view)
    cells = stage.cells(view, coded)
    edges = stage.edges(coded)
    done = np.where(edges[..., None], 0, cells)
    made = frame.painted(stage)
    steps = {
        "frame": coded,
        "cells": cells,
        "edges": 1.0 - edges,
        "cells and edges": done,
    }
    apart = 255 * np.abs(done - made).max()
    yield row("figure 6, from the frame to the picture", apart, None, steps)

    ours = frame.painted(corrected())
    change = [255 * np.abs(a - frame.image).mean() for a in (made, ours)]
    pictures = {BEFORE: frame.image, PRINTED: made, CORRECTED: ours}
    yield row("figure 7, watercolour of the frame", change, None, pictures)


def time_rows(frame: Shown, work: Work) -> Items:
    """What sections 2 and 4 say of time."""
    # the paper's grain rests on the screen
    stages = (printed(), corrected(grain=0.0))
    frames = work.scaled(5, 3)
    errors = [measure.change_at_rest(frame, stage, frames) for stage in stages]
    yield row("section 2, coherence at rest, whole picture", errors)


def _threshold(tones: ndarray, cosine: ndarray) -> float:
    """Cosine at which the tone is half-way between the lower two of three, to .001."""
    middle = (tones[0] + tones[np.searchsorted(cosine, 0.35)]) / 2
    return float(cosine[np.searchsorted(tones, middle)].round(3))
