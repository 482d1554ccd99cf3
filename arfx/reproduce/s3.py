"""Rows of Jia, Tang 2013: Voronoi watercolour, in the paper's order.

Both formulas paint the same frame (`s3_scene`). What is not in it (cells on a plane, steps
of colour, a resting and a panning camera) is made in `s3_measure`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from arfx.core.layers import Layer
from arfx.papers import s3_watercolor as paper
from arfx.reproduce import s3_measure as measure
from arfx.reproduce import s3_scene as scene
from arfx.reproduce.rows import BEFORE, CORRECTED, PRINTED, Figure, Item, Row, curves, row
from arfx.reproduce.s3_scene import FLAT, OBJECTS, Shown, corrected, picture, printed
from arfx.reproduce.work import Work, median_s
from arfx.stages.watercolor.cells import mean_colours
from arfx.stages.watercolor.labels import label
from arfx.stages.watercolor.lines import ALPHA, BETA
from arfx.stages.watercolor.sites import make_sites, still_field
from arfx.stages.watercolor.toon import RAMP, tones

DRAWN = 0.1  # share of the ink from which a line is seen
BLACK, WHITE, RED, GREEN = (0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 0)
# What (2), (3) and the left side of (4) come to for a step between two colours with alpha =
# beta = .5 and BT.601
STEP_VALUES = {
    "black beside white": (BLACK, WHITE, "0.5", "1", "0.75"),
    "black beside red": (BLACK, RED, "0.34", "0.3333", "0.3367"),
    "red beside green": (RED, GREEN, "0.4619", "0.6667", "0.5643"),
}


def rows(work: Work) -> Iterator[Item]:
    frame = scene.shown(work)
    yield from frame_rows(frame)
    yield from cell_rows(frame)
    yield from depth_rows(frame, work)
    yield from toon_rows(frame)
    yield from edge_rows(frame, work)
    yield from picture_rows(frame)
    yield from time_rows(frame, work)


def frame_rows(frame: Shown) -> Iterator[Item]:
    seen = [name for name, where in frame.objects().items() if where.any()]
    item, words = "figure 3, AR frame", f"{', '.join(seen)}, from one model file"
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
        {"camera": frame.real, BEFORE: picture(frame.image)},
    )


def cell_rows(frame: Shown) -> Iterator[Item]:
    """3.1.1, and 3.1.2 with cones of one size."""
    rect, (m, n) = frame.layers.rect, scene.cells_of(frame)
    w, h = rect.width / n, rect.height / m
    cell_px = float(np.sqrt(w * h))
    sites = paper.eq1_sites(rect, m, n, 1)
    ours = make_sites(still_field(rect.width, rect.height, cell_px, 64), 1, 10**6, cell_px)
    labels, own = paper.cones(sites, np.ones(m * n), rect, m, n), label(ours, rect).first

    yield _not_stated(
        "m and n", "settings; 0 = cells of cell_px", "cell_px, for cells of any density"
    )
    shares = (
        measure.rectangles_with_site(sites, rect, m, n),
        measure.rectangles_with_site(ours, rect, m, n),
    )
    why = (
        "corrected sites are those of a nested grid that moves with the things: as many,"
        " one to a rectangle in the mean alone"
    )
    item = "equation (1), a site in each of m × n rectangles"
    yield row(item, "1", shares, "share of the rectangles", why, tolerance=1e-9)
    item = "equation (1), every site in its own cell"
    shares = (measure.own_cell_share(sites), measure.own_cell_share(ours))
    yield row(item, "1", shares, "share of sites", tolerance=1e-9)
    away, far = (
        measure.farthest(s, found) / np.hypot(w, h)
        for s, found in ((sites, labels), (ours, own))
    )
    item = "equation (1), farthest pixel from its site"
    yield row(
        item, "at most 1", (away, far), "diagonal of a rectangle", "", max(away, far) <= 1
    )

    item = "figure 2, Voronoi diagram"
    yield row(f"{item}, polygons", str(m * n), float(len(np.unique(labels))))
    shares = measure.convex_share(labels), measure.convex_share(own)
    yield row(item, "1", shares, "share of cells that are convex", tolerance=1e-9)
    yield Figure(item, "each cell in a colour by chance", _templates(labels, own))
    nearest = (
        measure.nearest_share(sites, labels[:64, :96]),
        measure.nearest_share(ours, own[:64, :96]),
    )
    yield row(
        "section 3.1.2, cones give Voronoi cells",
        "1",
        nearest,
        "share of pixels with the nearest site",
        tolerance=1e-9,
    )

    _, even = paper.named_by_colour(
        np.full(frame.image.shape, 0.5, np.float32), labels, sites, rect
    )
    _, many = paper.named_by_colour(frame.image, labels, sites, rect)
    why = (
        f"equal colours collide: {m * n} cells have {many} names in the frame and {even} on"
        " an even picture; corrected: integers"
    )
    numbers = len(np.unique(ours.key)) / len(ours)
    item = "section 3.1.2, a cell is known by the colour at its site"
    yield row(item, "unique", (many / (m * n), numbers), "names per cell", why)

    item, errors = "figure 4, cells in their mean colour", []
    for found, image in ((labels, frame.image), (own, frame.layers[Layer.IMAGE])):
        exact, area = measure.exact_means(image, found)
        errors.append(
            float(
                255
                * np.abs(mean_colours(image, [found], len(area))[0] - exact)[area > 0].max()
            )
        )
    yield row(
        item,
        "the mean of the cell's pixels",
        errors,
        "grey levels off it at most",
        "",
        max(errors) < 0.01,
    )
    flat = (
        frame.painted(printed(frame, toon=False, line_threshold=2.0)),
        frame.painted(corrected(cell_px=scene.CELL_PX, toon=False, **FLAT)),
    )
    shown_flat = {
        BEFORE: picture(frame.image),
        PRINTED: picture(flat[0]),
        CORRECTED: picture(flat[1]),
    }
    yield Figure(item, "cells alone, their size by depth", shown_flat)


def depth_rows(frame: Shown, work: Work) -> Iterator[Item]:
    """3.1.2: the depth buffer decides the cones' size."""
    depth, by_cones, by_density = measure.areas_on_plane(8, work.scaled(10, 2))
    area, covered, equal = measure.small_thing(work.scaled(40, 10))
    why = (
        "m × n sites are spread evenly, and the size of cones moves the borders between"
        " near and far alone: a disc five cells wide, at .25 m before a wall at 2 m, has"
        f" cells of {area:.2f} of the wall's area, and the wall's cells cover {covered:.0%}"
        f" of it ({equal:.0%} with equal cones). Corrected: the density of the sites"
        " follows the depth"
    )
    item = "section 3.1.2, nearer is finer"
    unit = f"area of a cell of a plane at {depth[-1]:.2f} m / at {depth[0]:.2f} m"
    ratios = float(by_cones[-1] / by_cones[0]), float(by_density[-1] / by_density[0])
    yield row(item, "nearer is finer", ratios, unit, why)
    yield curves(
        item,
        "cells on a plane",
        ("depth of the plane, m", "mean area of a cell, px"),
        depth,
        {PRINTED: by_cones, CORRECTED: by_density},
    )
    buffer, labels = measure.printed_cells(frame)
    share = measure.convex_share(labels)
    why = (
        "borders between cones of two sizes are arcs; corrected cells are power cells,"
        " which are polygons"
    )
    own = measure.corrected_cells(frame)
    item = "section 3.1.2, polygons with cones of many sizes"
    yield row(
        item,
        "convex",
        (share, measure.convex_share(own)),
        "share of cells that are convex",
        why,
    )
    yield Figure(
        item, "cells by depth", {"depth buffer": picture(buffer), **_templates(labels, own)}
    )
    yield _not_stated(
        "size of a cone by the depth buffer",
        "in proportion to its value",
        "depth ^ nearer_finer",
    )


