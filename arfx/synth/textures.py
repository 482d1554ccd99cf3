"""Surfaces: albedo pictures that depend on a seed only, with detail enough for corners and
optical flow."""

import zlib

import cv2
import numpy as np
from numpy import ndarray
from numpy.random import Generator

from arfx.core.marker_codes import marker_cells
from arfx.synth.description import Marker, Texture

Shape = tuple[int, int]


def texture_albedo(
    texture: Texture,
    size_m: tuple[float, float],
    seed: int,
) -> ndarray:
    """(rows, columns, 3) float32 linear albedo 0..1 that covers size_m = (width, height),
    metres; row 0 is y's upper end."""
    if texture.kind == "plain":
        return np.full((1, 1, 3), texture.colour, np.float32)
    rng = np.random.default_rng([seed, zlib.crc32(texture.kind.encode())])
    texel = max(max(size_m) / 1024, texture.feature_m / 6)
    w, h = (max(round(side / texel), 2) for side in size_m)
    shape, cell = (h, w), texture.feature_m / texel
    if texture.kind == "wood":
        mix = _wood(rng, shape, cell)
    elif texture.kind == "poster":
        mix = _posters(rng, shape, cell)
    elif texture.kind == "noise":
        mix = _octaves(rng, shape, cell * 2, cell * 2)
    elif texture.kind == "carpet":
        mix = np.clip(
            0.5 * _octaves(rng, shape, cell * 4, cell * 4, 3)
            + 0.5 * _smooth(rng, shape, cell / 2, cell / 2),
            0,
            1,
        )
    else:
        mix = np.asarray((np.indices(shape) // cell).sum(0) % 2, np.float32)
    if mix.ndim == 2:
        a, b = np.array([texture.colour, texture.second], np.float32)
        mix = a + (b - a) * mix[..., None]
    return np.clip(mix, 0.01, 0.95).astype(np.float32)


def _smooth(rng: Generator, shape: Shape, *cells: float) -> ndarray:
    """Value noise 0..1 with features of that many texels down and across, at least one."""
    size = [int(n / max(cell, 1)) + 2 for n, cell in zip(shape, cells, strict=True)]
    grid = rng.random(size, np.float32)
    return cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_CUBIC)


def _octaves(
    rng: Generator,
    shape: Shape,
    cell_y: float,
    cell_x: float,
    count: int = 4,
) -> ndarray:
    total = np.zeros(shape, np.float32)
    for k in range(count):
        total += _smooth(rng, shape, cell_y / 2**k, cell_x / 2**k) * 0.6**k
    spread = (total - total.mean()) / max(float(total.std()), 1e-6)
    return np.clip(0.5 + 0.25 * spread, 0, 1)


def _wood(rng: Generator, shape: Shape, cell: float) -> ndarray:
    """Boards along x: grain stretched along the board, another tone and shift for each,
    dark joints.
    """
    h, w = shape
    board = max(cell * 5, 4)
    number = (np.arange(h, dtype=np.float32) / board).astype(int)
    wave = _octaves(rng, shape, cell, cell * 12)
    fine = _smooth(rng, shape, cell / 5, cell * 3)
    boards = int(h / board) + 2
    tone = rng.random(boards).astype(np.float32)[number]
    shift = rng.integers(0, w, boards)[number]
    along = (np.arange(w) - shift[:, None]) % w
    grain = (
        np.take_along_axis(0.55 * wave + 0.25 * fine, along, 1) + 0.3 * tone[:, None]
    )
    grain[1:][np.diff(number) > 0] *= 0.35
    grain[np.arange(h), shift] *= 0.4
    return np.clip(grain, 0, 1)


def _posters(rng: Generator, shape: Shape, cell: float) -> ndarray:
    """A wall with coloured posters of rectangles, discs and lines: strong corners for flow."""
    h, w = shape
    base = 0.55 + 0.12 * (_octaves(rng, shape, cell, cell, 3) - 0.5)
    wall = np.repeat(base[..., None], 3, axis=2).astype(np.float32)
    for _ in range(max(3, int(h * w / (cell * 14) ** 2))):
        pw, ph = (int(cell * f) for f in rng.uniform(5, 11, 2))
        x, y = int(rng.integers(-pw // 2, w)), int(rng.integers(-ph // 2, h))
        cv2.rectangle(
            wall, (x, y), (x + pw, y + ph), rng.uniform(0.05, 0.9, 3).tolist(), -1
        )
        for _ in range(7):
            colour = rng.uniform(0.03, 0.9, 3).tolist()
            cx, cy = (
                x + int(rng.integers(0, pw + 1)),
                y + int(rng.integers(0, ph + 1)),
            )
            r = max(int(cell * rng.uniform(0.3, 1.4)), 1)
            if rng.random() < 0.5:
                cv2.circle(wall, (cx, cy), r, colour, -1)
            else:
                cv2.rectangle(wall, (cx, cy), (cx + 2 * r, cy + r), colour, -1)
    return wall


def sheet_albedo(
    marker: Marker, right_ink: float | None = None
) -> tuple[ndarray, float]:
    """Albedo picture of the whole sheet and the sheet's side in metres.
    The margin is made exact by cutting every cell into a whole number of texels. right_ink
    : ink albedo at the right edge, growing linearly from the marker's at the left (worn
    print); None = even. Returns (rows, columns, 1) float64."""
    cells = marker_cells(marker.spec.family, marker.spec.id) ^ marker.inverted
    texels = (
        4  # a margin of quarters of a cell is exact; finer ones are rounded to it
    )
    margin = round(marker.margin_cells * texels)
    big = np.kron(cells, np.ones((texels, texels), bool))
    white = np.pad(big, margin, constant_values=not marker.inverted)
    ink = np.linspace(
        marker.ink, marker.ink if right_ink is None else right_ink, len(white)
    )
    side_m = marker.spec.size_m * len(white) / len(big)
    return np.where(white, marker.paper, ink)[..., None], side_m
