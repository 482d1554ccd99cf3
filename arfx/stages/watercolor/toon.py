"""Toon shading of the virtual object: three flat tones of its own colour under the clip's light.

Above the first threshold of n . l the colour is kept, above the second it is scaled, else scaled
more (.5, .2; 1, .4, .1). Corrected: the steps are ramps a few degrees wide, so that they do not
crawl; only what comes from the light's side is scaled: in soft light no side is black; and the
tones have the mean colour of the lit object.
Cost: O(covered pixels). Source: docs/methods/watercolor.md#toon. Leaves out: highlights, shadows of
the object on itself."""

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.light import Light
from arfx.core.numerics import divide

EVEN = 0.8  # fraction of the ambient light that is the same in all tones
RAMP = 0.06  # of n . l over which a step is spread
_GAINS = 0.5, 2.0  # least and most that tones are made darker and brighter


def toon_light(light: Light, up: ndarray) -> tuple[ndarray, ndarray]:
    """(direction (3,) unit towards the strongest light, radiance (3,) of a white surface that faces
    it), WORLD frame.

    up : (3,) stands in for the direction where no light has one."""
    lamps = [li for li in light.lights if li.unit.any() and 0 < sum(li.rgb) < np.inf]
    if lamps:
        best = max(lamps, key=lambda lamp: sum(lamp.rgb)).unit
    else:
        # harmonics x, y, z
        slope = (
            np.sum(light.soft, 1)[[3, 1, 2]] if len(light.soft) == 9 else np.zeros(3)
        )
        length = float(np.linalg.norm(slope))
        best = slope / length if length > 1e-6 else up
    return best, np.clip(light.radiance(best), 0, None)


def tones(
    cosine: ndarray,
    thresholds: tuple[float, float],
    factors: tuple[float, float, float],
    ramp: float = RAMP,
) -> ndarray:
    """Factor of the tone where the cosine between normal and light has these values.

    thresholds, factors : of the settings;  ramp : of the cosine over which a step is spread
    """
    out = np.full_like(cosine, factors[2])
    for k in (1, 0):
        above = cosine - thresholds[k]
        share = np.clip(above / ramp + 0.5, 0, 1) if ramp > 0 else above > 0
        out += share * (factors[k] - factors[k + 1])
    return out


def replace_lit(
    image: ndarray, lit: ndarray, flat: ndarray, opacity: float
) -> ndarray:
    """(h, w, 3) the image with flat tones in place of the lit object, that was composited at this
    opacity. They get the lit object's hue and brightness.

    lit, flat : (h, w, 3) float32 premultiplied. Tones share out the light that falls on the
    object; how much that is says the lit one, which also has its shadows and what it mirrors.
    """
    means = np.array(cv2.mean(lit)[:3]), np.array(cv2.mean(flat)[:3])
    gain = np.clip(divide(*means, where_zero=1.0), *_GAINS)
    change = cv2.transform(flat, np.diag(gain).astype(np.float32)) - lit
    change *= np.float32(opacity)
    change += image
    return np.maximum(change, 0, out=change)
