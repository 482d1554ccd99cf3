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
    Figure,
    Items,
    Row,
    row,
)
from arfx.reproduce.s3_measure import FLAT, OBJECTS, Shown, corrected, printed
from arfx.reproduce.work import Work
from arfx.stages.watercolor.labels import label
from arfx.stages.watercolor.sites import make_sites, still_field
from arfx.stages.watercolor.toon import RAMP, tones

CELLS_ALONE = {"toon": False, "line_threshold": 2.0}
DRAWN = 0.1  # share of the ink from which a line is seen
BLACK = (0, 0, 0)
WHITE = (1, 1, 1)
RED = (1, 0, 0)
GREEN = (0, 1, 0)
# What (2), (3) and the left side of (4) come to for a step between two colours with alpha =
# beta = .5 and BT.601
STEP_VALUES = {
    "black beside white": (BLACK, WHITE, "0.5", "1", "0.75"),
    "black beside red": (BLACK, RED, "0.34", "0.3333", "0.3367"),
    "red beside green": (RED, GREEN, "0.4619", "0.6667", "0.5643"),
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
    item = "figure 3, AR frame"
    words = f"{', '.join(seen)}, from one model file"
    yield row(
        item,
        "virtual objects in the camera's frame",
        (words, words),
        "",
        "",
        seen == list(OBJECTS),
    )
    yield Figure(
        item,
        "what both methods are given",
        {"camera": frame.real, BEFORE: frame.image},
    )


def cell_rows(frame: Shown) -> Items:
    """3.1.1, and 3.1.2 with cones of one size."""
    rect, (m, n) = frame.layers.rect, measure.cells_of(frame)
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
        "1",
        [measure.rectangles_with_site(s, rect, m, n) for s, _ in both],
        "share of the rectangles",
        "corrected sites are those of a nested grid that moves with the things: as many,"
        " one to a rectangle in the mean alone",
        tolerance=1e-9,
    )
    item = "figure 2, Voronoi diagram"
    yield row(f"{item}, polygons", str(m * n), len(np.unique(labels)))
    yield row(
        item,
        "1",
        [measure.convex_share(found) for _, found in both],
        "share of cells that are convex",
        tolerance=1e-9,
    )
    colours = np.random.default_rng(2).integers(
        60, 250, (len(ours) + m * n, 3), np.uint8
    )
    cells = {PRINTED: colours[labels], CORRECTED: colours[own]}
    yield Figure(item, "each cell in a colour by chance", cells)
    _, many = paper.named_by_colour(frame.image, labels, sites, rect)
    numbers = len(np.unique(ours.key)) / len(ours)
    yield row(
        "section 3.1.2, a cell is known by the colour at its site",
        "unique",
        (many / (m * n), numbers),
        "names per cell",
        f"equal colours collide: {m * n} cells have {many} names in the frame; corrected:"
        " integers",
    )

    item = "figure 4, cells in their mean colour"
    yield row(
        item,
        "the mean of the cell's pixels",
        [
            measure.mean_error(frame.image, labels),
            measure.mean_error(frame.layers[Layer.IMAGE], own),
        ],
        "grey levels off it at most",
        "",
        below=0.01,
    )
    made = frame.painted(printed(**CELLS_ALONE))
    flat = frame.painted(corrected(cell_px=measure.CELL_PX, **FLAT))
    yield Figure(
        item,
        "cells alone, their size by depth",
        {BEFORE: frame.image, PRINTED: made, CORRECTED: flat},
    )


def depth_row(work: Work) -> Row:
    """3.1.2: the depth buffer decides the cones' size."""
    depth, areas = measure.areas_on_plane(8, work.scaled(10, 2))
    return row(
        "section 3.1.2, nearer is finer",
        "nearer is finer",
        areas[-1] / areas[0],
        f"area of a cell of a plane at {depth[-1]:.2f} m / at {depth[0]:.2f} m",
        "m × n sites are spread evenly, and the size of cones moves the borders between"
        " near and far alone, which makes them arcs. Corrected: the density of the sites"
        " follows the depth",
    )


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
    yield row("toon listing, second threshold", "0.2", low, "n · l")
    for name, text, at in (
        ("first", "1", 1.0),
        ("second", "0.4", 0.35),
        ("third", "0.1", -0.5),
    ):
        k = np.searchsorted(cosine, at - 1e-9)
        yield row(
            f"toon listing, {name} tone",
            text,
            [kind[k] for kind in kinds],
            "of the colour",
            tolerance=1e-4,
        )
    yield row(
        "toon listing, discrete intensities",
        "3",
        [len(np.unique(kind.round(4))) for kind in kinds],
        "tones",
        f"corrected, a step is a ramp of {RAMP:g} in n · l, so that it does not crawl",
    )


