"""A picture without an object, painted in numpy by the formulas of
docs/methods/watercolor.md: labels by every pair of pixel and site, at several places in
every pixel, of which it shows the mean."""

from __future__ import annotations

from math import ceil

import numpy as np

from arfx.core.rect import Rect
from arfx.stages.watercolor.params import WatercolorParams
from arfx.stages.watercolor.pigment import paper_grain, wobble_tile
from arfx.stages.watercolor.sites import STEPS, Sites
from tests.reference.labels import nearest_two

Labelling = tuple[np.ndarray, np.ndarray, np.ndarray]


def painted(
    image: np.ndarray, sites: Sites, size_px: np.ndarray, flow: np.ndarray, lines: np.ndarray,
    params: WatercolorParams, seed: int, places: int,
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) float64 linear.

    image (h, w, 3) linear;  size_px, flow (n,) : of the cells at the sites
    lines (h, w) : their strength;  places : along a pixel's side"""
    along = (np.arange(places) + 0.5) / places - 0.5
    labellings = [
        labelled(sites, image.shape[:2], params, seed, (x, y))
        for y in along
        for x in along
    ]
    count = len(sites)
    area = sum(
        np.bincount(first.ravel(), minlength=count) for first, _, _ in labellings
    )
    total = np.zeros((count, 3))
    for c in range(3):
        weights = image[..., c].ravel().astype(float)
        total[:, c] = sum(
            np.bincount(first.ravel(), weights, count) for first, _, _ in labellings
        )
    mean = total / np.maximum(area, 1)[:, None]
    root = toned(washed(mean, sites, size_px, area / len(labellings), params), params)
    paper = paper_grain(seed)[: image.shape[0], : image.shape[1], None] * params.grain
    line = np.clip(lines[..., None] * (1 + 2.3 * paper), 0, 1) * params.lines
    out = np.zeros(image.shape)
    for labelling in labellings:
        paint = pigment(
            image, labelling, mean, root, params.flow * flow, paper, params
        )
        out += paint + line * (np.array(params.ink_rgb) - paint)
    return np.maximum(out / len(labellings), 0)


def labelled(
    sites: Sites,
    shape: tuple[int, int],
    params: WatercolorParams,
    seed: int,
    place: tuple[float, float],
) -> Labelling:
    """At one place in each pixel."""
    amplitude, (height, width) = params.wobble_px, shape
    moved = np.array(place)[:, None, None] * STEPS
    if amplitude > 0:
        tile = wobble_tile(seed, amplitude, place)
        moved = (
            moved
            + tile[
                :,
                np.arange(height)[:, None] % tile.shape[1],
                np.arange(width) % tile.shape[2],
            ]
        )
    return nearest_two(
        sites, Rect.of(width, height), np.broadcast_to(moved, (2, height, width))
    )


def washed(
    mean: np.ndarray,
    sites: Sites,
    size_px: np.ndarray,
    area: np.ndarray,
    params: WatercolorParams,
) -> np.ndarray:
    """(n, 3) square roots, alike neighbours drawn together over all pairs of sites."""
    root = np.sqrt(np.clip(mean, 0, 1))
    place = np.stack([sites.x, sites.y], -1) / STEPS
    apart = ((place[:, None] - place) ** 2).sum(-1)
    reach = 1.4 * np.minimum(size_px[:, None], size_px)
    share = np.clip(1 - apart / reach**2, 0, None) ** 2
    np.fill_diagonal(share, 0)
    weakest = np.sort(share, axis=1)[:, [-8]] if len(root) > 8 else 0
    share = np.where(share >= weakest, share, 0)
    share = share * (area / (area + 0.25 * max(np.median(area), 1)))
    contrast = 0.02 + 0.16 * params.wash
    for _ in range(ceil(8 * params.wash)):
        unlike = ((root[:, None] - root) ** 2).sum(-1)
        weight = share / (1 + unlike / contrast**2) ** 2
        root = (root + weight @ root) / (1 + weight.sum(1, keepdims=True))
    return root


def toned(root: np.ndarray, params: WatercolorParams) -> np.ndarray:
    thin = 1 - (1 - root) ** (1 + params.lightness)
    thin = params.deepest + (1 - params.deepest) * thin
    grey = (thin @ [0.2126, 0.7152, 0.0722])[:, None]
    return np.clip(grey + params.saturation * (thin - grey), 0, 1)


def pigment(
    image: np.ndarray, labelling: Labelling, mean: np.ndarray, root: np.ndarray, flow: np.ndarray, paper: np.ndarray,
    params: WatercolorParams,
) -> np.ndarray:  # fmt: skip
    """One painting: alike cells run into each other, unlike ones keep a border, darker
    towards it.
    """
    first, second, farther = labelling
    near = (
        np.clip(1 - farther / 3.0, 0, 1)[..., None] ** 2
    )  # borders are 1.5 px wide to each side
    own, other = root[first], root[second]
    apart = np.minimum(np.abs(other - own).sum(-1, keepdims=True) / 0.25, 1) ** 2
    step = mean[second] - mean[first]
    along = ((image - mean[first]) * step).sum(-1, keepdims=True) / (
        (step**2).sum(-1, keepdims=True) + 1e-9
    )
    like = np.clip(2 * (along - 0.5) + near / 2, 0, 1)
    mix = near / 2 * (1 - apart) + apart * np.minimum(3 * near, 1) * like
    colour = (own + mix * (other - own)) ** 2
    thickness = (
        flow[first][..., None] + near / 2 * (flow[second] - flow[first])[..., None]
    )
    thickness = (
        thickness + params.edge_darkening * apart * near * (1 - 0.3 * near**2) + paper
    )
    return colour * (1 - (1 - colour) * thickness)
