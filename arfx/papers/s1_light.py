"""Light from a printed pattern, as printed: Tan, Chen, Sun 2009, equations (7) to (9), and
the light of a clip. (2) and (4) to (6) are in s1_gain, (3) in s1_lightmap.

The light x of each normal is folded into a map M (7), whose peaks are lights (9), as many
as there are. Nothing fills M where no marker faced: it begins at 0 and stays there.

Not printed, chosen here: M is kept at the middles of a hemisphere's triangles (figure 1)
and at the texels of a cube. One triangle's middle is the mean of all normals: a corner has
several triangles as near as each other, so that a single normal's light would be the same
in all, and (9) reject each for the others. Of equal neighbours the nearest to that mean
counts as the brighter. A light is as bright as M is at its peak, and what the print shows
beyond its lights is even light. Grazing views, clipped samples and prints in a real shadow
are left out as in the corrected method, since section 2.1 asks for a diffuse print.

Deviations. I_c, for which no value is printed, is a share of the brightest unless
`light.least_light` gives one. A light that is given, and clips in which no marker can be
read, are left to the corrected method. Its errors: docs/methods/light.md#errata."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import Analysis
from arfx.analyse.light.frames import Reading, with_light
from arfx.analyse.light.hypotheses import MEASURED, REFUSED
from arfx.analyse.light.photometry import UNKNOWN_VARIANCE, Photometry
from arfx.analyse.light.static_frame import Lights, StaticFrameLight
from arfx.analyse.light.surroundings import EnvironmentSample
from arfx.analyse.params import LightParams
from arfx.core.cube import CubeMap, face_directions
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import arccos, divide, normalise
from arfx.core.settings import Fraction, setting
from arfx.papers.s1_gain import brightness, gain_and_bias

CUBE = {
    2: 9,
    3: 17,
    4: 33,
    5: 49,
}  # side of a face by the map's level: odd, so that a texel lies on the axis
_EQUAL = 9  # decimals of the brightest, to which values are compared
BRIGHTNESS = "brightness"
UNUSED = (
    "most_lights",
    "claims",
)  # the paper knows nothing of them


class PrintedLightParams(LightParams):
    formula: str = "paper"
    albedos: Literal["brightness", "known"] = setting(
        BRIGHTNESS,
        "known (ink and paper hold), or brightness (each patch as bright as in the first"
        " picture of the print)",
    )
    map_level: int = setting(
        3,
        "resolution of the light map, 2 to 5 (16, 8, 4, 2 degrees between directions)",
        ge=2,
        le=5,
    )
    map_blur_rad: float = setting(
        0.2, "s of the light map's update (8)", ge=0.01, le=3
    )
    peak: Fraction = setting(
        0.8,
        "a light stands where the map is at least this share of its largest value"
        " (I_c of (9))",
    )
    least_light: float = setting(
        0.0,
        "I_c as a value, in place of the share: in units of the first picture's light, or"
        " with known albedos of the radiance of a white surface; 0 = the share",
        ge=0,
        le=1e6,
    )
    peak_apart_deg: float = setting(
        30.0,
        "and brighter than every other direction closer than this (epsilon of (9))",
        ge=1,
        le=180,
    )
    printed_bias: bool = setting(
        False, "b = 1/b' as printed, of a vector of length 1, in place of b'/g'"
    )

    @property
    def without_effect(self) -> list[str]:
        """Names of the settings that were set and change nothing here."""
        unused = (*UNUSED, *(("ink", "paper") if self.albedos == BRIGHTNESS else ()))
        changed = self.model_dump(exclude_defaults=True)
        return [name for name in unused if name in changed]


class Observation(NamedTuple):
    """The readings of one frame.

    normals : (k, 3) unit;  irradiance, variance : (k, 3); what is not finite is left out.
    """

    normals: ndarray
    irradiance: ndarray
    variance: ndarray

    @property
    def usable(self) -> Iterator[tuple[ndarray, ndarray]]:
        """(unit normal, irradiance) of the readings that are finite and known."""
        n = normalise(self.normals)
        x = self.irradiance
        v = self.variance
        fine = n.any(1) & (np.isfinite(x) & (v >= 0) & (v < UNKNOWN_VARIANCE)).all(1)
        return zip(n[fine], x[fine], strict=True)


def eq8_weight(cosine: ndarray, s: float) -> ndarray:
    """f(n) for n.n' = cosine: without the square of the angle, and with the condition
    cos(n.n') > 0, which always holds.
    """
    return np.where(
        np.cos(cosine) > 0, np.exp(-arccos(cosine) * (1 / (2 * s * s))), 0.0
    )


def squared_weight(cosine: ndarray, s: float) -> ndarray:
    """f(n) as meant: with the square of the angle, and nothing where n turns away from n'."""
    return np.where(cosine > 0, np.exp(-(arccos(cosine) ** 2) / (2 * s * s)), 0.0)


def eq7_update(M: ndarray, f: ndarray, x: ndarray) -> ndarray:
    """M_(t+1)(n) = (1 - f(n)) M_t(n) + f(n) x_(t+1). M (v, 3);  f (v,);  x (3,)"""
    return M + f[:, None] * (x - M)


@lru_cache(maxsize=4)
def triangles(level: int) -> ndarray:
    """(t, 3, 3) unit corners of an icosahedron's faces, cut into four `level` times."""
    from trimesh.creation import icosphere

    return np.asarray(icosphere(subdivisions=level).triangles)


@lru_cache(maxsize=4)
def hemisphere(level: int) -> ndarray:
    """(k, 3) figure 1: the middles of a hemisphere's triangles (z >= 0), each a direction
    in which a light may stand. One of them is z. Read-only."""
    middles = normalise(triangles(level).mean(1))
    n = middles @ upright(middles[-1]).T
    n = n[n[:, 2] >= 0]
    n.setflags(write=False)
    return n


def upright(up: ndarray) -> ndarray:
    """(3, 3) rotation that turns `up` into z."""
    across = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0.0, 1, 0])
    x = normalise(across - (across @ up) * up)
    return np.stack([x, np.cross(up, x), up])


