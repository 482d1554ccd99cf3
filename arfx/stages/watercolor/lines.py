"""Lines: the printed measure of edges in RGB and Y'UV, as soft thin lines that hold still.

The measure is taken on a smoothed picture of half the size; only its ridges count (line width in
px), faded in between two thresholds, kept where a line is strong somewhere (hysteresis). Edges of
the virtual object also come from its coverage, normals and depth. Cost: O(pixels).
Source: Jia, Tang 2013, eq. 2-4; docs/methods/watercolor.md#edges."""

from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.colour import LUMA_COEFFICIENTS
from arfx.core.compiled import FAST, kernel
from arfx.core.numerics import divide, smoothstep
from arfx.core.parallel import parallel_rows

SMOOTH_PX = 3.0  # sigma of the smoothing before edges are detected, px of the picture
ALPHA = 0.5  # weight of U and V in the edges of Y'UV
BETA = 0.5  # weight of Y'UV in all edges
_RIDGE = 0.25  # fraction of a ridge from which a pixel belongs to a line
_CREASE = 0.95  # cosine between neighbouring normals below which a crease begins
_CREASE_SLOPE = 2.2  # a crease of 60 degrees counts as a whole edge
_JUMP = 0.03  # relative difference of depth from which an edge begins
_JUMP_SLOPE = 20.0
_OBJECT = 1.5  # strength of the object's own edges, in `high`
_F = np.float32


class Edges(NamedTuple):
    """On a grid of half the size, (h, w) float32 each.

    measure : as printed, coded value per px of that grid
    across_x, across_y : unit direction across the edge"""

    measure: ndarray
    across_x: ndarray
    across_y: ndarray


def yuv_matrix(name: str = "bt601") -> ndarray:
    """(3, 3) float64 analogue Y'UV of R'G'B': U = .492 (B' - Y'), V = .877 (R' - Y')."""
    red, blue = LUMA_COEFFICIENTS[name]
    y = np.array([red, 1 - red - blue, blue])
    u = 0.492 * (np.array([0.0, 0, 1]) - y)
    v = 0.877 * (np.array([1.0, 0, 0]) - y)
    return np.stack([y, u, v])


def measure_edges(
    image: ndarray,
    smooth_px: float = SMOOTH_PX,
    alpha: float = ALPHA,
    beta: float = BETA,
) -> Edges:
    """Edges of a picture (h, w, 3) float32 linear; the grid is (ceil(h / 2), ceil(w / 2)).

    smooth_px : sigma, px of the picture"""
    border = cv2.BORDER_REPLICATE
    odd_rows, odd_columns = image.shape[0] % 2, image.shape[1] % 2
    if odd_rows or odd_columns:
        image = cv2.copyMakeBorder(image, 0, odd_rows, 0, odd_columns, border)
    height, width = image.shape[0] // 2, image.shape[1] // 2
    # at half the size the mean of 2 x 2, as INTER_AREA's, in half its time
    half = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    half = half.reshape(height, width, 3)
    coded = np.sqrt(np.clip(half, 0, 1, out=half), out=half)  # near to coded values
    sigma = max(smooth_px / 2, 0.3)
    taps = 2 * int(np.ceil(3.3 * sigma)) + 1
    smooth = cv2.GaussianBlur(coded, (taps, taps), sigma, borderType=border)
    padded = cv2.copyMakeBorder(smooth, 1, 1, 1, 1, border)
    planes = np.stack(cv2.split(padded))
    edges = Edges(*np.empty((3, height, width), np.float32))
    channels = np.concatenate([np.eye(3), yuv_matrix()]).astype(np.float32)
    of_rgb, of_y, of_uv = (1 - beta) / 3, beta * (1 - alpha), beta * alpha / 2
    share = np.repeat([of_rgb, of_y, of_uv], [3, 1, 2]).astype(np.float32)

    measure_rows = partial(_measure_rows, planes, channels, share, edges)
    parallel_rows(measure_rows, height)
    return edges


@kernel(fastmath=FAST, error_model="numpy")
def _measure_rows(
    planes, channels, share, out, first, last
):  # pragma: no cover - compiled
    """Rows first ... last - 1, from central differences. planes (3, h + 2, w + 2) : R', G', B'

    channels (6, 3) : of R'G'B', these first;  share (6,) : of each in the measure"""
    half = _F(0.5)
    for y in range(first, last):
        for x in range(out.measure.shape[1]):
            rx = half * (planes[0, y + 1, x + 2] - planes[0, y + 1, x])
            gx = half * (planes[1, y + 1, x + 2] - planes[1, y + 1, x])
            bx = half * (planes[2, y + 1, x + 2] - planes[2, y + 1, x])
            ry = half * (planes[0, y + 2, x + 1] - planes[0, y, x + 1])
            gy = half * (planes[1, y + 2, x + 1] - planes[1, y, x + 1])
            by = half * (planes[2, y + 2, x + 1] - planes[2, y, x + 1])
            measure, most = _F(0), _F(1e-6)
            across_x, across_y = _F(0), _F(0)
            for k in range(6):
                dx = channels[k, 0] * rx + channels[k, 1] * gx + channels[k, 2] * bx
                dy = channels[k, 0] * ry + channels[k, 1] * gy + channels[k, 2] * by
                strength = np.sqrt(dx * dx + dy * dy)
                measure += share[k] * strength
                if k < 3 and strength > most:  # the strongest channel's direction
                    most, across_x, across_y = strength, dx, dy
            out.measure[y, x] = measure
            out.across_x[y, x] = across_x / most
            out.across_y[y, x] = across_y / most


