"""The light in the object's voxels and what the object does to the real planes, for one light; kept while that stays.

Planes first lose what the object hides of their light. Then voxels: direct light with a cone towards each light for its
shadow, surroundings and darkened planes by six cones, light between the object's own surfaces closed in place; everything
leaves diffusely. Then planes gain what the object sends. Where there are several planes, each also stands before a part of the
others' sky, and the object's shadow on one is missing from its light on another: gathered coarsely, by the planes' own cones.
Source: docs/methods/gi.md#field.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.scene import Scene
from arfx.stages.gi.cones import START, Bricks, even_cones, six_cones, steps_of, trace_many, turned
from arfx.stages.gi.form_factors import Factors, factors_of, gather, solid
from arfx.stages.gi.pyramid import Atlas, Coarser, Structure, atlas_of, nearer_first, structure_of
from arfx.stages.gi.real_planes import mip_chain, texture_places
from arfx.stages.gi.surroundings import Behind, Planes, behind_many
from arfx.stages.gi.voxelise import Volume, Voxels, voxelise

_LEAST_LIGHT_DEG = 6.0  # full angle: a cone much narrower than a voxel would meet all or nothing
ROUNDS = 2  # of light from the plane to the object and back
GATHERED_BY = 2  # voxels a side that share what arrives, which is softer than they are
_HIDDEN = 0.1  # of the hemisphere: what sees less of it lies under the object
COARSE = 48  # texels a side of a plane by which other planes' light is gathered: it is soft
_MOST_CLOSED = 0.95  # of the light between surfaces that is given back: a closed white cavity would never end


@dataclass(frozen=True, eq=False)
class Cones:
    """Cones of a plane that meet the object. texel, cone (m,) : where they start, and which of the plane's each is
    points, directions (m, 3), metres, anchor axes;  weight, left (m,) : share of the hemisphere, and of the background that
    is still seen"""

    texel: np.ndarray
    cone: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    weight: np.ndarray
    left: np.ndarray


@dataclass(frozen=True, eq=False)
class Gathering:
    """Where the voxels' light is gathered. of (v,) int : the place of each voxel;  cells (g, 3) : in voxels;  normal (g, 3)
    directions (g, 6, 3), left (g, 6) : of each place's cones"""

    of: np.ndarray
    cells: np.ndarray
    normal: np.ndarray
    directions: np.ndarray
    left: np.ndarray


@dataclass(frozen=True, eq=False)
class Body:
    """What does not change with the light. gathering : of the voxels' light
    places : of the planes' texels;  cones : by plane;  tan_half, steps : of those;  factors : by plane, none where cones tell
    around (p, k, 3), weights (k,) : of each plane's cones;  coarse (p, c, c, k) : what the object leaves of them, sparsely
    open (p, side, side) float32 : 0 where a texel lies under the object and nothing sees it, else 1"""

    voxels: Voxels
    structure: Structure
    opaque: Atlas
    gathering: Gathering
    places: np.ndarray
    cones: tuple[Cones, ...]
    tan_half: float
    steps: np.ndarray
    open: np.ndarray
    factors: tuple[Factors, ...]
    around: np.ndarray
    weights: np.ndarray
    coarse: np.ndarray

    def traced(self, atlas: Atlas) -> tuple[Bricks, np.ndarray, np.float32]:
        """As kernels take the voxels: bricks, their corner (3,) and side, metres."""
        volume = self.voxels.volume
        return atlas.bricks, np.array(volume.low_m, np.float32), np.float32(volume.voxel_m)


@dataclass(frozen=True, eq=False)
class Field:
    """atlas : radiance;  delta (p, side, side, 3) : indirect light that the object adds to the planes, as a share of all
    their light;  gain : the same as radiance of a white plane;  direct (p, side, side, 3) : share of all their light that it
    leaves, direct light counted too
    deeper (p, side, side, 3) : by how much more a lamp's shadow takes, as other planes stand in the way of the soft light that
    is left in it; none where there is one plane;  brightest : no voxel sends more"""

    atlas: Atlas
    delta: np.ndarray
    gain: np.ndarray
    direct: np.ndarray
    deeper: np.ndarray
    brightest: float


