"""The light in the object's voxels and what the object does to the real planes, for one light; cached while that light stays.

Planes first lose what the object hides of their light. Then voxels: direct light with a cone towards each light for its
shadow, surroundings and darkened planes by six cones, light between the object's own surfaces closed in place; everything
leaves diffusely. Then planes gain what the object sends. Where there are several planes, each also stands before a part of the
others' sky, and the object's shadow on one is missing from its light on another: gathered coarsely, by the planes' own cones.
Source: docs/methods/gi.md#field."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.light import Light
from arfx.core.numerics import divide, normalise
from arfx.core.scene import Scene
from arfx.stages.gi.cones import (
    START,
    Bricks,
    Placed,
    around_normals,
    cosine_cones,
    six_cones,
    steps_of,
    trace_many,
)
from arfx.stages.gi.form_factors import Factors, factors_of, gather, solid
from arfx.stages.gi.pyramid import Structure, atlas_of, structure_of
from arfx.stages.gi.real_planes import mip_chain, texel_positions
from arfx.stages.gi.surroundings import Background, Planes, background_radiances
from arfx.stages.gi.voxelise import Volume, Voxels, voxelise

_LEAST_LIGHT_DEG = 6.0  # full angle: a cone much narrower than a voxel would meet all or nothing
ROUNDS = 2  # of light from the plane to the object and back
CLUSTER_SIDE = 2  # voxels a side that share what arrives, which is softer than they are
_HIDDEN = 0.1  # of the hemisphere: what sees less of it lies under the object
COARSE = 48  # texels a side of a plane by which other planes' light is gathered: it is soft
_MOST_CLOSED = 0.95  # of the light between surfaces that is given back: a closed white cavity would never end


@dataclass(frozen=True, eq=False)
class Cones:
    """Cones of a plane that meet the object. texel, cone (m,) : where they start, and which of the plane's each is
    points, directions (m, 3), metres, anchor axes;  weight, transmittance (m,) : fraction of the hemisphere, and of the
    background that is still seen"""

    texel: np.ndarray
    cone: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    weight: np.ndarray
    transmittance: np.ndarray


@dataclass(frozen=True, eq=False)
class ClusteredReceivers:
    """Where the voxels' light is gathered. cluster (v,) int : the place of each voxel;  cells (g, 3) : in voxels;  normal (g, 3)
    directions (g, 6, 3), transmittance (g, 6) : of each place's cones"""

    cluster: np.ndarray
    cells: np.ndarray
    normal: np.ndarray
    directions: np.ndarray
    transmittance: np.ndarray


@dataclass(frozen=True, eq=False)
class VoxelModel:
    """What does not change with the light. receivers : of the voxels' light
    positions : of the planes' texels;  cones : by plane;  tan_half, steps : of those;  factors : by plane, or none
    directions (p, k, 3), weights (k,) : of each plane's cones;  coarse (p, c, c, k) : what the object leaves of them, sparsely
    visibility (p, side, side) float32 : 0 where a texel lies under the object and nothing sees it, else 1"""

    voxels: Voxels
    structure: Structure
    opaque: Bricks
    receivers: ClusteredReceivers
    positions: np.ndarray
    cones: tuple[Cones, ...]
    tan_half: float
    steps: np.ndarray
    visibility: np.ndarray
    factors: tuple[Factors, ...]
    directions: np.ndarray
    weights: np.ndarray
    coarse: np.ndarray

    def placed(self, atlas: Bricks) -> Placed:
        volume = self.voxels.volume
        return Placed(atlas, np.array(volume.low_m, np.float32), np.float32(volume.voxel_m))


@dataclass(frozen=True, eq=False)
class Field:
    """atlas : radiance;  delta (p, side, side, 3) : indirect light that the object adds to the planes, as a share of all
    their light;  direct (p, side, side, 3) : share of all their light that it leaves, direct light counted too
    extra_occlusion (p, side, side, 3) : by how much more a lamp's shadow takes, as other planes hide some of the soft light
    that is left in it; none where there is one plane;  brightest : no voxel sends more"""

    atlas: Bricks
    delta: np.ndarray
    direct: np.ndarray
    extra_occlusion: np.ndarray
    brightest: float


