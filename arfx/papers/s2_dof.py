"""Depth of field by luminance and depth, as printed: sections 3.2 to 3.4 of Zhao et al. 2012. The
lens: s2_lens.py.

The composited picture, coded as sRGB, is mean-filtered; every pixel takes the mean of its brighter
neighbours, by how much
brighter they are (8); the result is blended with the sharp picture by the blur circle's share of
the largest (9).
L, U : distances of a thing and of the focus;  F, N : focal length and f-number;  C : diameter of
    the circle, on the sensor.
Distances are kept as dioptres, 1/L: there (5) has no pole, and beyond the hyperfocal distance all
that is behind is sharp.

Deviations. Not stated, hence settings: the size of the mean filter (Figure 8's block holds 4 px
around its own, so at most 7 px
with (8)), and how the border of the depth of field is smoothed; here the factor 2/3 rises to 1
across it. A clip plane that is
not set stands at the nearest or farthest thing of the frame. The depth of the real scene is that
of its planes, or measured.
In front is what is nearer by more than 1 %, on one surface at a grazing angle too. While the
object fades in or out so does the
blur. Its errors: docs/methods/dof.md#errata."""

# mypy: disable-error-code="no-untyped-def"
from collections.abc import Callable, Mapping
from math import ceil, sqrt
from typing import Any

import cv2
import numpy as np
from numpy import ndarray
from pydantic import field_validator

from arfx.core.colour import SRGB, yuv_from_rgb
from arfx.core.compiled import kernel
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide, smoothstep
from arfx.core.parallel import parallel_rows
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.settings import Fraction, setting
from arfx.core.stage import Demand, View
from arfx.errors import ConfigError
from arfx.stages.dof import Dof
from arfx.stages.dof.depth_layers import dioptre_of
from arfx.stages.dof.layers import depth_range, object_box
from arfx.stages.dof.optics import CircleOfConfusion, focal_mm
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Real
from arfx.stages.viewing import between_nodes

INSIDE = 2 / 3  # of the blend, within the depth of field
_NEARER = np.float32(
    1.01
)  # what has a larger dioptre by more than this factor stands in front


