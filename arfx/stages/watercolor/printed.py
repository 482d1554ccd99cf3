"""The stage as printed: new jitter every frame, cells told apart by the colour at their site, hard edges in black."""

from __future__ import annotations

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.noise import noise
from arfx.core.rect import Rect
from arfx.stages.watercolor.cells import means
from arfx.stages.watercolor.edges import printed_edges
from arfx.stages.watercolor.labels import label
from arfx.stages.watercolor.sites import STEPS, Sites


def jittered_sites(rect: Rect, cell_px: float, key: int) -> Sites:
    """V(i, j) = (W/n (j + 1/2 + r), H/m (i + 1/2 + r')), r in (-1/2, 1/2): (1). In the pixels' own coordinates.

    key : of the random numbers, as core.noise takes it
    """
    n, m = max(round(rect.width / cell_px), 1), max(round(rect.height / cell_px), 1)
    r = [noise(Rect.of(n, m), key, channel) for channel in (0, 1)]
    x = rect.x0 - 0.5 + rect.width / n * (np.arange(n) + r[0])
    y = rect.y0 - 0.5 + rect.height / m * (np.arange(m)[:, None] + r[1])
    place = [np.round(a.ravel() * STEPS).astype(np.float32) for a in (x, y)]
    zero = np.zeros(m * n, np.float32)
    return Sites(place[0], place[1], zero, np.arange(m * n), place[0] / STEPS, place[1] / STEPS)


def merged_by_colour(coded: np.ndarray, labels: np.ndarray, sites: Sites, rect: Rect) -> tuple[np.ndarray, int]:
    """(labels, count) in which cells whose sites show one 8-bit colour are one cell. coded : (h, w, 3) 0..1."""
    x = np.clip(np.round(sites.x / STEPS) - rect.x0, 0, rect.width - 1).astype(int)
    y = np.clip(np.round(sites.y / STEPS) - rect.y0, 0, rect.height - 1).astype(int)
    colour = np.round(np.clip(coded[y, x], 0, 1) * 255).astype(np.int64) @ np.array([65536, 256, 1])
    unique, number = np.unique(colour, return_inverse=True)
    return number.ravel().astype(np.int32)[labels], len(unique)


def printed(
    image: np.ndarray, rect: Rect, cell_px: float, alpha: float, beta: float, threshold: float, matrix: str,
    key: int,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float32 linear. image : (h, w, 3) linear, the object toon-shaded already."""
    coded = SRGB.encode(np.clip(image, 0, 1)).astype(np.float32)
    sites = jittered_sites(rect, cell_px, key)
    number, count = merged_by_colour(coded, label(sites, rect).first, sites, rect)
    out = means(image, number, count)[number]
    out[printed_edges(coded, alpha, beta, matrix) > threshold] = 0
    return out