def toon_rows(frame: Shown) -> Iterator[Item]:
    """3.2: the listing."""
    p, c, n = printed(frame).params, corrected().params, 20001
    cosine, up = np.linspace(-1, 1, n), np.array([0, 0, 1.0])
    normal = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], -1)[None].astype(
        np.float32
    )
    one = np.ones((1, n, 3), np.float32)
    hard = paper.toon(one, normal, up, p.toon_thresholds, p.toon_factors)[0, :, 0]
    soft = tones(cosine, c.toon_thresholds, c.toon_factors)
    (low, high), (low_soft, high_soft) = (
        _thresholds(hard, cosine),
        _thresholds(soft, cosine),
    )
    yield _not_stated(
        "toon listing, first threshold",
        high,
        high_soft,
        "the line with the first `if` is missing",
    )
    yield row("toon listing, second threshold", "0.2", (low, low_soft), "n · l")
    for name, text, at in (
        ("first", "1", 1.0),
        ("second", "0.4", 0.35),
        ("third", "0.1", -0.5),
    ):
        k = int(np.searchsorted(cosine, at - 1e-9))
        yield row(
            f"toon listing, {name} tone",
            text,
            (float(hard[k]), float(soft[k])),
            "of the colour",
            tolerance=1e-4,
        )
    why = f"corrected, a step is a ramp of {RAMP:g} in n · l, so that it does not crawl"
    counts = [float(len(np.unique(tones.round(4)))) for tones in (hard, soft)]
    yield row("toon listing, discrete intensities", "3", counts, "tones", why)

    where, shares = np.any(list(frame.objects().values()), axis=0), []
    for stage in (printed(frame), corrected()):
        pair = (
            measure.printed_edges(frame.image, p)[where].mean(),
            measure.printed_edges(frame.toon_shaded(stage), p)[where].mean(),
        )
        shares.append((float(pair[0]), float(pair[1])))
    words = [
        f"{toon:.1%} of the objects' pixels; {smooth:.1%} shaded smoothly"
        for smooth, toon in shares
    ]
    item, why = "section 3.2, toon in place of Gouraud shading", "a soft step is no edge"
    yield row(
        item, "edges that stand out more", words, "", why, all(b > a for a, b in shares)
    )


