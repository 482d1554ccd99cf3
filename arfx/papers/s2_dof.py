"""Depth of field by luminance and depth, as printed: Zhao et al. 2012.

The composited picture, coded as sRGB, is mean-filtered; every pixel takes the mean of its brighter neighbours, by how much
brighter they are (8); the result is blended with the sharp picture by the blur circle's share of the largest (9).
L, U : distances of a thing and of the focus;  F, N : focal length and f-number;  C : diameter of the circle, on the sensor.

Deviations. The sharp range, in which the blend counts by two thirds, is where the circle (7) is at most the permitted one;
printed are the limits (4) and (5), which disagree with (7). The smoothing around the border of that range (section 3.4) is
missing. The size of the mean filter is not stated: `mean_px`. A clip plane that is not set stands at the nearest or farthest
thing of the frame. The depth of the real scene is that of its planes, or measured. Its errors: docs/methods/dof.md#errata."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numba
import numpy as np

from arfx.core.colour import LUMA_COEFFICIENTS, SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.lens import Lens, Limits, checked
from arfx.core.numerics import divide
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, View
from arfx.errors import ConfigError, require_within
from arfx.stages.dof import Dof
from arfx.stages.dof.corrected import depth_range, object_box
from arfx.stages.dof.depth_layers import dioptre_of
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.surfaces import Real, plane_radius

INSIDE = 2 / 3  # of the blend, within the depth of field
_NEARER = 1.01  # a neighbour whose dioptre is larger by more than this factor stands in front


@dataclass(frozen=True)
class PrintedDofParams(DofParams):
    """near_m : nearest clip plane, where the blur counts fully; 0 = the nearest thing in the frame
    far_m : farthest clip plane; 0 = the farthest thing in the frame
    coc_mm : diameter of the largest blur circle that passes as sharp
    mean_px : side of the mean filter, odd"""

    formula: str = field(default="paper", init=False)
    near_m: float = 0.0
    far_m: float = 0.0
    coc_mm: float = 0.035
    mean_px: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("dof", self, near_m=(0, 1e6), far_m=(0, 1e6))
        if not 0 < self.coc_mm <= 1e3:
            raise ConfigError(f"dof.coc_mm must be above 0 and at most 1000, is {self.coc_mm:g}")
        if self.mean_px < 1 or self.mean_px % 2 == 0 or self.mean_px > 63:
            raise ConfigError(f"dof.mean_px must be odd, 1 to 63, is {self.mean_px}")


def printed_limits(lens: Lens, C: float) -> Limits:
    """(4) to (6), C in mm; None where (5) and (6) have a pole or are negative. Errors as `core.lens.depth_of_field`."""
    checked(lens, C)
    F, N, L = lens.focal_mm, lens.fnumber, lens.focus_mm
    return Limits(
        eq4_front(N, C, L, F), eq5_back(N, C, L, F), eq6_total(N, C, L, F), hyperfocal(N, C, F), lens.coc_at_infinity_mm
    )


def eq4_front(N: float, C: float, L: float, F: float) -> float:
    return N * C * L * L / (F**2 + N * C * L) if math.isfinite(N * C * L) else L


def eq5_back(N: float, C: float, L: float, F: float) -> float | None:
    return N * C * L * L / (F**2 - N * C * L) if N * C * L < F**2 else None


def eq6_total(N: float, C: float, L: float, F: float) -> float | None:
    """As printed: L in the denominator is not squared."""
    spread = F**4 - N**2 * C**2 * L if N * C * L < F**2 else 0.0
    return 2 * F**2 * N * C * L * L / spread if spread > 0 else None


def hyperfocal(N: float, C: float, F: float) -> float:
    """Where (5) has its pole."""
    return F / N * F / C


def eq7_circle(dioptre: np.ndarray | float, at: CircleOfConfusion) -> np.ndarray:
    """Diameter of the blur circle, mm, of what is at 1 / dioptre metres: C = F^2 |L - U| / ((U - F) N L)."""
    return at.px_per_dioptre * at.coc_mm_per_px * np.abs(at.focus - np.asarray(dioptre))


def blur_factor(dioptre: np.ndarray, clip: tuple[float, float], at: CircleOfConfusion, coc_mm: float) -> np.ndarray:
    """a = C / max(C_near, C_far), 0..1. clip : dioptres of both clip planes"""
    C = eq7_circle(dioptre, at)
    a = np.minimum(divide(C, max(float(eq7_circle(d, at)) for d in clip)), 1.0)
    return a * np.where(coc_mm >= C, INSIDE, 1.0)


def eq8_bleed(colour: np.ndarray, dioptre: np.ndarray) -> np.ndarray:
    """(h, w, 3): mean of the brighter ones among a pixel's eight neighbours, weighted by the luma that they have more;
    the pixel itself where none is brighter. Neighbours that stand in front of the pixel do not count."""
    kr, kb = LUMA_COEFFICIENTS["bt601"]
    luma = colour @ np.array([kr, 1 - kr - kb, kb], np.float32)
    return _bleed(np.ascontiguousarray(colour, np.float32), luma.astype(np.float32), dioptre)


@numba.njit(cache=True, nogil=True)
def _bleed(colour, luma, dioptre):  # pragma: no cover - compiled
    h, w = luma.shape
    out = colour.copy()
    for y in range(h):
        for x in range(w):
            total, red, green, blue = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for j in range(max(y - 1, 0), min(y + 2, h)):
                for i in range(max(x - 1, 0), min(x + 2, w)):
                    more = luma[j, i] - luma[y, x]
                    if more <= 0 or dioptre[j, i] > dioptre[y, x] * _NEARER:
                        continue
                    total += more
                    red += more * colour[j, i, 0]
                    green += more * colour[j, i, 1]
                    blue += more * colour[j, i, 2]
            if total > 0:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = red / total, green / total, blue / total
    return out


def eq9_blend(a: np.ndarray, blur: np.ndarray, original: np.ndarray) -> np.ndarray:
    return original + (blur - original) * a[..., None].astype(np.float32)


class PrintedDof(Dof):
    levels = ("standard",)
    Params = PrintedDofParams

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        """Where anything is blurred, every pixel that is not exactly in the focus changes."""
        asked = super().demand(facts, scene, frame)
        if asked.rect.empty:
            return asked
        return Demand(frame if self.params.scope == "all" else object_box(facts, frame, 0.0), asked.reason)

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        return out.pad(self.params.mean_px // 2 + 1).clip(scene.camera.rect)

    def run(self, view: View, prepared: np.ndarray) -> Mapping[Layer, Any]:
        facts, now, p = view.facts, view.layers, self.params
        image = now[Layer.IMAGE]
        if not facts.present or super().demand(facts, view.scene, view.scene.camera.rect).rect.empty:
            return {Layer.IMAGE: image.copy()}
        at, real = self._frame(facts, view.scene)
        dioptre = dioptres(now, facts, real, prepared)
        a = blur_factor(dioptre, self._clip_planes(facts, real, prepared), at, p.coc_mm)
        if p.scope == "virtual":
            a = a * (now[Layer.COVERAGE] > 0)
        coded = SRGB.encode(image).astype(np.float32)
        mean = cv2.blur(coded, (p.mean_px, p.mean_px), borderType=cv2.BORDER_REPLICATE)
        out = SRGB.decode(eq9_blend(a, eq8_bleed(mean, dioptre.astype(np.float32)), coded))
        return {Layer.IMAGE: np.where(a[..., None] > 0, out, image).astype(np.float32)}

    def _clip_planes(self, facts: FrameFacts, real: Real, grid: np.ndarray) -> tuple[float, float]:
        """Dioptres of the far and of the near clip plane."""
        low, high = real.dioptre_range(grid)
        if not facts.model_box.empty:
            near, far = depth_range(facts)
            low, high = min(low, 1 / far), max(high, 1 / near)
        p = self.params
        return 1 / p.far_m if p.far_m > 0 else low, 1 / p.near_m if p.near_m > 0 else high


def dioptres(now: Layers, facts: FrameFacts, real: Real, grid: np.ndarray) -> np.ndarray:
    """(h, w) 1/m of the composite: the object's where it covers half a pixel or more, else the real scene's."""
    rect = now.rect
    out = np.full((rect.height, rect.width), real.background, np.float32)
    if real.tiles is not None:
        out = dioptre_of(now[Layer.REAL_DEPTH])
    if real.base is not None:  # a radius of 1 px a dioptre from a focus at infinity is the dioptre itself
        one, zero, most = np.float32(1), np.float32(0), np.float32(np.inf)
        plane_radius(
            out, 0, rect.height, 0, rect.width, rect.x0, rect.y0, real.base.dioptres(grid), np.float32(real.background),
            (one, zero, most),
        )  # fmt: skip
    near, far = depth_range(facts)
    depth = np.clip(now[Layer.DEPTH], near, far)
    return np.where(now[Layer.COVERAGE] >= 0.5, divide(1.0, depth), out)
