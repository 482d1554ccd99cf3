"""Directions in which the reference's rays leave a surface, with the density of each and what it
reflects.

Both kinds of surface answer the same two questions: `directions` draws some, `at` tells of any
direction what is reflected, and with which density `directions` takes it. So samples of bright
parts of the environment can be weighed against these (balance heuristic). Source: Heitz 2014
(Smith's G), 2018 (visible normals), Dupuy and Benyoub 2023 (drawn as caps of a ball); Veach and
Guibas 1995 (multiple importance sampling).
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide, normalise
from arfx.core.sampling import frame_about
from arfx.stages.gi.gloss import gloss_weights
from arfx.stages.light.surroundings import lobe_width

SMOOTHEST = 0.02  # roughness: what is smoother is as good as a mirror
NEAR = 1.3  # radii: from nearer a ball fills so much that the plane's own directions are better
ABOVE = 1e-5  # least cosine of a direction that leaves a surface


class Reflected(NamedTuple):
    """Of directions (k). total (k, 3) : share of their light that is scattered or mirrored, times
        the cosine
    density (k, 1) : per steradian with which they are drawn
    wide (k, 3) : as `Environment.radiance` takes it: 1 of what is scattered, the lobe's width of
        what is mirrored"""

    total: ndarray
    density: ndarray
    wide: ndarray


def dot(a: ndarray, b: ndarray) -> ndarray:
    """(k, 1) of vectors (k, 3)."""
    return np.asarray((a * b).sum(-1, keepdims=True))


def frames(normals: ndarray) -> ndarray:
    """(k, 3, 3) whose rows are two tangents and the unit normals (k, 3)."""
    return np.stack([*frame_about(normals), normals], 1)


def to_frame(frame: ndarray, vectors: ndarray) -> ndarray:
    """(k, 3) in frames (k, 3, 3)."""
    return np.einsum("kij,kj->ki", frame, vectors)


def from_frame(frame: ndarray, vectors: ndarray) -> ndarray:
    """(k, 3) from frames (k, 3, 3)."""
    return np.einsum("kij,ki->kj", frame, vectors)


def on_ball(height: ndarray, turn: ndarray) -> ndarray:
    """(k, 3) unit vectors by their height over the middle (k, 1), and part of a turn (k, 1).

    Of a height sqrt(1 - u), u even: directions as dense as the cosine (Malley)."""
    side = np.sqrt(np.maximum(1 - height**2, 0))
    phi = 2 * np.pi * turn
    return np.column_stack([side * np.cos(phi), side * np.sin(phi), height])


def schlick(f0: ndarray, cosine: ndarray) -> ndarray:
    """Share that is mirrored at a cosine (k, 1), by that seen from above (k, c); what mirrors
    nothing there never does."""
    grazing = (1 - cosine) ** 5
    share = f0 + (1 - f0) * grazing
    return np.where(f0 > 0, share, 0.0)


def smith(cosine: ndarray, a2: ndarray) -> ndarray:
    """(k, 1) the root in Smith's masking of GGX of width a."""
    return np.sqrt(a2 + (1 - a2) * cosine**2)