def edge_rows(frame: Shown) -> Items:
    """3.2: (2) to (4)."""
    for k, (equation, beta) in enumerate(
        (
            ("equation (2)", 1.0),
            ("equation (3)", 0.0),
            ("equation (4), left side", 0.5),
        )
    ):
        for step, (left, right, *values) in STEP_VALUES.items():
            found = measure.edge_of(left, right, beta)
            item = f"{equation}, {step}"
            unit = "α = β = .5"
            yield row(item, values[k], found, unit, tolerance=2e-4)
    item = "figure 5, edges of the frame"
    toon_shaded = printed().frame(frame.view(printed()))
    edges = measure.printed_edges(toon_shaded, printed().params)
    lines = measure.corrected_lines(frame)
    why = (
        "what stands before nearly its own colour is below the threshold; corrected, the"
        " object's layers are looked at too"
    )
    objects = frame.objects().items()
    outlines = {
        f"outline of the {name}": measure.outline(own) for name, own in objects
    }
    outlines["outlines of real things"] = frame.real_outlines()
    strong = edges, lines > DRAWN
    for name, where in outlines.items():
        if name == "outlines of real things":
            why = (
                "what stands before nearly its own colour is below the thresholds; corrected,"
                " a line that is nowhere strong fades"
            )
        near = [measure.share_near(where, seen) for seen in strong]
        unit = "share of it with an edge within 2 px"
        yield row(f"{item}, {name}", "found", near, unit, why, min(near) > 0.95)
    black = [seen.mean() for seen in strong]
    words = "outlines of virtual and real things"
    unit = "share of the frame's pixels"
    yield row(item, words, black, unit, "", min(black) > 0)
    drawn = {
        BEFORE: toon_shaded,
        PRINTED: 1.0 - edges,
        CORRECTED: 1 - lines,
        "outlines by depth": 1.0 - np.any(list(outlines.values()), axis=0),
    }
    yield Figure(item, "of the toon-shaded frame", drawn)


def picture_rows(frame: Shown) -> Items:
    """3.3."""
    stage = printed()
    view = frame.view(stage)
    coded = stage.frame(view)
    cells = stage.cells(view, coded)
    edges = measure.printed_edges(coded, stage.params)
    done = np.where(edges[..., None], 0, cells)
    made = frame.painted(stage)
    item = "figure 6, from the frame to the picture"
    apart = 255 * np.abs(done - made).max()
    words = "cells, with the edges over them"
    unit = "grey levels from these steps"
    yield row(item, words, apart, unit, "", below=0.5)
    yield Figure(
        item,
        "the printed steps",
        {
            "frame": coded,
            "cells": cells,
            "edges": 1.0 - edges,
            "cells and edges": done,
        },
    )

    ours = frame.painted(corrected())
    change = [255 * np.abs(a - frame.image).mean() for a in (made, ours)]
    item = "figure 7, watercolour of the frame"
    yield row(
        item,
        "real and virtual agree",
        change,
        "grey levels",
        "the paper has no measure of how well real and virtual agree; the values are how"
        " much the frame has changed in the mean",
    )
    yield Figure(
        item, "the result", {BEFORE: frame.image, PRINTED: made, CORRECTED: ours}
    )


def time_rows(frame: Shown, work: Work) -> Items:
    """What sections 2 and 4 say of time."""
    # the paper's grain rests on the screen
    stages = (printed(), corrected(grain=0.0))
    frames = work.scaled(5, 3)
    errors, changes = zip(
        *(measure.change_at_rest(frame, stage, frames) for stage in stages),
        strict=True,
    )
    item = "section 2, coherence at rest, whole picture"
    yield row(
        item,
        "good",
        errors,
        "squared error between frames, noise 2/255",
        "new random numbers in every frame; corrected sites are a hash of (seed, cell)",
    )
    names = f"change, {PRINTED}", f"change, {CORRECTED}"
    pictures = {name: 8 * change for name, change in zip(names, changes, strict=True)}
    yield Figure(item, "change from a frame to the next, × 8", pictures)


def _threshold(tones: ndarray, cosine: ndarray) -> float:
    """Cosine at which the tone is half-way between the lower two of three, to .001."""
    middle = (tones[0] + tones[np.searchsorted(cosine, 0.35)]) / 2
    return float(cosine[np.searchsorted(tones, middle)].round(3))
