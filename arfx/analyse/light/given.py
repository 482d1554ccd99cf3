"""The light that the user gives, in the anchor marker's axes: x right, y up the print, z out
of it. A direction, or a high dynamic range picture of the surroundings: equirectangular, z up;
the middle column looks along x, the left half holds +y."""

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.light.surroundings import OUTSTANDING, from_panorama, soft_of
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import arccos, direction_of, normalise

ROWS = 64  # a panorama is reduced to: 2.8 degrees a pixel
LEAST_FRACTION = 0.1  # of all light that a lamp gives
# radiance of a white surface without, and from a facing light, where only a direction is given
AMBIENT, DIRECT = 0.45, 0.5


def light_from_direction(given: tuple[float, ...], size_deg: float) -> Light:
    """given : azimuth from x towards y and elevation above the plane, degrees, and perhaps R,
    G, B
    """
    direction = direction_of(*np.radians(given[:2]))
    rgb = np.array(given[2:] or [DIRECT] * 3)
    lamp = DirectionalLight(triple(direction), triple(rgb), size_deg)
    return Light((AMBIENT,) * 3, (lamp,), "given")


def light_from_panorama(picture: ndarray) -> Light:
    """Up to two lamps that stand out, everything else as soft light.

    picture : (h, w, 3) linear radiance, finite and >= 0. rgb are those of core.light:
    radiance of a white surface.
    """
    small = np.asarray(picture, np.float32)
    small = cv2.resize(small, (2 * ROWS, ROWS), interpolation=cv2.INTER_AREA).astype(
        float
    )
    middles = (np.arange(2 * ROWS) + 0.5) / ROWS * np.pi
    azimuth, elevation = np.meshgrid(np.pi - middles, np.pi / 2 - middles[:ROWS])
    direction = direction_of(azimuth, elevation)
    # steradians of the pixels
    solid = 2 * np.pi / ROWS * np.sin(np.pi / 2 / ROWS) * np.cos(elevation)
    power = small.mean(-1) * solid
    limit = OUTSTANDING * power.sum() / solid.sum()
    bright = small.mean(-1) > limit
    # the edge between left and right lies where nothing is bright, if it can
    dark = -int(bright.any(0).argmin())
    small, direction, power, bright = (
        np.roll(a, dark, 1) for a in (small, direction, power, bright)
    )
    count, labels = cv2.connectedComponents(bright.astype(np.uint8), connectivity=8)
    shares = np.bincount(labels.ravel(), power.ravel(), count) / max(
        power.sum(), 1e-300
    )
    lamps = []
    for k in 1 + np.argsort(-shares[1:], kind="stable")[:2]:
        if shares[k] < LEAST_FRACTION:
            break
        on = labels == k
        d = normalise(power[on] @ direction[on])
        arriving = solid[on] * np.clip(direction[on] @ d, 0, None) / np.pi
        rgb = arriving @ (small[on] * (1 - limit / small[on].mean(-1, keepdims=True)))
        size = 2 * np.degrees(arccos(1 - solid[on].sum() / (2 * np.pi)))
        lamps.append(DirectionalLight(triple(d), triple(rgb), float(min(size, 90.0))))
    soft = soft_of(from_panorama(picture), np.eye(3))
    return Light.of_soft(soft, tuple(lamps), "environment file")
