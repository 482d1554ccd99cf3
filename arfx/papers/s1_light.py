"""Light from a printed pattern, as printed: Tan, Chen, Sun 2009, equations (2) and (4) to (9). (3) is in s1_lightmap.

A patch of albedo rho in light x shows I = g rho x + b (2). With g' = 1/g and b' every patch and frame is a row of a homogeneous
system (4) to (6), solved by the singular vector of the smallest singular value. The light x of each normal is folded into a map
M (7), whose peaks are lights (9).

Deviations. The albedos are those of ink and paper, not the patches' mean brightness. b is b'/g', what (2) gives; the printed
1/b' is `SmallestVector.bias_printed`. The two strongest peaks are lights, (9) keeps all; their brightness, which is not stated,
is M at the peak less the least M that was seen. Directions that no marker faced, where M stays 0, have the light of M's
harmonics. I_c is a share of the brightest, not a value. M is written beside its lights, so that the object can shade itself
from them. A light that is given, and clips in which no marker can be read, are left to the corrected fold.
Its errors: docs/methods/light.md#errata."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from arfx.analyse.fold import Analysis
from arfx.analyse.light.fit import MEASURED, REFUSED
from arfx.analyse.light.fold import LightOfMarkers, with_light
from arfx.analyse.light.icosphere import icosphere
from arfx.analyse.light.light_map import UNKNOWN, Observation
from arfx.analyse.light.photometry import INK, PAPER, Photometry, assemble, fallback, of_channels, weights
from arfx.analyse.light.static_frame import Lights, StaticFrameLight, light_report
from arfx.analyse.light.surroundings import EnvironmentSample
from arfx.analyse.params import LightParams
from arfx.core.cube import CubeMap, face_directions
from arfx.core.light import DirectionalLight, Light, harmonics, triple
from arfx.core.numerics import arccos, divide, normalise
from arfx.errors import require_within

DENSE = 300  # frames
LEAST_GAP = 3.0  # of the two smallest singular values: less is nullity 2 beside noise
NULL = 1e-10  # of the largest singular value: below it one counts as zero (1e-7 by the normal matrix)
CUBE = {2: 8, 3: 16, 4: 32, 5: 48}  # side of a face by the map's level
_SEEN = 1e4  # a vertex's variance over the least, up to which it was faced: weight 1 %
_RIDGE = 1e-3  # of the harmonics' own weight: directions that no marker faced say nothing


@dataclass(frozen=True)
class PrintedLightParams(LightParams):
    """peak : a light stands where the map exceeds this share of its largest value (I_c of (9))
    peak_apart_deg : and every other direction closer than this (epsilon of (9))"""

    formula: str = field(default="paper", init=False)
    peak: float = 0.8
    peak_apart_deg: float = 30.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("light", self, peak=(0, 1), peak_apart_deg=(1, 180))


@dataclass(frozen=True, eq=False)
class SmallestVector:
    """gain, bias : of the solution, g = 1/g' (free scale: the vector has length 1, g' > 0)

    bias : b'/g', in units of grey (what dividing (2) by g gives);  bias_printed : 1/b' (as printed)
    y : (t,) x_t / g', so that grey = rho y + bias;  nullity, rank : of the system;  smallest : its singular value
    condition : largest singular value over the smallest but one, the smallest being the solution's; at most 1e12
    gap : the smallest but one over the smallest, at most 1e12: near 1 where noise alone singles out the solution"""

    gain: float
    bias: float
    bias_printed: float
    y: np.ndarray
    nullity: int
    rank: int
    smallest: float
    condition: float
    gap: float


def eq6_smallest_vector(intensity: np.ndarray, albedo: np.ndarray, dense: int = DENSE) -> SmallestVector:
    """One channel. intensity : (t, p), NaN = not measured;  albedo : (p,) or (t, p). Frames without any patch get y = 0.

    Up to `dense` frames by singular value decomposition; beyond, by the normal matrix, whose x part is diagonal: its smallest
    eigenvalue is the smallest root of a secular equation in the 2 x 2 rest, O(frames x patches), and good to half as many
    digits. The vector is biased where I is noisy, and depends on the units of I.

    Raises ValueError where no patch is finite."""
    value = np.asarray(intensity, float)
    rho = np.broadcast_to(np.asarray(albedo, float), value.shape)
    valid = np.isfinite(value) & np.isfinite(rho)
    seen = valid.any(1)
    if not seen.any():
        raise ValueError("no finite intensity")
    grey, r, m = np.where(valid, value, 0)[seen], np.where(valid, rho, 0)[seen], valid[seen].astype(float)
    frames = len(grey)
    if frames <= dense:
        rows = np.zeros((grey.size, frames + 2))
        rows[:, 0], rows[:, 1] = -grey.ravel(), m.ravel()
        rows[np.arange(grey.size), 2 + np.repeat(np.arange(frames), grey.shape[1])] = r.ravel()
        _, s, vt = np.linalg.svd(rows, full_matrices=len(rows) < frames + 2)
        s = np.append(s, np.zeros(max(frames + 2 - len(s), 0)))
        v, smallest, null = vt[-1], float(s[-1]), NULL
    else:
        v, s = _secular(grey, r, m)
        smallest, null = float(s[-1]), 1e3 * NULL
    nullity = int((s <= null * s[0]).sum())
    v = v * (np.sign(v[0]) or 1.0)
    y = np.zeros(len(value))
    y[seen] = divide(v[2:], v[0])
    others = s[:-1]
    condition = min(float(divide(others[0], others[-1], where_zero=1e12)), 1e12)
    return SmallestVector(
        float(divide(1, v[0])), float(divide(v[1], v[0])), float(divide(1, v[1])), y, nullity, frames + 2 - nullity,
        smallest, condition, min(float(divide(others[-1], smallest, where_zero=1e12)), 1e12),
    )  # fmt: skip


def gain_and_bias(
    intensity: np.ndarray, white: np.ndarray | None = None, albedo: np.ndarray | None = None,
    clipped: np.ndarray | None = None, printed_bias: bool = False, ink: float = INK, paper: float = PAPER,
) -> Photometry:  # fmt: skip
    """(4) to (6) for all channels, arguments as in photometry.solve. No variances: the paper has none; those reported are of the
    residuals. printed_bias : b = 1/b' in place of b'/g' (y stays as solved)."""
    value = np.asarray(intensity, float)
    if albedo is None:
        albedo = np.where(np.asarray(white), paper, ink)
    every = of_channels(albedo, value.shape)
    w, _, ignored = weights(value, None, every)
    parts = []
    for c in range(3):
        grey, weight, rho = np.where(w[..., c] > 0, value[..., c], 0.0), w[..., c], every[..., c]
        if not weight.any():
            parts.append(fallback(grey, weight, rho, "no patch is usable: all are clipped, missing or not finite", 0, 1e12))
            continue
        solution = eq6_smallest_vector(np.where(weight > 0, grey, np.nan), rho)
        seen = weight.any(1)
        one = solution.nullity < 2
        why = "only noise singles out the solution" if one else f"the system has nullity {solution.nullity}, not 1"
        # g' = 0: b' and x alone, of one albedo
        blank = abs(solution.gain) > 1e8 * float(np.abs(grey).max()) or solution.gain == 0
        part = fallback(grey, weight, rho, why, solution.rank, solution.condition)
        if one and not blank and solution.gap > LEAST_GAP:
            b = solution.bias_printed if printed_bias else solution.bias
            residual = (grey - rho * solution.y[:, None] - solution.bias) * weight
            spread = float((residual**2).sum() / max((weight > 0).sum() - seen.sum() - 1, 1))
            own = np.where(seen, divide(spread, (weight * rho * rho).sum(1)), part["var_y_own"])
            part |= {
                "y": solution.y, "var_y_own": own, "bias": b, "bias_95": (b, b), "determined": True, "reason": "",
                "misfit": float(np.sqrt(spread)),
            }  # fmt: skip
        parts.append(part | {"unknowns": int(seen.sum()) + 2})
    share = float(np.mean(clipped)) if clipped is not None and np.size(clipped) else 0.0
    return assemble(parts, share, ignored)


