"""Straight edges along the sides of quads: light is sampled along 4 x 32 normals of each, a
robust line is laid through where it falls, and the corners are where the lines meet.

A Gaussian window keeps off what lies beside an edge: first about the side, then about the
line that was found, as wide as the edge's blur. All is sampled once more from there. n
quads are worked on as one array; no result depends on the others. Points are complex
numbers here, x + iy.
Source: docs/methods/pose.md#corners."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.rect import Rect

SAMPLES = 32  # normals per side
STEPS = 33  # samples along a normal
# Where along a side: its rounded and occluded ends are left out. Uneven, lest the samples
# keep step with the pixels that a slanted edge crosses (at a slope of 1 in 2 even ones
# every 2.2 px saw one phase of them all: .05 px of error became .02).
_EVEN = (np.arange(SAMPLES) + 0.5) / SAMPLES
FRACTIONS = 0.05 + 0.9 * (_EVEN + 0.15 * np.sin(2 * np.pi * _EVEN) / (2 * np.pi))
_LINE = np.stack([1 - FRACTIONS, FRACTIONS])  # of a line's values at its ends
_PRODUCTS = (_LINE.T[:, :, None] * _LINE.T[:, None]).reshape(SAMPLES, 4)
_RIDGE = 1e-9 * np.eye(2)
_NEXT, _BEFORE = [1, 2, 3, 0], [3, 0, 1, 2]  # of the corners, clockwise
_MIDDLES = (np.arange(1, STEPS) - STEPS / 2) / (STEPS / 2 - 0.5)
# A normal on which the edge is fainter than so much of the side's (its upper quartile)
# meets something that covers the print.
THERE = 0.5
_LINES = 2  # laid through the samples of one place
_ROUNDS = 2  # of a robust line, each with the weights of the one before
# Standard deviation of scatter over its mean size, under the weights of a robust line: 1.54
# for a Gaussian; more, as that between pixels is none (errors held against what is said of
# them: tests/unit/analyse/markers/test_aliasing.py).
_DEVIATION = 1.65
# Least standard deviation of the window: a narrower one sees the steps of the pixels in a
# sharp edge and is drawn towards them, by up to .13 px at .7 px. Noise gains nothing from a
# narrow window. Small cells need one: what is beyond is near.
WINDOW_PX = (0.7, 1.3)
WINDOW_FRACTION = 0.4  # of what is looked at to one side, between those two
_REMAP_STEPS = 32  # OpenCV reads between pixels at so many places per px


class Edges(NamedTuple):
    """Of n quads. quad : (n, 4, 2) px, the lines' corners; not finite where two are parallel

    gain : (n, 4) light of 255 that falls across each side;  spread : (n,) px along a side,
    median of sides;  blur, skew, inverted : (n,) as of Corners;  blurs : (n, 4) of each side
    """

    quad: ndarray
    gain: ndarray
    spread: ndarray
    blur: ndarray
    skew: ndarray
    inverted: ndarray
    blurs: ndarray


def find_edges(
    luma: ndarray,
    table: ndarray,
    start: ndarray,
    bend: ndarray,
    reaches: Sequence[ndarray],
) -> Edges:
    """Edges near quads.

    luma : (h, w) uint8;  table : (256,) float32 to light of 255;  start : (n, 4, 2) px
    bend : (n, 4, SAMPLES, 2) px off the chord;  reaches : (n, 4) px to either side of an edge,
    each time that it is sampled; the window is as of the last"""
    corners, off_chord = (a[..., 0] + 1j * a[..., 1] for a in (start, bend))
    least = np.clip(WINDOW_FRACTION * reaches[-1], *WINDOW_PX)
    weight = there = np.ones(bend.shape[:3])
    with np.errstate(all="ignore"):  # what is not finite is no edge
        for first, far in enumerate(reaches):
            fall, place = profiles(luma, table, corners, off_chord, far)
            inverted = fall.sum((1, 2, 3)) < 0
            fall[inverted] *= -1
            mean = np.einsum("ijst,ijs->ijt", fall, there)
            blurs, blur, skew = _shape(mean / there.sum(-1)[..., None], far)
            fit = np.minimum(np.maximum(1.2 * blur[:, None], least), far / 2)
            ends = np.zeros((*far.shape, 2))
            # a window of width w over an edge of width b sees only w2 / (w2 + b2) of a
            # displacement
            more = np.minimum(1 + (blur[:, None] / fit) ** 2, 3)
            for again in range(_LINES):
                new = first == again == 0  # nothing is known yet
                window, gain = (far / 2, 1.0) if new else (fit, more)
                line = ends @ _LINE
                away = place - line[..., None]
                inside = fall * np.exp(-0.5 * (away / window[..., None, None]) ** 2)
                own = inside.sum(-1)
                clear = np.sort(own, -1)[..., 3 * SAMPLES // 4]
                there = own >= THERE * clear[..., None]
                mass = (own * there).sum(-1) / there.sum(-1)
                seen = np.einsum("...t,...t->...", inside, away)
                seen *= (gain / mass)[..., None]
                most = far[..., None]
                off = np.clip(line + seen, -most, most)
                ends, spread, weight = _lines(off, there, weight)
            corners = _meeting(corners, ends)
    quad = np.stack([corners.real, corners.imag], -1)
    return Edges(quad, clear, _middle(spread), blur, skew, inverted, blurs)


def _middle(sides: ndarray) -> ndarray:
    """(n,) median of the values (n, 4) of four sides."""
    return np.sort(sides, -1)[:, 1:3].mean(-1)


def sampled(luma: ndarray, table: ndarray, places: ndarray) -> ndarray:
    """(m, k) linear light at places (m, k) complex64 px along lines; the border is
    replicated."""
    h, w = luma.shape
    ends = places[:, [0, -1]]
    part = Rect.around(np.stack([ends.real, ends.imag], -1), 1.0).clip(Rect.of(w, h))
    part = Rect.of(w, h) if part.empty else part
    xy = places - np.complex64(part.x0 + 1j * part.y0)
    light, border = cv2.LUT(luma[part.slices], table), cv2.BORDER_REPLICATE
    return cv2.remap(light, xy.real, xy.imag, cv2.INTER_LINEAR, borderMode=border)


def profiles(
    luma: ndarray,
    table: ndarray,
    corners: ndarray,
    off_chord: ndarray,
    far: ndarray,
) -> tuple[ndarray, ndarray]:
    """(n, 4, SAMPLES, STEPS - 1) how much darker it gets from sample to sample, inwards; and
    where, px from the chord.

    corners (n, 4), off_chord (n, 4, SAMPLES) : px;  far (n, 4) : px to either side"""
    chord = corners[:, _NEXT] - corners
    inwards = (1j * chord / np.abs(chord)).astype(np.complex64)[..., None, None]
    foot = corners[..., None] + FRACTIONS * chord[..., None] + off_chord
    along = (far[..., None] * np.linspace(-1, 1, STEPS)).astype(np.float32)[
        :, :, None
    ]
    wanted = foot.astype(np.complex64)[..., None] + along * inwards
    exact = np.round(wanted * _REMAP_STEPS) / _REMAP_STEPS
    along = along + ((exact - wanted) * inwards.conj()).real
    exact[~np.isfinite(exact)] = 0  # of a quad of which nothing will come
    quads = exact.reshape(len(corners), 4 * SAMPLES, STEPS)
    light = np.reshape([sampled(luma, table, at) for at in quads], along.shape)
    return light[..., :-1] - light[..., 1:], (along[..., :-1] + along[..., 1:]) / 2


def _lines(
    off: ndarray, there: ndarray, weight: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Robust lines (iterated, Geman-McClure) through samples off (n, 4, SAMPLES) that are
    there: values at their ends (n, 4, 2), spread px (n, 4), and the samples' weights."""
    weight = weight * there
    for _ in range(_ROUNDS):
        normal = (weight @ _PRODUCTS).reshape(*off.shape[:2], 2, 2) + _RIDGE
        ends = np.linalg.solve(normal, ((weight * off) @ _LINE.T)[..., None])[..., 0]
        missed = np.abs(off - ends @ _LINE)
        scale = _DEVIATION * (weight * missed).sum(-1) / weight.sum(-1) + 1e-3
        weight = there / (1 + (missed / (2.75 * scale[..., None])) ** 2) ** 2
    return ends, scale, weight