def object_edges(
    coverage: ndarray, normal: ndarray, depth: ndarray, opacity: float
) -> ndarray:
    """(ceil(h / 2), ceil(w / 2)) float32, 0..1: silhouettes from coverage, creases, jumps of depth.

    coverage (h, w), normal (h, w, 3), depth (h, w) metres; a depth that is not finite is none
    """
    layers = coverage, normal, depth
    covered, normals, depths = (np.ascontiguousarray(a[::2, ::2]) for a in layers)
    edge = np.zeros(covered.shape, np.float32)
    # each pixel of the grid beside its neighbour below and on the right
    for axis in range(2):
        beside = np.minimum(
            np.arange(covered.shape[axis]) + 1, covered.shape[axis] - 1
        )
        other, other_depth = covered.take(beside, axis), depths.take(beside, axis)
        cosine = cv2.transform(normals * normals.take(beside, axis), np.ones((1, 3)))
        near, far = np.minimum(depths, other_depth), np.maximum(depths, other_depth)
        jump = divide(far, near) - 1  # at most 0 where a depth is none
        inner = np.fmax(
            _CREASE_SLOPE * (_CREASE - cosine), _JUMP_SLOPE * (jump - _JUMP)
        )
        both = np.minimum(covered, other)
        inner = np.where(both > 0, np.clip(inner, 0, 1) * both, 0)
        edge = np.maximum(edge, np.maximum(np.abs(covered - other), inner))
    return np.minimum(edge * opacity, 1).astype(np.float32)


def add_object_edges(
    edges: Edges, of_object: ndarray, column: int, row: int, high: float
) -> None:
    """Let edges of the object count as strong lines, across their own gradient.

    edges : changed from (column, row) on;  of_object : of `object_edges`;  high : `line_high`
    """
    rows = slice(row, row + of_object.shape[0])
    columns = slice(column, column + of_object.shape[1])
    measure, across_x, across_y = (a[rows, columns] for a in edges)
    strength = (_OBJECT * high) * of_object
    stronger = strength > measure
    gradient_x, gradient_y = (
        cv2.Sobel(of_object, -1, *axis, ksize=1, borderType=cv2.BORDER_REPLICATE)
        for axis in ((1, 0), (0, 1))
    )
    length = np.hypot(gradient_x, gradient_y)
    turned = stronger & (length > 1e-3)
    across_x[turned] = gradient_x[turned] / length[turned]
    across_y[turned] = gradient_y[turned] / length[turned]
    measure[stronger] = strength[stronger]


def trace_lines(edges: Edges, low: float, high: float, width_px: float) -> ndarray:
    """(h, w) float32 strength of lines, 0..1, on the grid of the edges.

    low, high : below low there is no line, a line that nowhere reaches high fades as a whole
    width_px : of a line, px of the picture"""
    strength = np.zeros(edges.measure.shape, np.float32)
    how = _F(max(width_px / 2, 0.75)), _F(low), _F(high), strength
    parallel_rows(partial(_trace_rows, edges, *how), len(strength))
    # hysteresis: a line is as strong as its strongest pixel
    line = strength > 0
    count, parts = cv2.connectedComponents(line.view(np.uint8), ltype=cv2.CV_32S)
    inside = np.flatnonzero(line)
    part = np.asarray(parts, np.int32).ravel()[inside]
    strongest = np.zeros(count, np.float32)
    np.maximum.at(strongest, part, edges.measure.ravel()[inside])
    fade = smoothstep((strongest - _F(low)) / _F(max(high - low, 1e-6)))
    strength.ravel()[inside] *= fade[part]
    return strength


@kernel(fastmath=FAST, error_model="numpy")
def _trace_rows(
    edges, offset, low, high, out, first, last
):  # pragma: no cover - compiled
    """Strength before hysteresis: where the measure is larger than `offset` px to both sides."""
    zero = _F(0)
    one = _F(1)
    three = _F(3)
    measure = edges.measure
    for y in range(first, last):
        for x in range(measure.shape[1]):
            here = measure[y, x]
            if here <= low:
                continue
            dx = edges.across_x[y, x] * offset
            dy = edges.across_y[y, x] * offset
            beside = max(
                _between(measure, x + dx, y + dy), _between(measure, x - dx, y - dy)
            )
            ridge = min(max(_F(0.8) + (here - beside) / (_F(0.35) * here), zero), one)
            if ridge > _F(_RIDGE):
                t = min((here - low) / max(high - low, _F(1e-6)), one)
                out[y, x] = ridge * t * t * (three - _F(2) * t)


@kernel(inline="always")
def _between(a, x, y):  # pragma: no cover - compiled
    """`a` at column x and row y, bilinear, its border beyond."""
    height, width = a.shape
    x = min(max(x, _F(0)), _F(width - 1))
    y = min(max(y, _F(0)), _F(height - 1))
    i = int(x)
    j = int(y)
    k = min(i + 1, width - 1)
    m = min(j + 1, height - 1)
    s = x - _F(i)
    t = y - _F(j)
    above = a[j, i] + s * (a[j, k] - a[j, i])
    below = a[m, i] + s * (a[m, k] - a[m, i])
    return above + t * (below - above)


def enlarge_lines(strength: ndarray, height: int, width: int) -> ndarray:
    """(height, width) of lines on a grid of half the size."""
    size = 2 * strength.shape[1], 2 * strength.shape[0]
    large = cv2.resize(strength, size, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(large[:height, :width])