def make_voxel_model(scene: Scene, n: int, planes: Planes, side: int, cones: int, rays: int = 0) -> VoxelModel:
    """n : voxels a side;  side : texels of a plane;  cones : of each of them;  rays : of each, 0 = cones alone"""
    voxels = voxelise(scene, n)
    structure = structure_of(voxels.cells, n)
    values = np.zeros((len(voxels.cells), 4), np.float32)
    values[:, 3] = voxels.opacity
    opaque = atlas_of(structure, values)
    receivers = _clustered_receivers(voxels, opaque)
    positions = texel_positions(planes, side)
    cone_set, weights, tan_half = six_cones() if cones == 6 else cosine_cones(cones)
    steps = steps_of(tan_half, n, start=0.0)
    meeting, visibility, factors, all_directions, coarse = [], [], [], [], []
    exact = rays > 0 and solid(scene)
    for k, axes in enumerate(planes.axes):
        points = positions[k].reshape(-1, 3).astype(np.float32)
        directions = around_normals(axes[3][None], cone_set)[0]
        all_directions.append(directions)
        if exact:
            factor = factors_of(scene, voxels, positions[k], axes, cone_set, rays)
            texel, cone = np.nonzero(factor.covered > 0)
            weight, transmittance = factor.covered[texel, cone], np.zeros(len(texel), np.float32)
            meeting.append(Cones(texel, cone, points[texel], directions[cone], weight, transmittance))
            visibility.append(np.clip((1 - factor.covered.sum(1)) / _HIDDEN, 0, 1).reshape(side, side))
            factors.append(factor)
            coarse.append(coarse_texels((1 - factor.covered / weights).reshape(side, side, -1)))
            continue
        starts = to_voxels(points, voxels.volume)
        seen = _traced(opaque, steps, starts, np.tile(directions, (len(points), 1, 1)), None, 0.0)[..., 3]
        texel, cone = np.nonzero(seen < 1)
        meeting.append(Cones(texel, cone, points[texel], directions[cone], weights[cone], seen[texel, cone]))
        visibility.append(np.clip(seen @ weights / _HIDDEN, 0, 1).reshape(side, side))
        coarse.append(coarse_texels(seen.reshape(side, side, -1)))
    return VoxelModel(
        voxels, structure, opaque, receivers, positions, tuple(meeting), tan_half, steps, np.array(visibility, np.float32),
        tuple(factors), np.array(all_directions, np.float32), weights, np.clip(np.array(coarse, np.float32), 0, 1),
    )  # fmt: skip


