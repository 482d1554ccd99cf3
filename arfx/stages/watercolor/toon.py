"""Toon shading of the virtual object: three flat tones of its own colour under the clip's light, in the composited picture.

Above the first threshold of n . l the colour is kept, above the second it is scaled, else scaled more (.5, .2; 1, .4, .1).
Corrected: the steps are ramps a few degrees wide, so that they do not crawl, and only what comes from the light's side is
scaled: in soft light no side is black. Cost: O(covered pixels).
Source: docs/methods/watercolor.md#toon. Leaves out: highlights, shadows of the object on itself."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from arfx.core.light import Light
from arfx.core.parallel import parallel_rows

EVEN = 0.8  # fraction of the ambient light that is the same in all tones
RAMP = 0.06  # of n . l over which a step is spread
_FAST = {"contract", "nsz", "arcp"}


def toon_light(light: Light, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(direction (3,) unit towards the strongest light, radiance (3,) of a white surface that faces it), WORLD frame.

    up : (3,) stands in for the direction where no light has one."""
    best, most = None, 0.0
    for li in light.lights:
        strength = float(np.sum(li.rgb))
        if li.unit.any() and np.isfinite(strength) and strength > most:
            best, most = li.unit, strength
    if best is None:
        soft = np.asarray(light.soft, float).reshape(-1, 3)
        slope = soft[[3, 1, 2]].sum(1) if len(soft) == 9 else np.zeros(3)  # harmonics x, y, z
        length = float(np.linalg.norm(slope))
        best = slope / length if length > 1e-6 else up
    return best, np.clip(light.radiance(best), 0, None)


class ObjectLayers(NamedTuple):
    """What toon shading reads of the object, by the names of the layers."""

    virtual: np.ndarray
    coverage: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    emissive: np.ndarray


class Tones(NamedTuple):
    """All float32. light (3,) : towards it;  direct, even (3,) : radiance of a white surface that faces it, of which `even` is in
    every tone;  at (2,), factors (3,) : of the tones;  opacity : of the object;  ramp : of n . l over which a step is spread"""

    light: np.ndarray
    direct: np.ndarray
    even: np.ndarray
    at: np.ndarray
    factors: np.ndarray
    opacity: np.float32
    ramp: np.float32

    @staticmethod
    def of(
        light: tuple[np.ndarray, np.ndarray],
        even: np.ndarray,
        thresholds: tuple[float, float],
        factors: tuple[float, float, float],
        opacity: float = 1.0,
    ) -> Tones:
        """light : of `toon_light`;  even : (3,) part of its radiance that every tone has"""
        (direction, radiance), f32 = light, np.float32
        direct, at = (radiance - even).astype(f32), np.array(thresholds, f32)
        return Tones(
            direction.astype(f32),
            direct,
            even.astype(f32),
            at,
            np.array(factors, f32),
            f32(opacity),
            f32(RAMP),
        )


def toon(
    image: np.ndarray,
    layers: ObjectLayers,
    tones: Tones,
    first: tuple[int, int] = (0, 0),
    every: int = 1,
) -> np.ndarray:
    """(h, w, 3) float32: `image`, in which VIRTUAL was composited, with the toon-shaded object in its place.

    first, every : (row, column) in the layers that the image's first pixel stands for; each stands for so many along x and y"""
    out: np.ndarray = image.copy()
    parallel_rows(lambda a, b: _toon(layers, tones, first, every, a, b, out), len(out))
    return out


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _toon(
    layers: ObjectLayers, tones: Tones, first, every, ya, yb, out
):  # pragma: no cover - compiled
    virtual, coverage, normal, albedo, emissive = layers
    light, direct, even, at, factors, opacity, ramp = tones
    zero, one = np.float32(0), np.float32(1)
    for j in range(ya, yb):
        for i in range(out.shape[1]):
            y, x = first[0] + every * j, first[1] + every * i
            cov = coverage[y, x]
            if cov <= zero:
                continue
            c = normal[y, x, 0] * light[0] + normal[y, x, 1] * light[1] + normal[y, x, 2] * light[2]
            if ramp > zero:
                high = min(max((c - at[0]) / ramp + np.float32(0.5), zero), one)
                low = min(max((c - at[1]) / ramp + np.float32(0.5), zero), one)
            else:
                high, low = (one if c > at[0] else zero), (one if c > at[1] else zero)
            tone = factors[2] + low * (factors[1] - factors[2]) + high * (factors[0] - factors[1])
            for k in range(3):
                flat = cov * (albedo[y, x, k] * (even[k] + direct[k] * tone) + emissive[y, x, k])
                out[j, i, k] = max(out[j, i, k] + opacity * (flat - virtual[y, x, k]), zero)
    return out