def _meeting(corners: ndarray, ends: ndarray) -> ndarray:
    """(n, 4) where the sides meet, moved inwards by ends (n, 4, 2)."""
    chord = corners[:, _NEXT] - corners
    inwards = 1j * chord / np.abs(chord)
    begin = corners + inwards * ends[..., 0]
    d = chord + inwards * (ends[..., 1] - ends[..., 0])
    before = d[:, _BEFORE].conj()  # of the side that ends here
    gap = begin[:, _BEFORE] - begin
    return begin + d * ((before * gap).imag / (before * d).imag)


def _shape(mean: ndarray, far: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Standard deviations px (n, 4) of the mean profiles (n, 4, STEPS - 1) of the sides, the
    narrowing by the window that they are seen through taken out; their median, and skew (n,).
    """
    place, most = far[..., None] * _MIDDLES, far**2
    second = moments(np.maximum(mean, 0) * np.exp(-2 * _MIDDLES**2), place)[0]
    variance = 1 / np.maximum(1 / second - 4 / most, 1 / most)
    variance = np.maximum(variance, 0.04)
    blur = np.sqrt(_middle(variance))
    near = np.exp(-0.5 * (place / (1.5 * blur[:, None, None])) ** 2)
    skew = moments(mean * near, place)[1].mean(-1) / blur**3
    return np.sqrt(variance), blur, skew


def moments(profile: ndarray, place: ndarray) -> tuple[ndarray, ndarray]:
    """Means of the square and of the cube of `place` about its mean, under profiles along the
    last axis."""
    profile = profile / profile.sum(-1, keepdims=True)
    away = place - (profile * place).sum(-1, keepdims=True)
    squares = profile * away * away
    return squares.sum(-1), (squares * away).sum(-1)