class LightMap:
    """M (k, 3), in the hemisphere's axes.

    n (k, 3) : its normals, first those of `hemisphere`, then a cube's texels
    """

    def __init__(self, level: int, s: float) -> None:
        self.s, self.middles, self.size = s, hemisphere(level), CUBE[level]
        self.n = np.concatenate(
            [self.middles, face_directions(self.size).reshape(-1, 3)]
        )
        self.M = np.zeros(self.n.shape)

    def add(self, n: ndarray, x: ndarray) -> None:
        """The light x (3,) that a patch with normal n (3,) receives."""
        f = eq8_weight(
            self.n[:, 0] * n[0] + self.n[:, 1] * n[1] + self.n[:, 2] * n[2], self.s
        )
        self.M = eq7_update(self.M, f, x)

    @property
    def of_middles(self) -> ndarray:
        return self.M[: len(self.middles)]

    @property
    def cube(self) -> ndarray:
        """(6, n, n, 3)"""
        return self.M[len(self.middles) :].reshape(6, self.size, self.size, 3)


def eq9_lights(M: ndarray, n: ndarray, I_c: float, epsilon_deg: float) -> ndarray:
    """(m,) numbers of the directions in which lights stand, brightest first.

    M : (k, 3) or (k,) values at the directions n (k, 3);  I_c : of the channels' mean
    A light stands where M is at least I_c and brighter than in every other direction closer
    than epsilon_deg. Of equal values the one nearest to z counts as the brighter."""
    I_n = M.mean(-1) if M.ndim == 2 else M
    equal = np.round(divide(I_n, np.abs(I_n).max(initial=0)), _EQUAL)
    order = np.lexsort((-n[:, 2], -equal))
    rank = np.argsort(order)
    free = (I_n >= I_c) & (I_n > 0)
    lights = []
    for i in order:
        if free[i]:
            # not yet close to a brighter one: few are, and only theirs are compared with all
            near = n @ n[i] > np.cos(np.radians(epsilon_deg))
            if rank[near].min(initial=rank[i]) == rank[i]:
                lights.append(i)
            free &= ~near | (rank < rank[i])
    return np.array(lights, int)