class MaterialLobes:
    """Lambert under GGX: the matt part gets what a dielectric does not mirror of even light. What
    single reflections lose, microfacets send on to each other, and the lobe gives it back (Turquin
    2019).

    normals, towards (k, 3) : unit, towards the viewer;  albedo (k, 3)
    metal, f0, roughness (k, 1)"""

    def __init__(
        self,
        normals: ndarray,
        towards: ndarray,
        albedo: ndarray,
        metal: ndarray,
        f0: ndarray,
        roughness: ndarray,
    ) -> None:
        self._frame = frames(normals)
        view = to_frame(self._frame, towards)
        # normals of a mesh may look away from what sees it
        view[:, 2] = np.maximum(view[:, 2], 1e-4)
        self._view = normalise(view)
        self._f0 = f0 + albedo * metal
        self._a = np.clip(roughness, SMOOTHEST, 1) ** 2
        self._width = lobe_width(roughness)
        cosine = self._view[:, 2:]
        even = gloss_weights(roughness[:, 0], cosine[:, 0])
        direct, grazing = (share[:, None] for share in even)
        lost = divide(1.0, direct + grazing) - 1
        self._returned = 1 + self._f0 * lost
        coat = (f0 * direct + (f0 > 0) * grazing) * (1 + f0 * lost)
        self._diffuse = albedo * (1 - metal) * (1 - np.minimum(coat, 1))
        most = schlick(self._f0, cosine).max(1, keepdims=True)
        # of a direction for the gloss
        self._chance = divide(most, most + self._diffuse.max(1, keepdims=True))

    def directions(self, numbers: ndarray) -> ndarray:
        """(k, 3) unit, from numbers (k, 3) in [0, 1)."""
        choice, u, v = numbers.T[:, :, None]
        h = self._visible_normals(u, v)
        mirrored = 2 * dot(self._view, h) * h - self._view
        scattered = on_ball(np.sqrt(1 - u), v)
        local = np.where(choice < self._chance, mirrored, scattered)
        return from_frame(self._frame, local)

    def at(self, directions: ndarray) -> Reflected:
        """Of unit directions (k, 3)."""
        d = to_frame(self._frame, directions)
        h = normalise(d + self._view)
        cos_light = np.maximum(d[:, 2:], ABOVE)
        cos_view = self._view[:, 2:]
        cos_half = h[:, 2:]
        a2 = self._a**2
        grazing = np.clip(dot(self._view, h), 0, 1)
        slope = cos_half**2 * (a2 - 1) + 1
        spread = divide(a2, np.pi * slope**2)
        seen = smith(cos_view, a2)
        lit = smith(cos_light, a2)
        # D G2 / (4 nv), G2 height-correlated; and D G1(v) / (4 nv)
        masked = cos_light * seen + cos_view * lit
        share = divide(spread * cos_light, 2 * masked)
        of_gloss = divide(spread, 2 * (cos_view + seen))
        mirrored = schlick(self._f0, grazing) * share * self._returned
        cosine = cos_light / np.pi
        scattered = self._diffuse * cosine
        total = scattered + mirrored
        density = cosine + self._chance * (of_gloss - cosine)
        above = d[:, 2:] > ABOVE
        wide = divide(scattered + self._width * mirrored, total)
        return Reflected(total * above, density * above, wide)

    def _visible_normals(self, u: ndarray, v: ndarray) -> ndarray:
        """(k, 3) normals of microfacets that the viewer sees, from numbers u, v (k, 1)."""
        shape = np.repeat(self._a, 3, axis=1)
        shape[:, 2] = 1
        # where the surface is stretched to a half ball, what mirrors the view is even over a cap
        stretched = normalise(self._view * shape)
        least = -stretched[:, 2:]
        h = (on_ball(1 + u * (least - 1), v) + stretched) * shape
        h[:, 2] = np.maximum(h[:, 2], 1e-9)
        return normalise(h)


class PlaneLobes:
    """White planes, for what the object changes of their light: directions into the cone that holds
    a ball around the object.

    About the normal where the ball is near; in half of the samples where what other planes lose or
    gain counts too (`all_around`). points, normals (k, 3);  centre (3,), radius : of the ball
    `directions`, `at` : as of `MaterialLobes`"""

    def __init__(
        self,
        points: ndarray,
        normals: ndarray,
        centre: ndarray,
        radius: float,
        all_around: bool,
    ) -> None:
        self._normals = normals
        self._frame = frames(normals)
        towards = centre - points
        away = np.linalg.norm(towards, axis=1, keepdims=True)
        self._axis = divide(towards, away)
        self._cone = frames(self._axis)
        far = away > NEAR * radius
        sine = divide(radius, away)
        # cosine of the cone's half-angle
        self._least = np.sqrt(1 - np.where(far, sine, 0) ** 2)
        self._chance = far * (0.5 if all_around else 1.0)

    def directions(self, numbers: ndarray) -> ndarray:
        choice, u, v = numbers.T[:, :, None]
        in_cone = from_frame(self._cone, on_ball(1 - u * (1 - self._least), v))
        about_normal = from_frame(self._frame, on_ball(np.sqrt(1 - u), v))
        return np.where(choice < self._chance, in_cone, about_normal)

    def at(self, directions: ndarray) -> Reflected:
        cosine = np.maximum(dot(self._normals, directions), 0) / np.pi
        solid_angle = 2 * np.pi * (1 - self._least)
        inside = dot(self._axis, directions) >= self._least - 1e-12
        in_cone = inside * divide(1.0, solid_angle)
        density = cosine + self._chance * (in_cone - cosine)
        scattered = np.repeat(cosine, 3, axis=1)
        return Reflected(scattered, density, np.ones_like(scattered))


Lobes = MaterialLobes | PlaneLobes
