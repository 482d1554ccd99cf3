"""A print as a light meter: robust means of a marker's black and white cells, or of a
pattern's dark and bright ones, in one frame, in linear light.

Samples lie on a grid inside every cell, away from its edges, read bilinearly (pixel centres
at integers). What biases a mean beyond its noise goes into its variance. `comparable` gives
a fit readings of one kind where prints are partly overexposed; `real_shadow` is what lies
on the anchor's print already, against the brightest quarter, which is taken for lit.
Source: Tan, Chen, Sun 2009, section 2.1; docs/methods/light.md#meter. Cost: about 2 ms for
a marker of 270 px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from arfx.analyse.light.photometry import LightReading, Photometry
from arfx.analyse.light.samples import PATCHES, SamplePoints, half_step, within
from arfx.core.facts import PlaneShadow
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import marker_cells
from arfx.core.numerics import divide

CLIP_LOW, CLIP_HIGH = 1.5e-4, 0.9955  # half an 8-bit step inside either end, sRGB
FEWEST = 4  # samples that make a patch
# share of a reading's paper samples that are clipped, from which the paper says nothing
# exact
OVEREXPOSED = 0.02
FEW = 0.15  # of the readings: so many spoilt ones can be left out
_OUT = 2.5  # deviations from the median of a reading's ink patches, beyond which one counts less
# of the brightest quarter's light; above it vignetting, a near lamp or gloss may be the
# reason
LEAST_LEFT = 0.7


@dataclass(frozen=True, eq=False)
class Patches:
    """One print in one frame. mean : (8, 3) linear RGB, 0 where count is 0
    variance : (8, 3) of that mean, noise and known biases;  count : (8,) samples used;
    clipped : (8,) share of all samples
    albedo : (8, 3) linear, None = a marker's ink and paper, by `WHITE`"""

    mean: np.ndarray
    variance: np.ndarray
    count: np.ndarray
    clipped: np.ndarray
    albedo: np.ndarray | None = None


WHITE = np.arange(PATCHES) >= PATCHES // 2
GRID, CHOSEN = (
    10,
    8,
)  # cells along a pattern's side; how many of a quarter's are its bright ones, and its dark ones
ROUGH = 4.0  # deviations within a cell by which it counts as less bright, or less dark
FINE = 8  # points of the albedo map along a cell's side
SOFT = (
    0.0,
    0.35,
    0.7,
    1.4,
)  # deviations, in these points, by which the map is blurred: one meter for each
DIM = 0.2  # albedo: a quarter of a pattern whose bright cells are darker tells no shadow


class Meter(NamedTuple):
    """Which cells of a print are read. cells : (n, n) int8, 1 bright, 0 dark, -1 not used;
    row 0 at the top, column 0 at the left
    of the print's corners_m;  albedo : as of `Patches`
    scale : (m, m, 3) float32 over the print, its patch's albedo over that of the place;
    None = all of a patch is alike
    """

    cells: np.ndarray
    albedo: np.ndarray | None = None
    scale: np.ndarray | None = None


def marker_meter(spec: MarkerSpec) -> Meter:
    return Meter(marker_cells(spec.family, spec.id).astype(np.int8))


def meter_for(meters: Sequence[Meter], side_px: float, blur_px: float) -> Meter:
    """The one of a print whose map is blurred as the print is in the frame, where its side
    is so long.
    """
    soft = np.array(SOFT[: len(meters)])
    return meters[int(np.abs(soft - blur_px * GRID * FINE / max(side_px, 1.0)).argmin())]


