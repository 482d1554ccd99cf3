"""A print as a light meter: robust means of a marker's black and white cells, or of a
pattern's dark and bright ones, in one frame, in linear light.

What biases a mean beyond its noise goes into its variance. `of_one_scale` reads overexposed
prints by their ink.
Source: Tan, Chen, Sun 2009, section 2.1; docs/methods/light.md#meter. Cost: about 1 ms for
a marker of 270 px.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.light.photometry import (
    UNKNOWN_VARIANCE,
    Photometry,
    bright_patches,
    weighted,
)
from arfx.analyse.light.samples import CellSamples, sample_cells
from arfx.analyse.light.shadow import clearly_shaded, light_at, quarters
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import marker_cells
from arfx.core.numerics import HALF_GREY, medians

# black top left, top right, bottom left, bottom right, then white in the same order
PATCHES = 8
WHITE = np.arange(PATCHES) >= PATCHES // 2
FEWEST = 4  # samples that make a patch
OUT = 3.5  # robust standard deviations beyond which a sample is no part of its patch
# share of a reading's paper samples that are clipped, from which the paper says nothing
# exact
OVEREXPOSED = 0.02
FEWEST_BOTH = (
    10  # readings that show ink and paper, to bring one to the other's scale
)
TELLS = 5.0  # deviations by which their light differs at least, for that
_GAMMA = 2.2  # about the slope of the transfer function
# cells along a pattern's side; how many of a quarter's are its bright ones, and its dark ones
GRID, CHOSEN = 10, 8
ROUGH = (
    4.0  # deviations within a cell by which it counts as less bright, or less dark
)
FINE = 8  # points of the albedo map along a cell's side
# deviations, in these points, by which the map is blurred: one meter for each
SOFT = (0.0, 0.35, 0.7, 1.4)
DIM = 0.2  # albedo: a quarter of a pattern whose bright cells are darker tells no shadow


@dataclass(frozen=True, eq=False)
class Patches:
    """One print in one frame. mean : (8, 3) linear RGB, 0 where count is 0
    variance : (8, 3) of that mean, noise and known biases;  count : (8,) samples used;
    clipped : (8,) share of all samples
    albedo : (8, 3) linear, None = a marker's ink and paper, by `WHITE`
    cells : (n, n) light of the bright ones, NaN = not known, where a shadow lies on a part of
    them; else None"""

    mean: ndarray
    variance: ndarray
    count: ndarray
    clipped: ndarray
    albedo: ndarray | None = None
    cells: ndarray | None = None


class Meter(NamedTuple):
    """Which cells of a print are read. cells : (n, n) int8, 1 bright, 0 dark, -1 not used;
    row 0 at the top, column 0 at the left
    of the print's corners_m;  albedo : as of `Patches`
    scale : (m, m, 3) float32 over the print, its patch's albedo over that of the place;
    None = all of a patch is alike
    """

    cells: ndarray
    albedo: ndarray | None = None
    scale: ndarray | None = None


def marker_meter(spec: MarkerSpec) -> Meter:
    return Meter(marker_cells(spec.family, spec.id).astype(np.int8))


def meter_for(meters: Sequence[Meter], side_px: float, blur_px: float) -> Meter:
    """The one of a print whose map is blurred as the print is in the frame, where its side
    is so long.
    """
    soft = np.array(SOFT[: len(meters)])
    return meters[
        int(np.abs(soft - blur_px * GRID * FINE / max(side_px, 1.0)).argmin())
    ]


def pattern_meter(
    picture: ndarray, ink: float, paper: float, soft: float = 0.0
) -> Meter:
    """Of a print by its picture (h, w, 3), linear: in every quarter the brightest and the
    darkest cells, even ones first.

    Its white is the paper's albedo and its black the ink's. Between these printers differ:
    so the ends are read. A patch has the harmonic mean of its albedos, so that scaling what
    is seen to it leaves the camera's bias as it is."""
    size, half = GRID * FINE, GRID // 2
    seen = cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)
    if soft:
        seen = cv2.GaussianBlur(seen, (0, 0), soft, borderType=cv2.BORDER_REPLICATE)
    map_ = ink + (paper - ink) * seen.astype(float)
    # by row and column of the cells: (row, column, point, point, channel)
    albedos = map_.reshape(GRID, FINE, GRID, FINE, 3).swapaxes(1, 2)
    grey = albedos.mean(-1)
    level, rough = grey.mean((2, 3)), ROUGH * grey.std((2, 3))
    cells, scale = np.full((GRID, GRID), -1, np.int8), np.ones(albedos.shape)
    albedo = np.zeros((PATCHES, 3))
    for quarter, corner in enumerate(np.ndindex(2, 2)):
        rows, columns = (
            np.indices((half, half)).reshape(2, -1) + half * np.array(corner)[:, None]
        )
        order = np.argsort(level[rows, columns], kind="stable")
        for white, some in enumerate(np.split(order, [half**2 // 2])):
            places = rows[some], columns[some]
            score = (2 * white - 1) * level[places] - rough[places]
            chosen = some[np.argsort(-score, kind="stable")[:CHOSEN]]
            best = rows[chosen], columns[chosen]
            mean = 1 / (1 / albedos[best]).mean((0, 1, 2))
            cells[best], scale[best] = white, mean / albedos[best]
            albedo[4 * white + quarter] = mean
    over = scale.swapaxes(1, 2).reshape(size, size, 3)
    return Meter(cells, albedo, over.astype(np.float32))


def read_print(
    linear: ndarray,
    quad_px: ndarray,
    meter: Meter,
    inverted: bool = False,
    blur_px: float = 0.0,
) -> Patches:
    """Patches of a print. inverted : white on black;  other arguments of `sample_cells`"""
    cells = 1 - meter.cells if inverted else meter.cells
    n = len(cells)
    seen = sample_cells(linear, np.asarray(quad_px, float), n, blur_px)
    if seen is None:
        none = np.zeros((PATCHES, 3))
        return Patches(none, none, np.zeros(PATCHES, int), none[:, 0], meter.albedo)
    value = seen.value
    if meter.scale is not None:
        x, y = cv2.split(seen.place * len(meter.scale) - 0.5)
        even = cv2.remap(
            meter.scale, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE
        )
        even = even.reshape(n, len(x) // n, n, -1, 3).swapaxes(1, 2)
        value = value * even.reshape(value.shape)
    low = np.arange(n) >= n / 2
    patch = np.where(cells < 0, PATCHES, 4 * cells + 2 * low[:, None] + low)
    usable = np.isfinite(value).all(-1) & ~seen.clipped
    mean, spread, count = _robust_means(value, usable, patch)
    cut, either = (
        np.bincount(patch.ravel(), of_cell.sum(-1).ravel(), PATCHES + 1)[:PATCHES]
        for of_cell in (seen.clipped, usable | seen.clipped)
    )
    clipped = cut / np.maximum(either, 1)
    variance = _uncertainty(mean, spread, count, clipped, seen)
    bright = usable & (cells == 1)[..., None]
    known = bright.sum(-1)
    light = np.where(bright, value.mean(-1), 0).sum(-1) / np.where(
        known, known, np.nan
    )
    if meter.albedo is not None:
        albedo = np.append(meter.albedo.mean(-1), 0)[patch]
        light = np.where(albedo < DIM, np.nan, light / np.maximum(albedo, DIM))
    shaded = light if clearly_shaded(light) else None
    return Patches(mean, variance, count, clipped, meter.albedo, shaded)


def standing(seen: Patches, place: ndarray) -> Patches:
    """What a shaded print shows where the object stands on it: its brightest quarter, as dark
    as that place is. place : of shadow.light_at"""
    known = (seen.count.reshape(2, -1) > 0).all(0)
    if seen.cells is None or not known.any():
        return seen
    light = np.where(known, quarters(seen.cells).ravel(), 0.0)
    left = light_at(seen.cells, place) / light.max()
    rows = PATCHES // 2 * WHITE + light.argmax()
    return replace(
        seen,
        mean=left * seen.mean[rows],
        variance=PATCHES / 2 * left**2 * seen.variance[rows],
        count=seen.count[rows],
        clipped=seen.clipped[rows],
        albedo=None if seen.albedo is None else seen.albedo[rows],
    )


def _robust_means(
    value: ndarray, usable: ndarray, patch: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """(mean, standard deviation (8, 3), samples (8,)) of the patches, 0 where they are few.

    value (n, n, m, 3), usable (n, n, m) : samples of each cell;  patch : (n, n)"""
    order = np.argsort(patch, axis=None, kind="stable")
    sizes = np.bincount(patch.ravel(), minlength=PATCHES + 1)[:PATCHES]
    place = np.arange(sizes.max())
    cell = order[
        np.minimum((np.cumsum(sizes) - sizes)[:, None] + place, len(order) - 1)
    ]
    inside = (place < sizes[:, None])[..., None]  # patches have few cells or many
    mine = value.reshape(-1, *value.shape[2:])[cell].reshape(PATCHES, -1, 3)
    kept = (usable.reshape(len(order), -1)[cell] & inside).reshape(PATCHES, -1)
    mine = np.where(kept[..., None], mine, 0.0)
    grey = mine.mean(-1)
    for _ in range(2):
        middle = medians(grey, kept)
        off = np.abs(grey - middle[:, None])
        most = np.maximum(1.4826 * medians(off, kept), _step(middle) / 2)
        kept &= off <= OUT * most[:, None]
    count = kept.sum(1)
    enough = (count >= FEWEST)[:, None]
    share = kept[..., None] / np.maximum(count, 1)[:, None, None]
    mean = (share * mine).sum(1)
    squares = (kept[..., None] * (mine - mean[:, None]) ** 2).sum(1)
    spread = np.sqrt(squares / np.maximum(count - 1, 1)[:, None])
    return enough * mean, enough * spread, np.where(enough[:, 0], count, 0)


def _step(level: ndarray | float) -> ndarray:
    """An 8-bit step in linear light, at a linear level."""
    slope = _GAMMA * np.maximum(level, 0) ** (1 - 1 / _GAMMA)
    return 2 * HALF_GREY * np.maximum(1 / 12.92, slope)


def _uncertainty(
    mean: ndarray,
    spread: ndarray,
    used: ndarray,
    clipped: ndarray,
    seen: CellSamples,
) -> ndarray:
    """(8, 3) variances of the means: noise, rounding, the share that is cut off, and blur
    from the other cells.
    """
    bright, dark = (used > 0) & WHITE, (used > 0) & ~WHITE
    contrast = np.abs(mean).max(0)
    if bright.any() and dark.any():
        contrast = mean[bright].mean(0) - mean[dark].mean(0)
    lost = cut_off(clipped)[:, None]
    step = _step(mean)
    # rounding's error is spread over its step, and is dithered away as the noise's
    # characteristic function says
    dithered = np.exp(-4 * np.pi**2 * np.minimum((spread / step) ** 2, 2))
    out = spread**2 / np.maximum(used / seen.shared, 1e-9)[:, None]
    out += (
        step**2 / 12 * dithered + (lost * spread) ** 2 + (seen.leak * contrast) ** 2
    )
    return np.where(used[:, None] > 0, out, 0)


def cut_off(fraction: ndarray) -> ndarray:
    """Deviation, over that of one sample, that a mean gets where a share of its samples was
    clipped and dropped.

    For a normal distribution that is cut off at one end its mean is off by a third of this;
    but samples are not spread normally, and the error is the same in every frame. So the
    print's other colour decides where one is partly clipped."""
    from scipy.special import ndtri

    p = np.clip(fraction, 0, 0.99)
    lost = (
        np.exp(-(ndtri(np.maximum(p, 1e-9)) ** 2) / 2) / np.sqrt(2 * np.pi) / (1 - p)
    )
    return np.where(p > 0, 3 * lost, 0.0)


def stack(
    patches: Sequence[Patches], ink: float, paper: float
) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """(intensity (t, 8, 3), variance (t, 8, 3), clipped (t, 8), albedo (t, 8, 3)) for
    photometry.solve; NaN where nothing was measured.
    """
    marker = np.repeat(np.where(WHITE, paper, ink)[:, None], 3, 1)
    colours = [
        np.where((p.count > 0)[:, None], [p.mean, p.variance], np.nan)
        for p in patches
    ]
    intensity, variance = np.reshape(colours, (-1, 2, PATCHES, 3)).swapaxes(0, 1)
    albedos = [marker if p.albedo is None else p.albedo for p in patches]
    clipped = np.reshape([p.clipped for p in patches], (-1, PATCHES))
    return intensity, variance, clipped, np.reshape(albedos, intensity.shape)


def of_one_scale(
    p: Photometry,
    intensity: ndarray,
    variance: ndarray,
    clipped: ndarray,
    albedo: ndarray,
) -> Photometry:
    """p, with overexposed readings by their ink. It is brought to the paper's scale, which ink
    of another albedo does not have, by the readings that show both; where they are too few
    or all alike, all are read by their ink. Arguments as for `solve`.

    albedo : (t, p, 3)"""
    overexposed = p.seen & (clipped[:, WHITE].sum(1) > OVEREXPOSED * WHITE.sum())
    if not overexposed.any():
        return p
    channels = weighted(intensity - p.bias, variance, albedo)
    ink = [bright_patches(grey, w * ~WHITE, rho, "") for grey, w, rho in channels]
    y, own = np.stack([part[:2] for part in ink], -1)
    known = p.seen & (own < UNKNOWN_VARIANCE).all(1)
    both = known & ~overexposed
    noise = p.misfit * np.sqrt(own[both].sum(0) / max(both.sum(), 1))
    if both.sum() >= FEWEST_BOTH and (y[both].std(0) > TELLS * noise).all():
        pairs = zip(y[both].T, p.y[both].T, strict=True)
        slope, offset = np.transpose([np.polyfit(*pair, 1) for pair in pairs])
        y, own, known = slope * y + offset, slope**2 * own, known & overexposed
    rows = known[:, None]
    return replace(
        p,
        y=np.where(rows, y, p.y),
        var_y_own=np.where(rows, own * p.misfit**2, p.var_y_own),
    )
