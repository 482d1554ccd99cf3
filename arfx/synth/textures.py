"""Procedural surfaces: albedo pictures that depend on a seed only. Detail enough for corners and optical flow."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np

from arfx.core.colour import SRGB
from arfx.core.marker import MarkerSpec, opencv_name
from arfx.errors import InputError
from arfx.media.images import decode_picture
from arfx.synth.description import Texture

_LIMIT = 1024  # texels along the longer side


def texture_albedo(texture: Texture, size_m: tuple[float, float], seed: int, folder: Path | None = None) -> np.ndarray:
    """(rows, columns, 3) float32 linear albedo 0..1 that covers size_m = (width, height), metres; row 0 is y's upper end.

    Raises InputError if a picture file cannot be read.
    """
    if texture.kind == "plain":
        return np.full((1, 1, 3), texture.colour, np.float32)
    if texture.kind == "image":
        return _picture(texture, folder)
    rng = np.random.default_rng([seed, zlib.crc32(texture.kind.encode())])
    long_m = max(size_m)
    texel = max(long_m / _LIMIT, texture.feature_m / 6)
    w, h = max(round(size_m[0] / texel), 2), max(round(size_m[1] / texel), 2)
    a, b = np.array(texture.colour, np.float32), np.array(texture.second, np.float32)
    cell = texture.feature_m / texel
    make = {"wood": _wood, "carpet": _carpet, "noise": _noise, "checker": _checker, "poster": _posters}[texture.kind]
    mix = make(rng, h, w, cell)
    if mix.ndim == 3:
        return np.clip(mix, 0.01, 0.95).astype(np.float32)
    return np.clip(a + (b - a) * mix[..., None], 0.01, 0.95).astype(np.float32)


def _picture(texture: Texture, folder: Path | None) -> np.ndarray:
    if texture.file is None:
        raise InputError("texture of kind 'image' names no file", 'file = "picture.png", beside the scene file')
    path = (folder or Path()) / texture.file
    picture = decode_picture(path, "image", cv2.IMREAD_COLOR)
    return SRGB.decode(picture[..., ::-1].astype(np.float32) / np.float32(255))


def _smooth(rng: np.random.Generator, h: int, w: int, cell_y: float, cell_x: float) -> np.ndarray:
    """Value noise 0..1 with features of that many texels."""
    grid = rng.random((max(int(h / cell_y) + 2, 2), max(int(w / cell_x) + 2, 2)), np.float32)
    return cv2.resize(grid, (w, h), interpolation=cv2.INTER_CUBIC)


def _octaves(rng: np.random.Generator, h: int, w: int, cell_y: float, cell_x: float, count: int = 4) -> np.ndarray:
    total, weight = np.zeros((h, w), np.float32), 0.0
    for k in range(count):
        total += _smooth(rng, h, w, max(cell_y / 2**k, 1), max(cell_x / 2**k, 1)) * 0.6**k
        weight += 0.6**k
    spread = (total - total.mean()) / max(float(total.std()), 1e-6)
    return np.clip(0.5 + 0.25 * spread, 0, 1)


def _noise(rng: np.random.Generator, h: int, w: int, cell: float) -> np.ndarray:
    return _octaves(rng, h, w, cell * 2, cell * 2)


def _carpet(rng: np.random.Generator, h: int, w: int, cell: float) -> np.ndarray:
    coarse = _octaves(rng, h, w, cell * 4, cell * 4, 3)
    tufts = _smooth(rng, h, w, max(cell / 2, 1), max(cell / 2, 1))
    return np.clip(0.5 * coarse + 0.5 * tufts, 0, 1)


def _checker(rng: np.random.Generator, h: int, w: int, cell: float) -> np.ndarray:
    y, x = np.indices((h, w))
    return ((x // cell + y // cell) % 2).astype(np.float32)


def _wood(rng: np.random.Generator, h: int, w: int, cell: float) -> np.ndarray:
    """Boards along x: grain stretched along the board, another tone and shift for each, dark joints."""
    board = max(cell * 5, 4)
    y = np.arange(h, dtype=np.float32)[:, None]
    number = np.minimum((y / board).astype(int), int(h / board))[:, 0]
    grain = np.zeros((h, w), np.float32)
    wave = _octaves(rng, h, w, cell, cell * 12, 4)
    fine = _smooth(rng, h, w, max(cell / 5, 1), cell * 3)
    tone = rng.random(int(h / board) + 2).astype(np.float32)
    shift = rng.integers(0, w, int(h / board) + 2)
    for n in range(int(number.max()) + 1):
        rows = np.flatnonzero(number == n)
        grain[rows] = np.roll(0.55 * wave[rows] + 0.25 * fine[rows], int(shift[n]), axis=1) + 0.3 * tone[n]
        if rows.size and n:
            grain[rows[0]] *= 0.35
        joint = int(shift[n]) % w
        grain[rows, joint] *= 0.4
    return np.clip(grain, 0, 1)


def _posters(rng: np.random.Generator, h: int, w: int, cell: float) -> np.ndarray:
    """A wall with coloured posters of rectangles, discs and lines: strong corners for flow."""
    base = 0.55 + 0.12 * (_octaves(rng, h, w, cell, cell, 3) - 0.5)
    wall = np.repeat(base[..., None], 3, axis=2).astype(np.float32)
    count = max(3, int(h * w / (cell * 14) ** 2))
    for _ in range(count):
        pw, ph = (int(cell * f) for f in rng.uniform(5, 11, 2))
        x, y = int(rng.integers(-pw // 2, w)), int(rng.integers(-ph // 2, h))
        cv2.rectangle(wall, (x, y), (x + pw, y + ph), rng.uniform(0.05, 0.9, 3).tolist(), -1)
        for _ in range(7):
            colour = rng.uniform(0.03, 0.9, 3).tolist()
            cx, cy = x + int(rng.integers(0, pw + 1)), y + int(rng.integers(0, ph + 1))
            r = max(int(cell * rng.uniform(0.3, 1.4)), 1)
            if rng.random() < 0.5:
                cv2.circle(wall, (cx, cy), r, colour, -1)
            else:
                cv2.rectangle(wall, (cx, cy), (cx + 2 * r, cy + r), colour, -1)
    return wall


def marker_cells(spec: MarkerSpec) -> np.ndarray:
    """(n, n) bool, True = paper, of a marker with its one-cell black border; row 0 is the print's top."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, opencv_name(spec.family)))
    side = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, spec.id, side, borderBits=1)) > 127


def sheet_albedo(
    spec: MarkerSpec, margin_cells: float, ink: float, paper: float, inverted: bool = False, right_ink: float | None = None
) -> tuple[np.ndarray, float]:
    """Albedo picture of the whole sheet and the sheet's side in metres.

    The margin is made exact by cutting every cell into a whole number of texels. right_ink : ink albedo at the right
    edge, growing linearly from `ink` at the left (worn print); None = even.
    Returns (rows, columns, 1) float64.
    """
    cells = marker_cells(spec)
    if inverted:
        cells = ~cells
    n = cells.shape[0]
    per_cell = 4  # a margin of quarters of a cell is exact; finer ones are rounded to it
    margin = round(margin_cells * per_cell)
    big = np.kron(cells, np.ones((per_cell, per_cell), bool))
    whole = np.pad(big, margin, constant_values=not inverted)
    ramp = np.linspace(ink, ink if right_ink is None else right_ink, whole.shape[1])
    albedo = np.where(whole, paper, ramp[None, :])
    return albedo[..., None], spec.size_m * whole.shape[0] / (n * per_cell)