def lights_of(
    seen: Sequence[Observation], params: PrintedLightParams
) -> tuple[list[Light], list[ndarray], ndarray]:
    """(one light per observation, and M as a cube (6, n, n, 3), (3, 3) rotation to the
    cube's axes from the normals').

    The hemisphere's axis is the mean of all normals."""
    turn = upright(normalise(np.concatenate([o.normals for o in seen]).sum(0)))
    map_ = LightMap(params.map_level, params.map_blur_rad)
    out = []
    cubes = []
    beyond = np.zeros(3)
    for o in seen:
        readings = [(turn @ n, x) for n, x in o.usable]
        for n, x in readings:
            map_.add(n, x)
        M = map_.of_middles
        I_c = params.least_light or params.peak * M.mean(1).max()
        peaks = eq9_lights(M, map_.middles, I_c, params.peak_apart_deg)
        towards = map_.middles[peaks]
        rgb = np.clip(M[peaks], 0, None)
        if readings:
            left = [x - np.clip(towards @ n, 0, None) @ rgb for n, x in readings]
            beyond = np.clip(np.mean(left, 0), 0, None)
        lights = tuple(
            DirectionalLight(triple(turn.T @ d), triple(c), 0.0)
            for d, c in zip(towards, rgb, strict=True)
        )
        out.append(Light(triple(beyond), lights, "marker"))
        cubes.append(map_.cube)
    return out, cubes, turn


class PrintedStaticFrameLight(StaticFrameLight):
    """maps : where M of each frame is put, WORLD axes; none where the light is given"""

    params: PrintedLightParams
    maps: dict[int, CubeMap]

    def from_markers(
        self, rests: bool, samples: Sequence[EnvironmentSample]
    ) -> tuple[Lights, dict[str, Any]]:
        """Each frame's light map and its peaks; frames without a reading have those before them."""
        if not self.lit:
            return super().from_markers(rests, samples)
        r = self.readings
        ends = np.searchsorted(r.frame, self.lit)[1:]
        rows = r.normal, r.radiance, r.variance
        seen = map(Observation, *(np.split(a, ends) for a in rows))
        solution, cubes, turn = lights_of([*seen], self.params)
        last = np.clip(
            np.searchsorted(self.lit, self.frames, side="right") - 1, 0, None
        )
        lights = {}
        for k, i in zip(self.frames, last, strict=True):
            lights[k] = solution[i]
            self.maps[k] = CubeMap.of(cubes[i], turn @ self.static_from_world[k])
        middle = solution[len(solution) // 2]
        count = len(middle.lights)
        peaks = (
            f"{count} peak{'s' * (count != 1)} of the light map,"
            " as printed: no confidence is known"
        )
        return lights, self.report(MEASURED if count else REFUSED, peaks, middle)


class PrintedLight:
    """The method under formula = "paper"."""

    Params = PrintedLightParams

    @staticmethod
    def with_light(
        clip: Analysis,
        readings: Sequence[Reading],
        samples: Sequence[EnvironmentSample],
        params: PrintedLightParams,
        panorama: ndarray | None,
    ) -> Analysis:
        """The clip with `light`, `bias_rgb` and `light_map`, as printed. Arguments as of
        frames.with_light"""
        maps: dict[int, CubeMap] = {}

        def printed_part(*of: Any) -> StaticFrameLight:
            part = PrintedStaticFrameLight(*of)
            part.maps = maps
            return part

        def solve(
            grey: ndarray,
            _: ndarray,
            __: ndarray,
            rho: ndarray,
            *more: Any,
        ) -> Photometry:
            # one kind of print, without colour
            if params.albedos == BRIGHTNESS and (rho == rho[:1, :, :1]).all():
                rho = brightness(grey)
            return gain_and_bias(grey, rho, params.printed_bias)

        clip = with_light(
            clip, readings, samples, params, panorama, solve, printed_part
        )
        unused = ", ".join(params.without_effect)
        notice = (
            f'light: {unused} without effect under formula = "paper"'
            if unused
            else None
        )
        facts = (f.with_(light_map=maps.get(k)) for k, f in enumerate(clip.facts))
        return clip.adding(facts, notice)