class PrintedDofParams(DofParams):
    formula: str = "paper"
    near_m: float = setting(
        0.0,
        "nearest clip plane, where the blur counts fully; 0 = the nearest thing in the frame",
        ge=0,
        le=1e6,
    )
    far_m: float = setting(
        0.0, "farthest clip plane; 0 = the farthest thing in the frame", ge=0, le=1e6
    )
    coc_mm: float = setting(
        0.035,
        "diameter of the largest blur circle that passes as sharp",
        gt=0,
        le=1e3,
    )
    border: Fraction = setting(
        0.5,
        "how far the smoothed border reaches into the depth of field, and out of it, as a"
        " fraction of it; 0 = a hard step",
    )
    mean_px: int = setting(5, "side of the mean filter, odd", ge=1, le=63)

    @field_validator("mean_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ConfigError(f"must be odd, is {value}")
        return value


# 3.2 Depth and blur factor of every pixel


def eq7_circle(dioptre: ndarray | float, at: CircleOfConfusion) -> ndarray:
    """Diameter of the blur circle, mm, of what is at 1 / dioptre metres: C = F^2 |L - U| / ((U -
    F) N L)."""
    return (
        at.px_per_dioptre * at.coc_mm_per_px * np.abs(at.focus - np.asarray(dioptre))
    )


def blur_factor(
    dioptre: ndarray, clip: tuple[float, float], at: CircleOfConfusion
) -> ndarray:
    """a = C / max(C_near, C_far), 0..1. clip : dioptres of both clip planes"""
    largest = max(float(eq7_circle(d, at)) for d in clip)
    return np.minimum(eq7_circle(dioptre, at) * float(divide(1.0, largest)), 1.0)


def sharp_range(at: CircleOfConfusion, F: float, C: float) -> tuple[float, float]:
    """The limits U + (5) and U - (4) as dioptres, 1/m, farthest first: 1/U -+ N C / F^2, of which
    the first may be negative.
    F, C : mm"""
    focal_dioptre = (
        at.px_per_dioptre * at.coc_mm_per_px * (1 - min(1e-3 * F * at.focus, 1.0))
    )  # F^2 / N, by (7)
    reach = float(divide(C, focal_dioptre, where_zero=np.inf))
    return at.focus - reach, at.focus + reach


def dioptres(now: Layers, facts: FrameFacts, real: Real, grid: ndarray) -> ndarray:
    """(h, w) 1/m of the composite: the object's where it covers half a pixel or more, else the
    real scene's."""
    rect = now.rect
    out = real.dioptres(grid, rect)
    if real.tiles is not None:
        out = dioptre_of(now[Layer.REAL_DEPTH])
    for plane in real.finite_planes:
        positions = between_nodes(plane.positions(grid), rect)
        out = np.where(plane.within(positions), positions[..., 2], out)
    own = divide(1.0, np.clip(now[Layer.DEPTH], *depth_range(facts)))
    return np.where(now[Layer.COVERAGE] >= 0.5, own, out).astype(np.float32)


# 3.3 Blur by luminance. What stands in front of a pixel does not flow into it


def mean_filter(colour: ndarray, dioptre: ndarray, weights: ndarray) -> ndarray:
    """(h, w, 3): mean of each pixel's surroundings without what stands in front of it.
    weights : (n,) float32 of a row and of a column, n odd; equal ones = the mean"""
    weights = (weights / weights.sum()).astype(np.float32)
    out = cv2.sepFilter2D(
        colour, -1, weights, weights, borderType=cv2.BORDER_REPLICATE
    )
    nearest = cv2.dilate(dioptre, np.ones((len(weights), len(weights)), np.uint8))
    front = nearest > dioptre * _NEARER
    parallel_rows(
        lambda a, b: _mean_without_front(out, a, b, colour, dioptre, weights, front),
        len(out),
    )
    return out


@kernel()
def _mean_without_front(
    out, top, bottom, colour, dioptre, weights, front
):  # pragma: no cover - compiled
    h, w = dioptre.shape
    half = len(weights) // 2
    sums = np.zeros(4, np.float32)
    for y in range(top, bottom):
        for x in range(w):
            if not front[y, x]:
                continue
            sums[:] = 0
            for dy in range(-half, half + 1):
                j = min(max(y + dy, 0), h - 1)
                for dx in range(-half, half + 1):
                    i = min(max(x + dx, 0), w - 1)
                    if dioptre[j, i] > dioptre[y, x] * _NEARER:
                        continue
                    weight = weights[dy + half] * weights[dx + half]
                    sums[3] += weight
                    for c in range(3):
                        sums[c] += weight * colour[j, i, c]
            for c in range(3):
                out[y, x, c] = sums[c] / sums[3]


def eq8_bleed(colour: ndarray, dioptre: ndarray) -> ndarray:
    """(h, w, 3): mean of the brighter ones among a pixel's eight neighbours, weighted by the luma
    that they have more;
    the pixel itself where none is brighter."""
    luma = (colour @ yuv_from_rgb("bt601")[0].astype(np.float32)).astype(np.float32)
    colour = np.ascontiguousarray(colour, np.float32)
    out = colour.copy()
    parallel_rows(lambda a, b: _bleed(out, a, b, colour, luma, dioptre), len(out))
    return out


@kernel()
def _bleed(out, top, bottom, colour, luma, dioptre):  # pragma: no cover - compiled
    h, w = luma.shape
    sums = np.zeros(4, np.float32)
    for y in range(top, bottom):
        for x in range(w):
            sums[:] = 0
            for j in range(max(y - 1, 0), min(y + 2, h)):
                for i in range(max(x - 1, 0), min(x + 2, w)):
                    more = luma[j, i] - luma[y, x]
                    if more <= 0 or dioptre[j, i] > dioptre[y, x] * _NEARER:
                        continue
                    sums[3] += more
                    for c in range(3):
                        sums[c] += more * colour[j, i, c]
            if sums[3] > 0:
                for c in range(3):
                    out[y, x, c] = sums[c] / sums[3]


# 3.4 Blend


def within_depth_of_field(
    dioptre: ndarray, sharp: tuple[float, float], border: float
) -> ndarray:
    """By how much the blur factor counts: 2/3 within the limits `sharp`, 1 outside, smoothly
    between around them."""
    focus = 0.5 * (sharp[0] + sharp[1])
    reach = 0.5 * (sharp[1] - sharp[0])
    # 1 on both limits
    place = np.abs(dioptre - focus) / reach if np.isfinite(reach) else 0 * dioptre
    if border == 0:
        return np.where(place <= 1, INSIDE, 1.0)
    return INSIDE + (1 - INSIDE) * smoothstep(0.5 + (place - 1) / (2 * border))


def eq9_blend(a: ndarray, blur: ndarray, original: ndarray) -> ndarray:
    return original + (blur - original) * a[..., None].astype(np.float32)


def _blended(a: ndarray, blur: ndarray, coded: ndarray, image: ndarray) -> ndarray:
    """(9) in linear light; what is exactly in the focus stays bit for bit. image : `coded` in
    linear light"""
    return np.where(a[..., None] > 0, SRGB.decode(eq9_blend(a, blur, coded)), image)


def _by_rows(work: Callable[..., ndarray], *arrays: ndarray) -> ndarray:
    """work(arrays), a band of rows on each thread."""
    done = parallel_rows(
        lambda top, bottom: work(*(array[top:bottom] for array in arrays)),
        len(arrays[0]),
    )
    return np.concatenate(done).astype(np.float32, copy=False)


class PrintedDof(Dof):
    levels = ("standard",)
    Params = PrintedDofParams

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        """Where anything is blurred, every pixel that is not exactly in the focus changes."""
        asked = super().demand(facts, scene, frame)
        if asked.nothing:
            return asked
        whole = self.params.scope == "all"
        return asked._replace(rect=frame if whole else object_box(facts, frame, 0.0))

    @property
    def weights(self) -> ndarray:
        """Of the mean filter."""
        return np.ones(self.params.mean_px, np.float32)

    def blurred(self, colour: ndarray, dioptre: ndarray) -> ndarray:
        return eq8_bleed(mean_filter(colour, dioptre, self.weights), dioptre)

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        return out.pad(len(self.weights) // 2 + 1).clip(scene.camera.rect)

    def run(self, view: View, prepared: ndarray) -> Mapping[Layer, Any]:
        facts = view.facts
        now = view.layers
        image = now[Layer.IMAGE]
        asked = super().demand(facts, view.scene, view.scene.camera.rect)
        if asked.nothing or not facts.present:
            return {Layer.IMAGE: image.copy()}
        dioptre, a = self.depth_and_blur(now, facts, view.scene, prepared)
        coded = _by_rows(SRGB.encode, image)
        return {
            Layer.IMAGE: _by_rows(
                _blended, a, self.blurred(coded, dioptre), coded, image
            )
        }

    def depth_and_blur(
        self, now: Layers, facts: FrameFacts, scene: Scene, grid: ndarray
    ) -> tuple[ndarray, ndarray]:
        """What one texture of Figure 6 holds: (h, w) dioptre, 1/m, and factor of the blend. grid :
        what `prepare` made"""
        p, (at, real) = self.params, self._frame(facts, scene)
        dioptre = dioptres(now, facts, real, grid)
        sharp = sharp_range(at, focal_mm(p, facts, scene), p.coc_mm)
        a = blur_factor(dioptre, self._clip_planes(facts, real, grid), at)
        a = (
            a
            * within_depth_of_field(dioptre, sharp, p.border)
            * min(facts.opacity, 1.0)
        )
        return dioptre, a * (now[Layer.COVERAGE] > 0) if p.scope == "virtual" else a

    def _clip_planes(
        self, facts: FrameFacts, real: Real, grid: ndarray
    ) -> tuple[float, float]:
        """Dioptres of the far and of the near clip plane."""
        low, high = real.dioptre_range(grid)
        if not facts.model_box.empty:
            near, far = depth_range(facts)
            low = min(low, 1 / far)
            high = max(high, 1 / near)
        p = self.params
        return (
            1 / p.far_m if p.far_m > 0 else low,
            1 / p.near_m if p.near_m > 0 else high,
        )


class GaussianDofParams(PrintedDofParams):
    """mean_px : side of the mean filter that has the Gaussian's standard deviation"""

    formula: str = "gaussian"


class GaussianDof(PrintedDof):
    """What Figure 12 holds against their own method in Figure 13: a Gaussian filter, which does not
    ask how bright the neighbours are. All else is the same: the figures differ by (8) alone.

    Not stated is its size: it has the standard deviation of the mean filter."""

    Params = GaussianDofParams

    @property
    def weights(self) -> ndarray:
        variance = (self.params.mean_px**2 - 1) / 12  # of n even weights, px^2
        x = np.arange(-(reach := ceil(3 * sqrt(variance))), reach + 1)
        return np.exp(-(x**2) / (2 * max(variance, 1e-9))).astype(np.float32)

    def blurred(self, colour: ndarray, dioptre: ndarray) -> ndarray:
        return mean_filter(colour, dioptre, self.weights)
