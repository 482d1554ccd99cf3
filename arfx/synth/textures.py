"""Surfaces and surroundings: albedo pictures that depend on a seed only, with detail enough
for corners and optical flow; and panoramas as sets of directional lights, by median cut
(Debevec 2005).

Panoramas are equirectangular with the room's z up: the middle column looks along x, the
left half holds +y."""

import tomllib
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray
from numpy.random import Generator

from arfx.core.colour import SRGB
from arfx.core.marker_codes import marker_cells
from arfx.core.numerics import direction_of, normalise
from arfx.errors import InputError
from arfx.media.images import decode_picture
from arfx.synth.description import Marker, Texture

Shape = tuple[int, int]
_ROOMS = tomllib.loads(Path(__file__).with_name("rooms.toml").read_text("utf-8"))


def texture_albedo(
    texture: Texture,
    size_m: tuple[float, float],
    seed: int,
    folder: Path | None = None,
) -> ndarray:
    """(rows, columns, 3) float32 linear albedo 0..1 that covers size_m = (width, height),
    metres; row 0 is y's upper end. Raises InputError if a picture file cannot be read."""
    if texture.kind == "plain":
        return np.full((1, 1, 3), texture.colour, np.float32)
    if texture.kind == "image":
        if texture.file is None:
            raise InputError(
                "texture of kind 'image' names no file",
                'file = "picture.png", beside the scene file',
            )
        picture = decode_picture(
            (folder or Path()) / texture.file, "image", cv2.IMREAD_COLOR
        )
        return SRGB.decode(picture[..., ::-1] / np.float32(255))
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


def environment_picture(source: str | Path, folder: Path | None = None) -> ndarray:
    """(h, 2h, 3) float64 linear radiance. `source`: "studio", "sunset" or an .hdr file
    beside the scene. Raises InputError if the file cannot be read or holds values that are
    not finite and >= 0."""
    if (room := _ROOMS.get(str(source))) is not None:
        towards, _ = _directions(128, 256)
        up = towards[..., 2:]
        parts = np.dstack([up**0, (1 - np.abs(up)) ** 3, np.abs(up)])
        made = np.where(up > 0, *(parts @ np.array(half) for half in room["halves"]))
        for lamp in room["lamps"]:
            aside = towards @ normalise(np.array(lamp["towards"]))
            made[aside > np.cos(np.radians(lamp["radius_deg"]))] = lamp["rgb"]
        return made
    path = (folder or Path()) / source
    picture = decode_picture(path, "image", cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    rgb = picture[..., ::-1].astype(float)
    if not np.isfinite(rgb).all() or rgb.min() < 0:
        raise InputError(
            f"environment {path} holds values that are not finite and >= 0"
        )
    return cv2.resize(rgb, (256, 128), interpolation=cv2.INTER_AREA)


def _directions(h: int, w: int) -> tuple[ndarray, ndarray]:
    """Unit vectors (h, w, 3) of a panorama's pixels, and the solid angles (h, w) of these."""
    elevation = np.pi * (0.5 - (np.arange(h) + 0.5) / h)
    azimuth = 2 * np.pi * (0.5 - (np.arange(w) + 0.5) / w)
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    return direction_of(a, e), np.cos(e) * (np.pi / h) * (2 * np.pi / w)


def environment_lights(picture: ndarray, count: int) -> ndarray:
    """(count, 7) tracer lights that together light a surface as the panorama does.
    A region's radiance times its solid angle / pi is the rgb of its light (arfx.core.light
    folds pi in)."""
    h, w = picture.shape[:2]
    towards, solid = _directions(h, w)
    power = picture.mean(-1) * solid
    # of each pixel: direction by power, light, power, row
    light = picture * solid[..., None] / np.pi
    row = np.indices((h, w))[0]
    pixels = np.dstack([towards * power[..., None], light, power, row])
    regions = [pixels]
    while len(regions) < count:
        sizes = [r[..., 6].sum() if r[..., 6].size > 1 else -1.0 for r in regions]
        pick = int(np.argmax(sizes))
        if sizes[pick] <= 0:
            break
        region = regions.pop(pick)
        rows, columns, _ = region.shape
        middle = np.cos(np.pi * (0.5 - (region[0, 0, 7] + rows / 2) / h))
        axis = 0 if columns == 1 or rows > columns * 2 * h / w * middle else 1
        sums = region[..., 6].sum(1 - axis).cumsum()
        cut = np.clip(np.searchsorted(sums, sums[-1] / 2) + 1, 1, len(sums) - 1)
        regions += np.split(region, [int(cut)], axis)
    totals = [r.sum((0, 1)) for r in regions]
    lights = [[*normalise(t[:3]), *t[3:6], 0.0] for t in totals if t[:3].any()]
    return np.array(lights, float).reshape(-1, 7)
