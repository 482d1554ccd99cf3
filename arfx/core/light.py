"""The one light model that every effect shares: ambient and directional lights, any number."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray

from arfx.core.codec import Document, Unbounded
from arfx.core.numerics import normalise
from arfx.core.sampling import sphere

# Of the nine `harmonics`, in their order: what makes them orthonormal on the sphere.
_FIRST, _SECOND = 0.4886025119029199, 1.0925484305920792
_LAST = _SECOND, 0.31539156525252005, _SECOND, _SECOND / 2
HARMONIC_FACTORS = np.array([0.28209479177387814, *[_FIRST] * 3, _SECOND, *_LAST])
# Fraction of each degree of a radiance distribution that remains in the radiance of a white
# diffuse surface over its normal (Ramamoorthi and Hanrahan 2001, eq. 8, over pi), for the
# nine `harmonics`.
DIFFUSE = np.repeat([1.0, 2.0 / 3.0, 1.0 / 4.0], [1, 3, 5])


@dataclass(frozen=True, slots=True)
class DirectionalLight(Document):
    """direction : unit, WORLD frame, towards the light;  rgb : irradiance on a surface that
    faces it, such that a
    white diffuse surface shows radiance rgb (the factor pi is folded in);  angular_size_deg
    : full angle of its disc;
    confidence_deg : half-angle of its confidence cone, inf = not measured."""

    direction: tuple[float, float, float]
    rgb: tuple[float, float, float]
    angular_size_deg: float = 0.5
    confidence_deg: Unbounded = float("inf")

    @property
    def unit(self) -> ndarray:
        return normalise(np.asarray(self.direction, float))


@dataclass(frozen=True, slots=True)
class Light(Document):
    """ambient_rgb : radiance of a white diffuse surface without any directional light, mean
    over its normals
    soft : (9, 3) real spherical harmonics, WORLD frame, of that radiance over the normal
    (`soft_radiance`); empty = the
    same for every normal. source : what it was taken from ("default", "given", "marker",
    "environment", ...) Radiance is scene referred linear RGB as the camera codes it: gain
    and exposure are in it, its bias is not."""

    ambient_rgb: tuple[float, float, float] = (0.45, 0.45, 0.45)
    lights: tuple[DirectionalLight, ...] = field(
        default_factory=lambda: (
            DirectionalLight((0.35, 0.45, 0.82), (0.5, 0.5, 0.5), 20.0),
        )
    )
    source: str = "default"
    soft: tuple[tuple[float, float, float], ...] = ()

    def radiance(self, normals: ndarray) -> ndarray:
        """(..., 3) radiance of white diffuse surfaces with unit `normals` (..., 3), WORLD
        frame, nothing in the light's way.
        """
        n = np.asarray(normals, float)
        out = self.soft_radiance(n)
        for li in self.lights:
            out = out + np.clip(n @ li.unit, 0, None)[..., None] * np.asarray(
                li.rgb, float
            )
        return out

    def soft_radiance(self, normals: ndarray) -> ndarray:
        """(..., 3) the same without the directional lights; never below 0."""
        n = np.asarray(normals, float)
        if not self.soft:
            return np.broadcast_to(
                np.asarray(self.ambient_rgb, float), n.shape
            ).copy()
        return np.clip(harmonics(n) @ np.asarray(self.soft, float), 0, None)

    @property
    def mean_radiance(self) -> ndarray:
        """(3,) `radiance`, mean over all normals."""
        return (
            np.asarray(self.ambient_rgb, float)
            + sum((np.asarray(li.rgb, float) for li in self.lights), np.zeros(3)) / 4
        )

    def scaled(self, factor: ndarray) -> Light:
        """The light times a factor (3,), one per channel."""

        def times(rgb: tuple[float, float, float]) -> tuple[float, float, float]:
            return triple(np.multiply(rgb, factor))

        lights = tuple(replace(li, rgb=times(li.rgb)) for li in self.lights)
        soft = tuple(map(times, self.soft))
        return Light(times(self.ambient_rgb), lights, self.source, soft)

    def turned(self, rotation: ndarray) -> Light:
        """The light in other axes. rotation : (3, 3), to those from the light's."""
        lights = tuple(
            replace(li, direction=triple(np.asarray(rotation) @ li.unit))
            for li in self.lights
        )
        soft = turned_harmonics(np.array(self.soft), rotation) if self.soft else ()
        return replace(self, lights=lights, soft=tuple(map(triple, soft)))

    @staticmethod
    def of_soft(
        soft: ndarray, lights: tuple[DirectionalLight, ...], source: str
    ) -> Light:
        """A light whose ambient part is `soft` (9, 3), with its mean over all normals."""
        return Light(
            triple(soft[0] * HARMONIC_FACTORS[0]),
            lights,
            source,
            tuple(map(triple, soft)),
        )


def harmonics(n: ndarray) -> ndarray:
    """(..., 9) real spherical harmonics up to degree 2 of unit vectors (..., 3),
    orthonormal on the sphere.
    Order: 1; y, z, x; xy, yz, 3z^2 - 1, xz, x^2 - y^2 (Ramamoorthi and Hanrahan 2001, eq. 3).
    """
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    terms = (
        np.ones(x.shape),
        *(y, z, x),
        *(x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y),
    )
    return HARMONIC_FACTORS * np.stack(terms, -1)


def turned_harmonics(coefficients: ndarray, rotation: ndarray) -> ndarray:
    """(9, k) of `harmonics` in other axes; exact, as a rotation does not leave a degree.
    rotation : as in Light.turned
    """
    directions = sphere(24)  # by which all nine harmonics can be separated
    turned = harmonics(directions @ np.asarray(rotation)) @ coefficients
    return np.linalg.pinv(harmonics(directions)) @ turned


def triple(v: ndarray) -> tuple[float, float, float]:
    """(3,) as plain numbers."""
    return float(v[0]), float(v[1]), float(v[2])