def edge_rows(frame: Shown, work: Work) -> Iterator[Item]:
    """3.2: (2) to (4)."""
    for k, (equation, beta) in enumerate(
        (("equation (2)", 1.0), ("equation (3)", 0.0), ("equation (4), left side", 0.5))
    ):
        for step, (left, right, *values) in STEP_VALUES.items():
            made = measure.edge_of(left, right, beta)
            yield row(f"{equation}, {step}", values[k], made, "α = β = .5", tolerance=2e-4)
    p, c = printed(frame).params, corrected().params
    yield _not_stated("matrix from RGB to YUV", p.yuv, "bt601")
    yield _not_stated("equation (2), alpha", p.alpha, ALPHA)
    yield _not_stated("equation (4), beta", p.beta, BETA)
    yield _not_stated(
        "equation (4), threshold", p.line_threshold, f"{c.line_low:g} to {c.line_high:g}"
    )
    why = (
        "near a hard threshold noise decides; corrected lines come from a smoothed picture,"
        " with hysteresis and a ramp"
    )
    item = "equation (4), pixels of an edge that flip"
    flips = measure.flips(work.scaled(12, 4))
    yield row(
        item,
        "an edge, or none",
        flips,
        "share from frame to frame, noise 2/255, at the worst contrast",
        why,
    )

    item, toon_shaded = "figure 5, edges of the frame", frame.toon_shaded(printed(frame))
    edges, lines = measure.printed_edges(toon_shaded, p), measure.corrected_lines(frame)
    why = (
        "what stands before nearly its own colour is below the threshold; corrected, the"
        " object's layers are looked at too"
    )
    outlines = {
        f"outline of the {name}": (measure.outline(where), why)
        for name, where in frame.objects().items()
    }
    why = (
        "what stands before nearly its own colour is below the thresholds; corrected, a"
        " line that is nowhere strong fades"
    )
    outlines["outlines of real things"] = frame.real_outlines(), why
    for name, (where, why) in outlines.items():
        found = measure.share_near(where, edges), measure.share_near(where, lines > DRAWN)
        yield row(
            f"{item}, {name}",
            "found",
            found,
            "share of it with an edge within 2 px",
            why,
            min(found) > 0.95,
        )
    black = float(edges.mean()), float((lines > DRAWN).mean())
    yield row(
        item,
        "outlines of virtual and real things",
        black,
        "share of the frame's pixels",
        "",
        min(black) > 0,
    )
    true = np.any([where for where, _ in outlines.values()], axis=0)
    drawn = {
        BEFORE: toon_shaded,
        PRINTED: 1.0 - edges,
        CORRECTED: 1 - lines,
        "outlines by depth": 1.0 - true,
    }
    yield Figure(
        item, "of the toon-shaded frame", {name: picture(a) for name, a in drawn.items()}
    )