def _clustered_receivers(voxels: Voxels, opaque: Bricks) -> ClusteredReceivers:
    """Of voxels that lie in the same coarser one, those that face the same way share a place: not the two sides of a wall."""
    n, count = voxels.volume.n, len(voxels.cells)
    axis = np.abs(voxels.normal).argmax(1)
    side = 2 * axis + (voxels.normal[np.arange(count), axis] < 0)
    x, y, z = (voxels.cells // CLUSTER_SIDE).astype(np.int64).T
    keys, cluster = np.unique(((z * n + y) * n + x) * 6 + side, return_inverse=True)
    cluster = cluster.ravel()
    sums = [np.bincount(cluster, v, len(keys)) for v in (*(voxels.cells + 0.5).T, *voxels.normal.T)]
    cells = divide(np.stack(sums[:3], -1), np.bincount(cluster, minlength=len(keys))[:, None]).astype(np.float32)
    normal = normalise(np.stack(sums[3:], -1)).astype(np.float32)
    six, _, tan_half = six_cones()
    directions = around_normals(normal, six)
    transmittance = _traced(opaque, steps_of(tan_half, n), cells, directions, normal, float(START))[..., 3]
    return ClusteredReceivers(cluster, cells, normal, directions, transmittance)


def to_voxels(points_m: np.ndarray, volume: Volume) -> np.ndarray:
    """Anchor axes, metres, to voxels of level 0 from the volume's corner; float32."""
    return ((points_m - np.asarray(volume.low_m)) / volume.voxel_m).astype(np.float32)


def _traced(
    atlas: Bricks, steps: np.ndarray, origins: np.ndarray, directions: np.ndarray, normals: np.ndarray | None, start: float
) -> np.ndarray:
    """(m, k, 4) of cones from origins (m, 3), voxels, in directions (m, k, 3); normals : leave the surface itself out."""
    n = np.zeros((len(origins), 3), np.float32) if normals is None else normals
    o, d, n = (np.ascontiguousarray(a, np.float32) for a in (origins, directions, n))
    return trace_many(atlas, steps, o, d, n, np.float32(start), normals is not None).reshape(*d.shape[:2], 4)


def make_field(model: VoxelModel, scene: Scene, light: Light, planes: Planes, background: Background, mean: np.ndarray) -> Field:
    """mean (3,) : radiance of the planes without the object"""
    rotation = scene.world_from_anchor.rotation.T
    lights = [(rotation @ li.unit, np.clip(li.rgb, 0, None), li.angular_size_deg) for li in light.lights]
    total = [light.radiance(scene.world_from_anchor.rotation @ axes[3]) for axes in planes.axes.astype(float)]
    side = model.positions.shape[1]
    occlusion = []
    for k, cones in enumerate(model.cones):
        if len(planes.axes) == 1:  # nothing but the environment, which is the same from everywhere
            beyond = _beyond(np.zeros_like(model.directions[k]), model.directions[k], k, model.tan_half, background)[cones.cone]
        else:
            beyond = _beyond(cones.points, cones.directions, k, model.tan_half, background)
        factors = model.factors[k] if model.factors else None
        occlusion.append(_summed(cones, -(1 - cones.transmittance)[:, None] * beyond, side, factors))
    direct = [_direct_occlusion(model, planes, k, lights, w) for k, w in enumerate(total)]
    shaded = np.stack([1 + divide(a, w) - d for a, w, d in zip(occlusion, total, direct, strict=True)])
    without, visibility = shaded.copy(), model.visibility
    values = np.zeros((len(model.voxels.cells), 4), np.float32)
    values[:, 3] = model.voxels.opacity
    occluded = np.stack(occlusion)
    gain, atlas = occluded.copy(), model.opaque
    for turn in range(ROUNDS):
        darkened = np.clip(shaded, 0, None)
        dark = with_texture(background, (darkened * visibility[..., None] * mean).astype(np.float32), visibility, mean)
        radiance = _voxel_radiance(model, lights, dark)
        values[:, :3] = radiance * model.voxels.opacity[:, None]
        if not model.factors or turn == ROUNDS - 1:  # rays look up the voxels themselves
            atlas = atlas_of(model.structure, values)
        for k, cones in enumerate(model.cones):
            received = _received_by_rays(model, k, radiance, dark) if model.factors else _received_by_cones(model, cones, atlas)
            gain[k] = received + occluded[k]
            shaded[k] = without[k] + divide(received, total[k])
    extra_occlusion = np.zeros((0, side, side, 3), np.float32)
    if len(planes.axes) > 1:
        darkened = np.clip(shaded, 0, None) * visibility[..., None]
        ends = [
            with_texture(background, (t * mean).astype(np.float32), visibility, mean) for t in (darkened, np.ones_like(shaded))
        ]
        between, fraction = light_between(model, *ends)
        gain = gain + between
        shaded = shaded + np.stack([divide(b, w) for b, w in zip(between, total, strict=True)])
        soft = [light.soft_radiance(scene.world_from_anchor.rotation @ axes[3]) for axes in planes.axes.astype(float)]
        alone, total = total, [w + s * (k - 1) for w, s, k in zip(total, soft, fraction, strict=True)]
        extra_occlusion = np.array([divide(a, w, where_zero=1.0) - 1 for a, w in zip(alone, total, strict=True)], np.float32)
    delta = np.stack([divide(g, w) for g, w in zip(gain, total, strict=True)])
    return Field(
        atlas, delta.astype(np.float32), np.clip(shaded, 0, None).astype(np.float32), extra_occlusion,
        float(values[:, :3].max(initial=0.0)),
    )  # fmt: skip


def with_texture(background: Background, radiance: np.ndarray, known: np.ndarray, otherwise: np.ndarray) -> Background:
    textures, mips = mip_chain(radiance, known, otherwise)
    return background._replace(textures=textures, mips=mips)


def _beyond(points: np.ndarray, directions: np.ndarray, skip: int, tan_half: float, background: Background) -> np.ndarray:
    p, d = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(directions, np.float32)
    return background_radiances(
        p, d, np.int64(skip), np.float32(tan_half), np.float32(np.degrees(np.arctan(tan_half))), background
    )


def _received_by_cones(model: VoxelModel, cones: Cones, atlas: Bricks) -> np.ndarray:
    """(side, side, 3) light that the cones of a plane bring from the voxels."""
    starts = to_voxels(cones.points, model.voxels.volume)
    light = _traced(atlas, model.steps, starts, cones.directions[:, None], None, 0.0)[:, 0, :3]
    return _summed(cones, light, model.positions.shape[1])


def _received_by_rays(model: VoxelModel, k: int, radiance: np.ndarray, background: Background) -> np.ndarray:
    """(side, side, 3) light that the voxels send to plane k. radiance (v, 3);  background : what metal mirrors"""
    f, v, side = model.factors[k], model.voxels, model.positions.shape[1]
    out = np.zeros((side * side, 3))
    gather(f.texel, f.diffuse_voxel, np.ascontiguousarray(radiance, np.float32), out)
    for m in f.mirrored:
        at, to = f.voxel[m.rows], f.texel[m.rows]
        sent = v.albedo[at] * _beyond(m.position, m.direction, -1, m.tangent, background) + v.emission[at]
        out += np.stack([np.bincount(to, sent[:, c], side * side) for c in range(3)], -1)
    return (f.fraction * out)[f.source].reshape(side, side, 3)


def _summed(cones: Cones, light: np.ndarray, side: int, factors: Factors | None = None) -> np.ndarray:
    """(side, side, 3) float64: the cones' light (m, 3) times their weights, by texel."""
    weighted = light * cones.weight[:, None]
    out = np.stack([np.bincount(cones.texel, weighted[:, c], side * side) for c in range(3)], -1)
    return (out if factors is None else out[factors.source]).reshape(side, side, 3)


def _direct_occlusion(
    model: VoxelModel, planes: Planes, k: int, lights: list[tuple[np.ndarray, np.ndarray, float]], total: np.ndarray
) -> np.ndarray:
    """(side, side, 3) share of a plane's light that the object's shadow takes; for what reflects the plane, not the picture."""
    side, normal = model.positions.shape[1], planes.axes[k, 3]
    out = np.zeros((side, side, 3))
    points = to_voxels(model.positions[k].reshape(-1, 3), model.voxels.volume)
    for d, colour, size_deg in lights:
        fraction = divide(colour * max(float(d @ normal), 0.0), total)
        if fraction.any():
            directions = np.tile(d.astype(np.float32), (len(points), 1, 1))
            transmittance = _traced(model.opaque, _light_steps(size_deg, model), points, directions, None, 0.0)[:, 0, 3]
            out += (1 - transmittance).reshape(side, side, 1) * fraction
    return out


def _voxel_radiance(model: VoxelModel, lights: list[tuple[np.ndarray, np.ndarray, float]], background: Background) -> np.ndarray:
    """(v, 3) that leaves each voxel."""
    v, at = model.voxels, model.receivers
    _, weights, tan_half = six_cones()
    points = np.repeat(np.asarray(v.volume.low_m) + at.cells * v.volume.voxel_m, 6, axis=0)
    beyond = _beyond(points, at.directions.reshape(-1, 3), -1, tan_half, background).reshape(-1, 6, 3)
    arriving = ((weights * at.transmittance)[..., None] * beyond).sum(1)[at.cluster]
    for d, colour, size_deg in lights:
        rows = np.flatnonzero(at.normal @ d > 0) if d[2] > 0 else np.zeros(0, int)
        directions = np.tile(d.astype(np.float32), (len(rows), 1, 1))
        transmittance = np.zeros(len(at.cells), np.float32)
        steps = _light_steps(size_deg, model)
        transmittance[rows] = _traced(model.opaque, steps, at.cells[rows], directions, at.normal[rows], float(START))[:, 0, 3]
        arriving += (np.clip(v.normal @ d, 0, None) * transmittance[at.cluster])[:, None] * colour
    hidden = (1 - at.transmittance @ weights)[at.cluster, None]
    # what surfaces of the object give each other: as if those that hide the surroundings were lit as it is itself
    closed = 1 - np.minimum(v.albedo * hidden, _MOST_CLOSED)
    return divide(v.albedo * arriving, closed) + v.emission


def _light_steps(size_deg: float, model: VoxelModel) -> np.ndarray:
    return steps_of(float(np.tan(np.radians(max(size_deg, _LEAST_LIGHT_DEG) / 2))), model.voxels.volume.n)


def upsampled(texture: np.ndarray, side: int) -> np.ndarray:
    """(p, side, side, 3) cluster (p, n, n, 3): linear between texels."""
    return np.stack([cv2.resize(t, (side, side), interpolation=cv2.INTER_LINEAR) for t in texture])


def coarse_texels(positions: np.ndarray) -> np.ndarray:
    """(c, c, k) of the values (side, side, k) of a plane's texels: of every so many, c = COARSE at most."""
    step = max(positions.shape[0] // COARSE, 1)
    return positions[step // 2 :: step, step // 2 :: step]


def light_between(model: VoxelModel, changed: Background, unchanged: Background) -> tuple[np.ndarray, np.ndarray]:
    """(p, side, side, 3) radiance of white planes that they gain (or lose) because the other planes are changed, and the share
    of the environment's light that they have with the other planes in it. Cost: O(planes x COARSE^2 x cones), once per light."""
    side = model.positions.shape[1]
    gained, fraction = [], []
    bare = unchanged._replace(axes=unchanged.axes[:0])
    for k in range(len(model.positions)):
        at = coarse_texels(model.positions[k])
        c, count = at.shape[0], model.directions.shape[1]
        points, directions = np.repeat(at.reshape(-1, 3), count, 0), np.tile(model.directions[k], (c * c, 1))
        seen = [_beyond(points, directions, k, model.tan_half, a).reshape(c, c, count, 3) for a in (changed, unchanged, bare)]
        more, with_planes, without = (v * model.weights[:, None] for v in (seen[0] - seen[1], *seen[1:]))
        gained.append((more * model.coarse[k][..., None]).sum(2))
        fraction.append(divide(with_planes.sum(2), without.sum(2), where_zero=1.0))
    return upsampled(np.array(gained, np.float32), side), upsampled(np.array(fraction, np.float32), side)