def _secular(grey: np.ndarray, r: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(smallest singular vector (t + 2,), a few singular values, largest first, the two smallest last).

    The normal matrix is [[G, F], [F^T, D]] with G 2 x 2 and D diagonal. Below the smallest of D its eigenvalues are the
    roots of the eigenvalues of G - l - F (D - l)^-1 F^T, which fall with l."""
    G = np.array([[(grey * grey).sum(), -(grey * m).sum()], [-(grey * m).sum(), m.sum()]])
    F = np.stack([-(r * grey).sum(1), (r * m).sum(1)])
    D = (r * r).sum(1)

    def rest(low: float) -> np.ndarray:
        return G - low * np.eye(2) - (F / (D - low)) @ F.T

    end = float(D.min()) * (1 - 1e-9)
    roots = []
    for k in range(2):
        at = [float(np.linalg.eigvalsh(rest(low))[k]) for low in (0.0, end)]
        if at[0] <= 0:
            roots.append(0.0)
        elif at[1] < 0:
            roots.append(float(brentq(lambda low, k=k: np.linalg.eigvalsh(rest(low))[k], 0.0, end, xtol=1e-300, rtol=1e-14)))
        else:
            roots.append(end)
    vector = np.linalg.eigh(rest(roots[0]))[1][:, 0]
    v = np.concatenate([vector, -(F.T @ vector) / (D - roots[0])])
    largest = np.array([float(np.trace(G)) + float(D.sum())]) ** 0.5  # an upper bound
    return v / np.linalg.norm(v), np.append(largest, np.sqrt(np.maximum(roots[::-1], 0)))


def eq8_weight(cosine: np.ndarray, s: float) -> np.ndarray:
    """f(n) for n.n' = cosine: without the square of the angle, and with the condition cos(n.n') > 0, which always holds."""
    return np.where(np.cos(cosine) > 0, np.exp(-arccos(cosine) * (1 / (2 * s * s))), 0.0)


def eq7_update(M: np.ndarray, f: np.ndarray, x: np.ndarray) -> np.ndarray:
    """M_(t+1)(n) = (1 - f(n)) M_t(n) + f(n) x_(t+1). M (v, 3);  f (v,);  x (3,)"""
    return M + f[:, None] * (x - M)


class LightMap:
    """M (v, 3) at the vertices of an icosphere. doubt (v, 3) : least of the observations' variances over their squared weights,
    UNKNOWN where none was made"""

    def __init__(self, level: int, s: float) -> None:
        self.sphere, self.s = icosphere(level), s
        self.M = np.zeros(self.sphere.vertices.shape)
        self.doubt = np.full(self.M.shape, UNKNOWN)

    def add(self, seen: Observation) -> None:
        """One after the other; observations that are not finite are left out."""
        for n, x, variance in zip(seen.normals, seen.irradiance, seen.variance, strict=True):
            length = float(np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]))
            valid = np.isfinite([length, *x, *variance]).all() and length > 0
            if not valid or (variance < 0).any() or (variance >= UNKNOWN).any():
                continue
            nx, ny, nz = n / length
            v = self.sphere.vertices
            f = eq8_weight(v[:, 0] * nx + v[:, 1] * ny + v[:, 2] * nz, self.s)
            self.M = eq7_update(self.M, f, x)
            self.doubt = np.minimum(self.doubt, divide(variance, (f * f)[:, None], where_zero=UNKNOWN))


def eq9_lights(M: np.ndarray, level: int, I_c: float, epsilon_deg: float) -> np.ndarray:
    """(m, 3) unit directions of the lights, strongest first.

    M : (v, 3) or (v,) values at the vertices of icosphere(level);  I_c : of the channels' mean
    Candidates are the middles of the triangles of the upper hemisphere (z >= 0); a light stands where M exceeds I_c and
    every other candidate closer than epsilon_deg."""
    values = np.asarray(M, float)
    values = values.mean(-1) if values.ndim == 2 else values
    sphere = icosphere(level)
    upper = sphere.centres[:, 2] >= 0
    n, at = sphere.centres[upper], values[sphere.faces[upper]].mean(1)
    free, peaks = I_c < at, []
    for i in np.argsort(-at, kind="stable"):
        if free[i]:  # not yet close to one that is as bright: few are, and only theirs are compared with all
            near = n @ n[i] > np.cos(np.radians(epsilon_deg))
            near[i] = False
            if (at[near] < at[i]).all():
                peaks.append(i)
            free &= ~near | (at[i] < at)
    return n[peaks]


def lights_of(seen: Sequence[Observation], params: PrintedLightParams) -> tuple[list[Light], list[np.ndarray]]:
    """One light per observation, and the map beside its lamps as a cube (6, n, n, 3), in the axes of the normals.

    The hemisphere's axis is the mean of all normals."""
    turn = upright(normalise(np.concatenate([o.normals for o in seen]).sum(0)))
    level, map_ = params.map_level, LightMap(params.map_level, params.map_blur_rad)
    sphere, size = map_.sphere, CUBE[level]
    basis = harmonics(sphere.vertices)
    face, share = sphere.locate(face_directions(size).reshape(-1, 3) @ turn.T)
    corners = sphere.faces[face]
    out, cubes = [], []
    for o in seen:
        map_.add(replace(o, normals=o.normals @ turn.T))
        M, doubt = map_.M, map_.doubt
        known = (doubt < UNKNOWN).all(1) & (M.max(1) > 0)
        brightest = float(M[sphere.faces].mean((1, 2)).max())
        peaks = eq9_lights(M, level, params.peak * brightest, params.peak_apart_deg)
        least = M[known].min(0) if known.any() else np.zeros(3)
        directional, rest = [], M.copy()
        for d in peaks[:2]:
            rgb = np.clip(sphere.interpolate(M, d) - least, 0, None)
            directional.append(DirectionalLight(triple(turn.T @ d), triple(rgb), 0.0))
            rest -= np.clip(sphere.vertices @ d, 0, None)[:, None] * rgb
        weight = known.astype(float)
        normal = basis.T @ (basis * weight[:, None]) + _RIDGE * max(weight.sum(), 1.0) * np.eye(9)
        soft = np.linalg.solve(normal, basis.T @ (rest * weight[:, None]))
        faced = known & (doubt <= _SEEN * np.where(known[:, None], doubt, np.inf).min(0)).all(1)
        filled = np.where(faced[:, None], rest, basis @ soft)
        cubes.append((share[..., None] * filled[corners]).sum(1).reshape(6, size, size, 3))
        light = Light.of_soft(soft, (), "marker").turned(turn.T)
        out.append(replace(light, lights=tuple(directional)))
    return out, cubes