def make_body(
    scene: Scene, n: int, planes: Planes, side: int, cones: int, rays: int = 0, coarser: Coarser = nearer_first
) -> Body:  # fmt: skip
    """n : voxels a side;  side : texels of a plane;  cones : of each of them;  rays : of each, 0 = the cones tell alone"""
    voxels = voxelise(scene, n)
    structure = structure_of(voxels.cells, n, coarser)
    values = np.zeros((len(voxels.cells), 4), np.float32)
    values[:, 3] = voxels.opacity
    opaque = atlas_of(structure, values)
    gathering = _gathering(voxels, opaque)
    places = texture_places(planes, side)
    set_, weights, tan_half = six_cones() if cones == 6 else even_cones(cones)
    steps = steps_of(tan_half, n, start=0.0)
    found, open_, factors, turns, coarse = [], [], [], [], []
    exact = rays > 0 and solid(scene)
    for k, axes in enumerate(planes.axes):
        points = places[k].reshape(-1, 3).astype(np.float32)
        around = turned(axes[3][None], set_)[0]
        turns.append(around)
        if exact:
            told = factors_of(scene, voxels, places[k], axes, set_, rays)
            texel, cone = np.nonzero(told.covered > 0)
            found.append(
                Cones(texel, cone, points[texel], around[cone], told.covered[texel, cone], np.zeros(len(texel), np.float32))
            )
            open_.append(np.clip((1 - told.covered.sum(1)) / _HIDDEN, 0, 1).reshape(side, side))
            factors.append(told)
            coarse.append(coarse_places((1 - told.covered / weights).reshape(side, side, -1)))
            continue
        seen = _traced(opaque, steps, in_voxels(points, voxels.volume), np.tile(around, (len(points), 1, 1)), None, 0.0)[..., 3]
        texel, cone = np.nonzero(seen < 1)
        found.append(Cones(texel, cone, points[texel], around[cone], weights[cone], seen[texel, cone]))
        open_.append(np.clip(seen @ weights / _HIDDEN, 0, 1).reshape(side, side))
        coarse.append(coarse_places(seen.reshape(side, side, -1)))
    return Body(
        voxels, structure, opaque, gathering, places, tuple(found), tan_half, steps, np.array(open_, np.float32),
        tuple(factors), np.array(turns, np.float32), weights, np.clip(np.array(coarse, np.float32), 0, 1),
    )  # fmt: skip


