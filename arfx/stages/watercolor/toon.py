"""Toon shading of the virtual object: three flat tones of its own colour under the clip's light.

Above the first threshold of n . l the colour is kept, above the second it is scaled, else scaled
more (.5, .2; 1, .4, .1). Corrected: the steps are ramps a few degrees wide, so that they do not
crawl; only what comes from the light's side is scaled: in soft light no side is black; and the
tones have the mean colour of the lit object.
Cost: O(covered pixels). Source: docs/methods/watercolor.md#toon. Leaves out: highlights, shadows of
the object on itself."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numba
import numpy as np

from arfx.core.light import Light
from arfx.core.numerics import divide
from arfx.core.parallel import parallel_rows

EVEN = 0.8  # fraction of the ambient light that is the same in all tones
RAMP = 0.06  # of n . l over which a step is spread
_GAINS = 0.5, 2.0  # least and most that tones are made darker and brighter
_FAST = {"contract", "nsz", "arcp"}
_F = np.float32


def toon_light(light: Light, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(direction (3,) unit towards the strongest light, radiance (3,) of a white surface that faces
    it), WORLD frame.

    up : (3,) stands in for the direction where no light has one."""
    best = None
    most = 0.0
    for lamp in light.lights:
        strength = float(np.sum(lamp.rgb))
        if lamp.unit.any() and np.isfinite(strength) and strength > most:
            best = lamp.unit
            most = strength
    if best is None:
        soft = np.asarray(light.soft, float).reshape(-1, 3)
        slope = (
            soft[[3, 1, 2]].sum(1) if len(soft) == 9 else np.zeros(3)
        )  # harmonics x, y, z
        length = float(np.linalg.norm(slope))
        best = slope / length if length > 1e-6 else up
    return best, np.clip(light.radiance(best), 0, None)


class ObjectLayers(NamedTuple):
    """What toon shading reads of the object, by the names of the layers."""

    coverage: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    emissive: np.ndarray


class Tones(NamedTuple):
    """All float32. towards (3,) : the light
    direct, even (3,) : radiance of a white surface that faces it, of which `even` is in every tone
    thresholds (2,), factors (3,) : of the tones;  ramp : of n . l over which a step is spread
    """

    towards: np.ndarray
    direct: np.ndarray
    even: np.ndarray
    thresholds: np.ndarray
    factors: np.ndarray
    ramp: np.float32

    @staticmethod
    def of(
        light: tuple[np.ndarray, np.ndarray],
        even: np.ndarray,
        thresholds: tuple[float, float],
        factors: tuple[float, float, float],
        ramp: float = RAMP,
    ) -> Tones:
        """light : of `toon_light`;  even : (3,) part of its radiance that every tone has"""
        towards, radiance = light
        return Tones(
            towards.astype(_F),
            (radiance - even).astype(_F),
            even.astype(_F),
            np.array(thresholds, _F),
            np.array(factors, _F),
            _F(ramp),
        )


def flat_tones(layers: ObjectLayers, tones: Tones) -> np.ndarray:
    """(h, w, 3) float32: the toon-shaded object, premultiplied by its coverage as VIRTUAL is."""
    out = np.zeros(layers.albedo.shape, np.float32)
    parallel_rows(lambda a, b: _shade_rows(layers, tones, a, b, out), len(out))
    return out


def gain_to_lit(lit: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """(3,) float32 factor that gives flat tones the hue and brightness of the lit object.

    lit, flat : (h, w, 3) premultiplied. Tones share out the light that falls on the object; how
    much that is says the lit one, which also has its shadows and what it mirrors."""
    means = np.array(cv2.mean(lit)[:3]), np.array(cv2.mean(flat)[:3])
    return np.clip(divide(*means, where_zero=1.0), *_GAINS).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _shade_rows(
    layers: ObjectLayers, tones: Tones, first, last, out
):  # pragma: no cover - compiled
    coverage, normal, albedo, emissive = layers
    towards, direct, even, thresholds, factors, ramp = tones
    zero = _F(0)
    one = _F(1)
    half = _F(0.5)
    for y in range(first, last):
        for x in range(out.shape[1]):
            covered = coverage[y, x]
            if covered <= zero:
                continue
            cosine = _F(0)
            for c in range(3):
                cosine += normal[y, x, c] * towards[c]
            tone = factors[2]
            for k in (1, 0):
                above = cosine - thresholds[k]
                if ramp > zero:
                    share = min(max(above / ramp + half, zero), one)
                else:
                    share = one if above > zero else zero
                tone += share * (factors[k] - factors[k + 1])
            for c in range(3):
                lit = even[c] + direct[c] * tone
                out[y, x, c] = covered * (albedo[y, x, c] * lit + emissive[y, x, c])


def replace_lit(
    image: np.ndarray, lit: np.ndarray, flat: np.ndarray, opacity: float
) -> None:
    """Put flat tones in the place of the lit object, that was composited at this opacity.

    image (h, w, 3) : changed;  lit, flat (h, w, 3) float32 premultiplied"""
    gain = gain_to_lit(lit, flat)
    parallel_rows(
        lambda a, b: _replace_rows(lit, flat, gain, _F(opacity), a, b, image), len(flat)
    )


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _replace_rows(
    lit, flat, gain, opacity, first, last, out
):  # pragma: no cover - compiled
    for y in range(first, last):
        for x in range(out.shape[1]):
            for c in range(3):
                change = gain[c] * flat[y, x, c] - lit[y, x, c]
                out[y, x, c] = max(out[y, x, c] + opacity * change, _F(0))