def picture_rows(frame: Shown) -> Iterator[Item]:
    """3.3."""
    stage, rect, (m, n) = printed(frame), frame.layers.rect, scene.cells_of(frame)
    view = frame.view(stage)
    coded, sites = stage.frame(view), paper.eq1_sites(rect, m, n, view.key)
    size = paper.at_sites(paper.depth_buffer(view, stage.params.near_m), sites, rect)
    names, count = paper.named_by_colour(
        coded, paper.cones(sites, size, rect, m, n), sites, rect
    )
    cells = mean_colours(coded, [names], count)[0][names]
    edges = measure.printed_edges(coded, stage.params)
    done, made = np.where(edges[..., None], 0, cells), frame.painted(stage)
    item = "figure 6, from the frame to the picture"
    apart = float(255 * np.abs(done - made).max())
    yield row(
        item,
        "cells, with the edges over them",
        apart,
        "grey levels from these steps",
        "",
        apart < 0.5,
    )
    steps = {"frame": coded, "cells": cells, "edges": 1.0 - edges, "cells and edges": done}
    yield Figure(item, "the printed steps", {name: picture(a) for name, a in steps.items()})

    ours = frame.painted(corrected())
    change = [float(255 * np.abs(a - frame.image).mean()) for a in (made, ours)]
    item = "figure 7, watercolour of the frame"
    why = (
        "the paper has no measure of how well real and virtual agree; the values are how"
        " much the frame has changed in the mean"
    )
    yield row(item, "real and virtual agree", change, "grey levels", why)
    yield Figure(
        item,
        "the result",
        {BEFORE: picture(frame.image), PRINTED: picture(made), CORRECTED: picture(ours)},
    )


def time_rows(frame: Shown, work: Work) -> Iterator[Item]:
    """What sections 2 and 4 say of time."""
    frames, lineless = work.scaled(5, 3), {"toon": False, "line_threshold": 2.0}
    flat, rest = (
        {"toon": False, **FLAT},
        {"grain": 0.0},
    )  # the paper's grain rests on the screen
    at_rest = (
        "new random numbers in every frame; corrected sites are a hash of (seed, cell)"
    )
    in_pan = (
        "even fixed on the screen, cells let the picture swim; corrected ones move with the"
        " things"
    )
    for name, of_printed, of_corrected in (
        ("cells", lineless, flat),
        ("whole picture", {}, rest),
    ):
        made, ours = measure.still_frames(frame, frames, of_printed, of_corrected)
        item = f"section 2, coherence at rest, {name}"
        errors = (measure.mean_squared(made), measure.mean_squared(ours))
        yield row(
            item, "good", errors, "squared error between frames, noise 2/255", at_rest
        )
        change = {
            PRINTED: 8 * abs(made[1] - made[0]),
            CORRECTED: 8 * abs(ours[1] - ours[0]),
        }
        yield Figure(
            item,
            "change from a frame to the next, × 8",
            {f"change, {k}": picture(a) for k, a in change.items()},
        )
        errors = measure.pan_errors(frame.scene, frames, of_printed, of_corrected)
        item = f"section 2, coherence in a pan, {name}"
        yield row(
            item, "good", errors, "squared error along the motion, noise 2/255", in_pan
        )
    rates = [
        1 / median_s(partial(frame.paint_anew, frame.ready(stage)), work.scaled(5, 1))
        for stage in (printed(frame), corrected())
    ]
    rect = frame.layers.rect
    why = (
        "no rate, size or machine is printed; the values are of the stage alone, at"
        f" {rect.width} × {rect.height} on a processor"
    )
    yield row("section 2, speed", "real time", rates, "frames/s", why)


def _not_stated(
    item: str, here: float | str, ours: float | str, why: str = "the paper does not say"
) -> Row:
    return row(item, "not stated", (here, ours), "", f"{why}: it is a setting")


def _templates(labels: np.ndarray, own: np.ndarray) -> dict[str, np.ndarray]:
    """Pictures in which each cell has a colour by chance."""
    colours = np.random.default_rng(2).integers(
        60, 250, (int(max(labels.max(), own.max())) + 1, 3), np.uint8
    )
    return {"cells, printed": colours[labels], "cells, corrected": colours[own]}


def _thresholds(tones: np.ndarray, cosine: np.ndarray) -> tuple[float, float]:
    """Cosines at which the tone is half-way between the lower two and between the upper two
    of three, to .001.
    """
    low, middle, high = tones[0], tones[np.searchsorted(cosine, 0.35)], tones[-1]
    first, second = (
        round(float(cosine[np.searchsorted(tones, (a + b) / 2)]), 3)
        for a, b in ((low, middle), (middle, high))
    )
    return first, second
