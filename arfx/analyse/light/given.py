"""Light that the user gives: a direction, or a high dynamic range picture of the surroundings.

Axes are the anchor marker's: x right, y up the print, z out of it. Panoramas are equirectangular, z up: the middle column
looks along x, the left half holds +y.
"""

from __future__ import annotations

import cv2
import numpy as np

from arfx.core.light import DIFFUSE, DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import divide, normalise

ROWS = 64  # a panorama is reduced to: 2.8 degrees a pixel
STANDS_OUT = 6.0  # times the panorama's mean radiance from which a pixel belongs to a lamp
LEAST_SHARE = 0.1  # of all light that a lamp gives
AMBIENT, DIRECT = 0.45, 0.5  # radiance of a white surface without, and from a facing light, where only a direction is given


def towards(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """(3,) unit: azimuth from x towards y, elevation above the plane."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def from_direction(given: tuple[float, ...], size_deg: float) -> tuple[Light, bool]:
    """(light in anchor axes, whether its brightness is stated). given : azimuth, elevation, and perhaps R, G, B."""
    d = towards(given[0], given[1])
    rgb = given[2:] if len(given) == 5 else (DIRECT,) * 3
    lamp = DirectionalLight(triple(d), (rgb[0], rgb[1], rgb[2]), size_deg)
    return Light((AMBIENT,) * 3, (lamp,), "given"), len(given) == 5


def from_panorama(picture: np.ndarray) -> Light:
    """Light in anchor axes: up to two lamps that stand out, everything else as soft light.

    picture : (h, w, 3) linear radiance, finite and >= 0. rgb are those of core.light: radiance of a white surface.
    """
    small = cv2.resize(np.asarray(picture, np.float32), (2 * ROWS, ROWS), interpolation=cv2.INTER_AREA).astype(float)
    direction, solid = _grid()
    power = small.mean(-1) * solid
    lamps, rest = [], small.copy()
    out = (small.mean(-1) > STANDS_OUT * power.sum() / solid.sum()).astype(np.uint8)
    count, labels = _components(out)
    order = sorted(range(1, count), key=lambda k: -float(power[labels == k].sum()))
    for k in order[:2]:
        on = labels == k
        if power[on].sum() < LEAST_SHARE * power.sum():
            break
        base = np.median(small[~out.astype(bool)], axis=0) if (out == 0).any() else np.zeros(3)
        above = np.clip(small[on] - base, 0, None)
        d = normalise((direction[on] * power[on][:, None]).sum(0))
        facing = np.clip(direction[on] @ d, 0, None)
        rgb = (above * (solid[on] * facing)[:, None]).sum(0) / np.pi
        size = 2 * np.degrees(np.arccos(np.clip(1 - solid[on].sum() / (2 * np.pi), -1, 1)))
        lamps.append(DirectionalLight(triple(d), triple(rgb), float(min(size, 90.0))))
        rest[on] = np.minimum(small[on], base)
    basis = harmonics(direction.reshape(-1, 3)) * solid.reshape(-1, 1)
    soft = DIFFUSE[:, None] * (basis.T @ rest.reshape(-1, 3))  # of a white diffuse surface over its normal
    return Light.of_soft(soft, tuple(lamps), "environment file")


def fitted_to(light: Light, normals: np.ndarray, radiance: np.ndarray, keep_lamps: bool) -> Light:
    """The light, with white surfaces of `normals` as bright as measured, on average.

    normals : (k, 3), radiance : (k, 3) of white surfaces, axes of the light. keep_lamps : their brightness is stated, and
    what they leave is ambient light (none is left where they are brighter than what was measured); else all of the light
    is scaled, channel by channel.
    """
    n, want = np.atleast_2d(normals), np.atleast_2d(radiance).mean(0)
    if keep_lamps:
        lit = (light.radiance(n) - light.soft_radiance(n)).mean(0)
        return Light(triple(np.clip(want - lit, 0, None)), light.lights, light.source)
    factor = divide(want, light.radiance(n).mean(0), where_zero=1.0)
    return light.scaled(factor)


def _grid() -> tuple[np.ndarray, np.ndarray]:
    """((ROWS, 2 ROWS, 3) unit directions, (ROWS, 2 ROWS) steradians) of the reduced panorama's pixels."""
    elevation = np.pi / 2 - (np.arange(ROWS) + 0.5) / ROWS * np.pi
    azimuth = np.pi - (np.arange(2 * ROWS) + 0.5) / ROWS * np.pi
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    d = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    edges = np.sin(np.pi / 2 - np.arange(ROWS + 1) / ROWS * np.pi)
    solid = np.repeat(((edges[:-1] - edges[1:]) * np.pi / ROWS)[:, None], 2 * ROWS, 1)
    return d, solid


def _components(mask: np.ndarray) -> tuple[int, np.ndarray]:
    """Connected regions of a panorama, over its left and right edge: (count with background, (rows, columns) labels)."""
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    for row in range(len(mask)):
        a, b = labels[row, 0], labels[row, -1]
        if a and b and a != b:
            labels[labels == b] = a
    return count, labels