def upright(up: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that turns `up` into z."""
    across = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0.0, 1, 0])
    x = normalise(across - (across @ up) * up)
    return np.stack([x, np.cross(up, x), up])


class PrintedStaticFrameLight(StaticFrameLight):
    """maps : by frame, what M has beside its lights, STATIC axes"""

    params: PrintedLightParams
    maps: dict[int, np.ndarray]

    def from_markers(self, rests: bool, samples: Sequence[EnvironmentSample]) -> tuple[Lights, dict[str, Any]]:
        """Each frame's light map and its peaks; frames without a reading have those before them."""
        self.maps = {}
        if not self.lit:
            return super().from_markers(rests, samples)
        solution, cubes = lights_of(self.observations, self.params)
        last = np.clip(np.searchsorted(self.lit, self.frames, side="right") - 1, 0, None)
        self.maps = {k: cubes[i] for k, i in zip(self.frames, last, strict=True)}
        middle = solution[len(solution) // 2]
        peaks = f"{len(middle.lights)} peak{'s' * (len(middle.lights) != 1)} of the light map, as printed: no confidence is known"
        verdict = MEASURED if middle.lights else REFUSED
        lights = {k: solution[i] for k, i in zip(self.frames, last, strict=True)}
        return lights, light_report(verdict, "marker", peaks, middle, **self.normal_statistics())


class PrintedLight(LightOfMarkers):
    Params = PrintedLightParams

    def finish(self, clip: Analysis) -> Analysis:
        parts: list[PrintedStaticFrameLight] = []

        def printed_part(*of: Any) -> StaticFrameLight:
            parts.append(PrintedStaticFrameLight(*of))
            return parts[-1]

        def solve(
            grey: np.ndarray, _: np.ndarray, clipped: np.ndarray, rho: np.ndarray, p: LightParams
        ) -> tuple[Photometry, None]:
            return gain_and_bias(grey, albedo=rho, clipped=clipped), None

        clip = with_light(clip, self.readings, self.samples, self.job.light, self.job.panorama, solve, printed_part)
        maps = {k: CubeMap.of(cube, part.static_from_world[k]) for part in parts for k, cube in part.maps.items()}
        return clip.adding(f.with_(light_map=maps[k]) if k in maps else f for k, f in enumerate(clip.facts))