def pattern_meter(
    picture: np.ndarray, ink: float, paper: float, soft: float = 0.0
) -> Meter:
    """Of a print by its picture (h, w, 3), linear: in every quarter the brightest and the
    darkest cells, even ones first.

    Its white is the paper's albedo and its black the ink's. Between these printers differ:
    so the ends are read. A patch has the harmonic mean of its albedos, so that scaling what
    is seen to it leaves the camera's bias as it is."""
    size, half = GRID * FINE, GRID // 2
    seen = cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)
    seen = (
        cv2.GaussianBlur(seen, (0, 0), soft, borderType=cv2.BORDER_REPLICATE)
        if soft
        else seen
    )
    map_ = ink + (paper - ink) * seen.astype(float)
    split = map_.reshape(GRID, FINE, GRID, FINE, 3).transpose(
        0, 2, 1, 3, 4
    )  # (row, column, y, x, channel)
    grey = split.mean(-1)
    level, rough = grey.mean((2, 3)), ROUGH * grey.std((2, 3))
    inverse = (1 / split).mean((2, 3))
    chosen, albedo, scale = (
        np.full((GRID, GRID), -1, np.int8),
        np.zeros((PATCHES, 3)),
        np.ones((GRID, GRID, FINE, FINE, 3)),
    )
    for q in range(PATCHES // 2):
        rows, columns = (
            slice(q // 2 * half, (q // 2 + 1) * half),
            slice(q % 2 * half, (q % 2 + 1) * half),
        )
        order = np.argsort(level[rows, columns], axis=None, kind="stable")
        for white, part, sign in (
            (0, order[: half**2 // 2], -1),
            (1, order[half**2 // 2 :], 1),
        ):
            score = (sign * level - rough)[rows, columns].ravel()[part]
            at = np.unravel_index(
                part[np.argsort(-score, kind="stable")[:CHOSEN]], (half, half)
            )
            mean = 1 / inverse[rows, columns][at].mean(0)
            chosen[rows, columns][at], scale[rows, columns][at] = (
                white,
                mean / split[rows, columns][at],
            )
            albedo[PATCHES // 2 * white + q] = mean
    return Meter(
        chosen,
        albedo,
        scale.transpose(0, 2, 1, 3, 4).reshape(size, size, 3).astype(np.float32),
    )


def albedos(patches: Sequence[Patches], ink: float, paper: float) -> np.ndarray:
    """(t, 8, 3) linear albedo of every patch."""
    marker = np.repeat(np.where(WHITE, paper, ink)[:, None], 3, 1)
    return np.array([marker if p.albedo is None else p.albedo for p in patches]).reshape(
        -1, PATCHES, 3
    )


def reduced(
    pixels: np.ndarray, points: SamplePoints, albedo: np.ndarray | None = None
) -> Patches:
    """Patches of the samples.

    pixels : (4 k, 3) float32 linear RGB at `points.pixels()`;  albedo : of the Meter
    """
    four = pixels.reshape(-1, 4, 3)
    value = points.scale * np.einsum("kpc,kp->kc", four, points.weights)
    finite = np.isfinite(four).all((1, 2))
    clipped = finite & ((four <= CLIP_LOW) | (four >= CLIP_HIGH)).any((1, 2))
    usable = finite & ~clipped
    grey = value.mean(1)
    mean, spread, used = np.zeros((PATCHES, 3)), np.zeros((PATCHES, 3)), np.zeros(PATCHES)
    for g in range(PATCHES):
        mine = np.flatnonzero(usable & (points.group == g))
        mine = mine[within(grey[mine])]
        if len(mine) >= FEWEST:
            used[g] = len(mine)
            mean[g], spread[g] = value[mine].mean(0), value[mine].std(0, ddof=1)
    every = np.bincount(points.group, minlength=PATCHES)
    share = np.bincount(points.group, clipped, PATCHES) / np.maximum(every, 1)
    variance = _uncertainty(mean, spread, used, share, points)
    return Patches(mean, variance, used.astype(int), share, albedo)


def _uncertainty(
    mean: np.ndarray,
    spread: np.ndarray,
    used: np.ndarray,
    clipped: np.ndarray,
    points: SamplePoints,
) -> np.ndarray:
    """(8, 3) variances of the means: noise, rounding, the share that is cut off, and blur
    from the other cells.
    """
    bright, dark = (used > 0) & WHITE, (used > 0) & ~WHITE
    contrast = np.abs(mean).max(0)
    if bright.any() and dark.any():
        contrast = mean[bright].mean(0) - mean[dark].mean(0)
    lost = np.interp(clipped, np.linspace(0, 1, 257), _cut_offs())[:, None]
    step = 2 * half_step(mean)
    # rounding's error is spread over its step, and is dithered away as the noise's
    # characteristic function says
    dithered = np.exp(-4 * np.pi**2 * np.minimum((spread / step) ** 2, 2))
    out = spread**2 / np.maximum(used / points.shared, 1e-9)[:, None]
    out += step**2 / 12 * dithered + (lost * spread) ** 2 + (points.leak * contrast) ** 2
    return np.where(used[:, None] > 0, out, 0)


def cut_off(fraction: np.ndarray) -> np.ndarray:
    """Deviation, over that of one sample, that a mean gets where a share of its samples was
    clipped and dropped.

    For a normal distribution that is cut off at one end its mean is off by a third of this;
    but samples are not spread normally, and the error is the same in every frame. So the
    print's other colour decides where one is partly clipped."""
    from scipy.special import ndtri

    p = np.clip(fraction, 0, 0.99)
    lost = np.exp(-(ndtri(np.maximum(p, 1e-9)) ** 2) / 2) / np.sqrt(2 * np.pi) / (1 - p)
    return np.where(p > 0, 3 * lost, 0.0)


@cache
def _cut_offs() -> np.ndarray:
    return cut_off(np.linspace(0, 1, 257))


def stack(patches: Sequence[Patches]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(intensity (t, 8, 3), variance (t, 8, 3), clipped (t, 8)) for photometry.solve; NaN
    where nothing was measured.
    """
    seen, clipped = (
        np.array([getattr(p, of) for p in patches]).reshape(-1, PATCHES)
        for of in ("count", "clipped")
    )
    intensity, variance = (
        np.where(
            seen[..., None] > 0,
            np.array([getattr(p, of) for p in patches]).reshape(-1, PATCHES, 3),
            np.nan,
        )
        for of in ("mean", "variance")
    )
    return intensity, variance, clipped


def comparable(
    p: Photometry,
    intensity: np.ndarray,
    variance: np.ndarray,
    clipped: np.ndarray,
    albedo: np.ndarray,
) -> LightReading | None:
    """Readings of one kind where p's are not, None = they are. Arguments as for `solve`.

    albedo : (t, p, 3)"""
    overexposed = p.seen & (clipped[:, WHITE].sum(1) > OVEREXPOSED * WHITE.sum())
    few = overexposed.sum() <= FEW * p.seen.sum()
    if not overexposed.any() or (few and not p.determined.all()):
        return None
    if few:
        return replace(p.reading, fit=p.seen & ~overexposed)
    # by the ink alone, as if all of it were of one
    albedo, variance = albedo[:, ~WHITE], variance[:, ~WHITE]
    scale = divide(albedo.mean((0, 1)), albedo)
    value, variance = (intensity[:, ~WHITE] - p.bias) * scale, variance * scale**2
    fine = np.isfinite(value) & np.isfinite(variance) & (variance > 0)
    middle = np.ma.median(np.ma.array(value, mask=~fine), axis=1).filled(0)
    value, variance = np.where(fine, value, 0), np.where(fine, variance, 1)
    off = np.abs(value - middle[:, None]) / np.sqrt(variance)
    w = fine / variance * np.minimum(1, divide(_OUT, off, where_zero=1.0))
    total = w.sum(1)
    y = divide((w * value).sum(1), total * p.ink)
    own = divide(1.0, total * p.ink**2) * p.misfit**2
    known = p.seen & (total * p.ink > 0).all(1)
    return LightReading(
        np.where(known[:, None], y, p.y), np.where(known[:, None], own, p.var_y_own), known
    )


def quadrant_radiance(patches: Patches, bias: np.ndarray) -> np.ndarray:
    """(4,) light of paper in the print's quadrants (top left, top right, bottom left,
    bottom right), NaN = not seen. bias : (3,) of the camera
    """
    light, seen = (patches.mean[WHITE] - bias).mean(-1), patches.count[WHITE] > 0
    if patches.albedo is not None:
        albedo = patches.albedo[WHITE].mean(-1)
        light, seen = light / np.maximum(albedo, DIM), seen & (albedo >= DIM)
    return np.where(seen, light, np.nan)


def clearly_shadowed(light: np.ndarray) -> bool:
    """Whether a quadrant is clearly darker than the brightest one; nothing is clear where
    one was not seen. light : (4,) of `quadrant_radiance`
    """
    return bool(0 < light.max() >= light.min() / LEAST_LEFT)


def real_shadow(light: np.ndarray, corners_m: np.ndarray) -> PlaneShadow | None:
    """The real shadow on the anchor's print, None where no quarter is clearly darker.

    light : (4,) of `quadrant_radiance`;  corners_m : (4, 3) of the print. Anchor axes: x
    right, y up.
    """
    if not clearly_shadowed(light):
        return None
    top_left, top_right, bottom_left, bottom_right = np.clip(
        divide(light, light.max()), 0, 1
    ).tolist()
    x, y, _ = corners_m.max(0).tolist()
    return PlaneShadow((-x, -y, x, y), ((bottom_left, bottom_right), (top_left, top_right)))