def _gathering(voxels: Voxels, opaque: Atlas) -> Gathering:
    """Of voxels that lie in the same coarser one, those that face the same way share a place: not the two sides of a wall."""
    n, count = voxels.volume.n, len(voxels.cells)
    axis = np.abs(voxels.normal).argmax(1)
    side = 2 * axis + (voxels.normal[np.arange(count), axis] < 0)
    x, y, z = (voxels.cells // GATHERED_BY).astype(np.int64).T
    found, of = np.unique(((z * n + y) * n + x) * 6 + side, return_inverse=True)
    of = of.ravel()
    sums = [np.bincount(of, v, len(found)) for v in (*(voxels.cells + 0.5).T, *voxels.normal.T)]
    cells = divide(np.stack(sums[:3], -1), np.bincount(of, minlength=len(found))[:, None]).astype(np.float32)
    normal = normalise(np.stack(sums[3:], -1)).astype(np.float32)
    six, _, tan_half = six_cones()
    directions = turned(normal, six)
    left = _traced(opaque, steps_of(tan_half, n), cells, directions, normal, float(START))[..., 3]
    return Gathering(of, cells, normal, directions, left)


def in_voxels(points_m: np.ndarray, volume: Volume) -> np.ndarray:
    """Anchor axes, metres, to voxels of level 0 from the volume's corner; float32."""
    return ((points_m - np.asarray(volume.low_m)) / volume.voxel_m).astype(np.float32)


def _traced(
    atlas: Atlas, steps: np.ndarray, origins: np.ndarray, directions: np.ndarray, normals: np.ndarray | None, start: float
) -> np.ndarray:
    """(m, k, 4) of cones from origins (m, 3), voxels, in directions (m, k, 3); normals : leave the surface itself out."""
    n = np.zeros((len(origins), 3), np.float32) if normals is None else normals
    o, d, n = (np.ascontiguousarray(a, np.float32) for a in (origins, directions, n))
    return trace_many(atlas.bricks, steps, o, d, n, np.float32(start), normals is not None).reshape(*d.shape[:2], 4)


def make_field(
    body: Body, scene: Scene, light: Light, planes: Planes, back: Behind, mean: np.ndarray, bounce: bool, sent_alone: bool = False
) -> Field:
    """mean (3,) : radiance of the planes without the object;  bounce : False leaves the voxels black (occlusion alone).
    sent_alone : the planes change by what the voxels send them, not by what the object hides, nor by each other's light"""
    rotation = scene.world_from_anchor.rotation.T
    lights = [(rotation @ li.unit, np.clip(li.rgb, 0, None), li.angular_size_deg) for li in light.lights]
    whole = [light.radiance(scene.world_from_anchor.rotation @ axes[3]) for axes in planes.axes.astype(float)]
    side = body.places.shape[1]
    lost = []
    for k, cones in enumerate(body.cones):
        if len(planes.axes) == 1:  # nothing but the environment, which is the same from everywhere
            behind = _behind(np.zeros_like(body.around[k]), body.around[k], k, body.tan_half, back)[cones.cone]
        else:
            behind = _behind(cones.points, cones.directions, k, body.tan_half, back)
        lost.append(_summed(cones, -(1 - cones.left)[:, None] * behind, side, body.factors[k] if body.factors else None))
    shaded = np.stack([1 + divide(lost[k], whole[k]) - _direct_lost(body, planes, k, lights, whole[k]) for k in range(len(lost))])
    without = shaded.copy()
    values = np.zeros((len(body.voxels.cells), 4), np.float32)
    values[:, 3] = body.voxels.opacity
    occluded = np.zeros((len(lost), side, side, 3)) if sent_alone else np.stack(lost)
    gain, atlas = occluded.copy(), body.opaque
    for turn in range(ROUNDS if bounce else 0):
        darkened = np.clip(shaded, 0, None)
        dark = textured(back, (darkened * body.open[..., None] * mean).astype(np.float32), body.open, mean)
        radiance = _voxel_radiance(body, lights, dark)
        values[:, :3] = radiance * body.voxels.opacity[:, None]
        if not body.factors or turn == ROUNDS - 1:  # rays look up the voxels themselves
            atlas = atlas_of(body.structure, values)
        for k, cones in enumerate(body.cones):
            got = _sent(body, k, radiance, dark, side) if body.factors else _gathered(body, cones, atlas, side)
            gain[k] = got + occluded[k]
            shaded[k] = without[k] + divide(got, whole[k])
    deeper = np.zeros((0, side, side, 3), np.float32)
    if len(planes.axes) > 1 and not sent_alone:
        darkened = np.clip(shaded, 0, None) * body.open[..., None]
        ends = [textured(back, (t * mean).astype(np.float32), body.open, mean) for t in (darkened, np.ones_like(shaded))]
        between, share = light_between(body, *ends)
        gain = gain + between
        shaded = shaded + np.stack([divide(b, w) for b, w in zip(between, whole, strict=True)])
        soft = [light.soft_radiance(scene.world_from_anchor.rotation @ axes[3]) for axes in planes.axes.astype(float)]
        alone, whole = whole, [w + s * (k - 1) for w, s, k in zip(whole, soft, share, strict=True)]
        deeper = np.stack([divide(a, w, where_zero=1.0) - 1 for a, w in zip(alone, whole, strict=True)]).astype(np.float32)
    delta = np.stack([divide(g, w) for g, w in zip(gain, whole, strict=True)])
    return Field(
        atlas, delta.astype(np.float32), gain.astype(np.float32), np.clip(shaded, 0, None).astype(np.float32), deeper,
        float(values[:, :3].max(initial=0.0)),
    )  # fmt: skip


def textured(back: Behind, radiance: np.ndarray, known: np.ndarray, otherwise: np.ndarray) -> Behind:
    textures, mips = mip_chain(radiance, known, otherwise)
    return back._replace(textures=textures, mips=mips)


def _behind(points: np.ndarray, directions: np.ndarray, skip: int, tan_half: float, back: Behind) -> np.ndarray:
    p, d = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(directions, np.float32)
    return behind_many(p, d, np.int64(skip), np.float32(tan_half), np.float32(np.degrees(np.arctan(tan_half))), back)


def _gathered(body: Body, cones: Cones, atlas: Atlas, side: int) -> np.ndarray:
    """(side, side, 3) light that the cones of a plane bring from the voxels."""
    starts = in_voxels(cones.points, body.voxels.volume)
    return _summed(cones, _traced(atlas, body.steps, starts, cones.directions[:, None], None, 0.0)[:, 0, :3], side)


def _sent(body: Body, k: int, radiance: np.ndarray, back: Behind, side: int) -> np.ndarray:
    """(side, side, 3) light that the voxels send to plane k. radiance (v, 3);  back : what metal mirrors"""
    f, v = body.factors[k], body.voxels
    out = np.zeros((side * side, 3))
    gather(f.texel, f.matt, np.ascontiguousarray(radiance, np.float32), out)
    for m in f.mirrored:
        at, to = f.voxel[m.rows], f.texel[m.rows]
        sent = v.albedo[at] * _behind(m.place, m.direction, -1, m.tangent, back) + v.emission[at]
        out += np.stack([np.bincount(to, sent[:, c], side * side) for c in range(3)], -1)
    return (f.share * out)[f.source].reshape(side, side, 3)


def _summed(cones: Cones, light: np.ndarray, side: int, factors: Factors | None = None) -> np.ndarray:
    """(side, side, 3) float64: the cones' light (m, 3) times their weights, by texel."""
    weighted = light * cones.weight[:, None]
    out = np.stack([np.bincount(cones.texel, weighted[:, c], side * side) for c in range(3)], -1)
    return (out if factors is None else out[factors.source]).reshape(side, side, 3)


def _direct_lost(
    body: Body, planes: Planes, k: int, lights: list[tuple[np.ndarray, np.ndarray, float]], whole: np.ndarray
) -> np.ndarray:
    """(side, side, 3) share of a plane's light that the object's shadow takes; for what reflects the plane, not the picture."""
    side, normal = body.places.shape[1], planes.axes[k, 3]
    out = np.zeros((side, side, 3))
    points = in_voxels(body.places[k].reshape(-1, 3), body.voxels.volume)
    for d, colour, size_deg in lights:
        share = divide(colour * max(float(d @ normal), 0.0), whole)
        if share.any():
            directions = np.tile(d.astype(np.float32), (len(points), 1, 1))
            left = _traced(body.opaque, _light_steps(size_deg, body), points, directions, None, 0.0)[:, 0, 3]
            out += (1 - left).reshape(side, side, 1) * share
    return out


def _voxel_radiance(body: Body, lights: list[tuple[np.ndarray, np.ndarray, float]], back: Behind) -> np.ndarray:
    """(v, 3) that leaves each voxel."""
    v, at = body.voxels, body.gathering
    _, weights, tan_half = six_cones()
    points = np.repeat(np.asarray(v.volume.low_m) + at.cells * v.volume.voxel_m, 6, axis=0)
    behind = _behind(points, at.directions.reshape(-1, 3), -1, tan_half, back).reshape(-1, 6, 3)
    arriving = ((weights * at.left)[..., None] * behind).sum(1)[at.of]
    for d, colour, size_deg in lights:
        rows = np.flatnonzero(at.normal @ d > 0) if d[2] > 0 else np.zeros(0, int)
        directions = np.tile(d.astype(np.float32), (len(rows), 1, 1))
        left = np.zeros(len(at.cells), np.float32)
        steps = _light_steps(size_deg, body)
        left[rows] = _traced(body.opaque, steps, at.cells[rows], directions, at.normal[rows], float(START))[:, 0, 3]
        arriving += (np.clip(v.normal @ d, 0, None) * left[at.of])[:, None] * colour
    hidden = (1 - at.left @ weights)[at.of, None]
    # what surfaces of the object give each other: as if those that hide the surroundings were lit as it is itself
    closed = 1 - np.minimum(v.albedo * hidden, _MOST_CLOSED)
    return divide(v.albedo * arriving, closed) + v.emission


def _light_steps(size_deg: float, body: Body) -> np.ndarray:
    return steps_of(float(np.tan(np.radians(max(size_deg, _LEAST_LIGHT_DEG) / 2))), body.voxels.volume.n)


def enlarged(texture: np.ndarray, side: int) -> np.ndarray:
    """(p, side, side, 3) of (p, n, n, 3): linear between texels."""
    return np.stack([cv2.resize(t, (side, side), interpolation=cv2.INTER_LINEAR) for t in texture])


def coarse_places(places: np.ndarray) -> np.ndarray:
    """(c, c, k) of the values (side, side, k) of a plane's texels: of every so many, c = COARSE at most."""
    step = max(places.shape[0] // COARSE, 1)
    return places[step // 2 :: step, step // 2 :: step]


def light_between(body: Body, changed: Behind, unchanged: Behind) -> tuple[np.ndarray, np.ndarray]:
    """(p, side, side, 3) radiance of white planes that they gain (or lose) because the other planes are changed, and the share
    of the environment's light that they have with the other planes in it. Cost: O(planes x COARSE^2 x cones), once per light."""
    side = body.places.shape[1]
    gained, share = [], []
    bare = unchanged._replace(axes=unchanged.axes[:0])
    for k in range(len(body.places)):
        at = coarse_places(body.places[k])
        c, count = at.shape[0], body.around.shape[1]
        points, around = np.repeat(at.reshape(-1, 3), count, 0), np.tile(body.around[k], (c * c, 1))
        seen = [_behind(points, around, k, body.tan_half, a).reshape(c, c, count, 3) for a in (changed, unchanged, bare)]
        more, with_planes, without = (v * body.weights[:, None] for v in (seen[0] - seen[1], *seen[1:]))
        gained.append((more * body.coarse[k][..., None]).sum(2))
        share.append(divide(with_planes.sum(2), without.sum(2), where_zero=1.0))
    return enlarged(np.array(gained, np.float32), side), enlarged(np.array(share, np.float32), side)
