"""Environment from the one camera and delta voxel cone tracing, as printed: Yao, Tao, Wu 2018.

1. The real scene is a mesh of its planes: s4_plane.py.
2. It is voxelised with the object; light of reflective shadow maps goes into V_rho, V_mu and
   V_delta, the coarser voxels are the mean of their children: s4_volumes.py, s4_shadow_maps.py.
3. The environment is folded out of the picture: s4_environment.py.
4. Cones gather the light of voxels and environment: s4_cones.py. Real surfaces read V_delta,
   virtual ones V_mu, the rebuilt volume, and what their cones let through of the environment. Here.

Deviations. Not stated and therefore settings: voxels a side, the plane's albedo, how much it
mirrors. With the printed labels V_delta has its sign turned round: it is subtracted here. The
environment is said once to be for real and once for virtual surfaces: the picture of real ones
holds it already. Only light with a direction is in the voxels, so where the frame has none nothing
changes on the planes. The picture is changed by a ratio, so black pixels of it gain little.
Processor instead of graphics card. Gloss, which the paper leaves open: Karis 2013 (split
sum). Its errors: docs/methods/gi.md#errata."""

from collections.abc import Hashable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import Light
from arfx.core.numerics import normalise
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.settings import Fraction, setting
from arfx.core.stage import Demand, Stage, View
from arfx.papers.s4_cones import (
    around_normals,
    cone_steps,
    cone_trace,
    six_cones,
)
from arfx.papers.s4_environment import (
    FACE_PX,
    step3_environment,
    step3_mipmap,
    step4_environment,
)
from arfx.papers.s4_plane import step1_mesh
from arfx.papers.s4_shadow_maps import step2_radiance
from arfx.papers.s4_volumes import Volumes, step2_volumes
from arfx.stages.gi import GiParams
from arfx.stages.gi.gloss import mirror_tangent
from arfx.stages.gi.incoming import light_in_steps
from arfx.stages.gi.plane_change import DARKEST, Rows
from arfx.stages.gi.reference import object_mask, object_points
from arfx.stages.gi.reference_scene import RayScene
from arfx.stages.light.split_sum import COSINES, ROUGHNESSES, split_sum
from arfx.stages.viewing import between_nodes, direction_grid, seen_rect

LIFT = 0.02  # of the distance: measured depth that is off by more does not lie on the plane
BAND_PX = 32  # rows at once: bounds memory
LOBES = 12  # widths of mirror cones, from those of roughness 0 to 1


class PrintedGiParams(GiParams):
    formula: str = "paper"
    plane_gloss: Fraction = setting(
        0.1,
        "as under the corrected formula, but the planes mirror the object unless this is 0",
    )
    plane_roughness: Fraction = setting(
        0.1, "roughness of the plane's reflection, 0 (a mirror) to 1"
    )
    voxels: Literal[32, 64, 128, 256] = setting(
        128, "of a side of the octree's lowest level: 32, 64, 128 or 256"
    )
    plane_albedo: Fraction = setting(0.5, "of the real plane, 0..1")


class PrintedPrepared(NamedTuple):
    """Of one clip and worker. real, virtual : what rays meet of the mesh of step 1, and of the
    object
    volumes : of step 2;  grid : viewing directions"""

    real: RayScene
    virtual: RayScene
    volumes: Volumes
    grid: ndarray


class Surfels(NamedTuple):
    """Points of surfaces that are shaded. position (m, 3), metres, normal (m, 3) and seen (m, 3),
    unit direction from the camera: anchor axes"""

    position: ndarray
    normal: ndarray
    seen: ndarray

    @property
    def mirrored(self) -> ndarray:
        return self.seen + 2 * self.cosine[:, None] * self.normal

    @property
    def cosine(self) -> ndarray:
        """(m,) between the normal and the way to the camera."""
        return -(self.seen * self.normal).sum(-1)


# mip levels of step 3's environment, and the rotation (3, 3) to the camera's axes from the anchor's
Around = tuple[list[ndarray], ndarray]


class PrintedGi(Stage):
    name = "gi"
    facts = frozenset({"pose", "light", "depth"})
    Params = PrintedGiParams
    terms = ("frames", "mpx", "object_mpx", "lamps", "new_lights")

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        model = facts.raster_box.clip(frame)
        mesh = self._mesh_rect(facts, scene, frame)
        if model.empty and mesh.empty:
            return Demand(EMPTY, "model and planes out of view")
        return Demand(
            model.union(mesh), "model and the real planes' mesh, as printed"
        )

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        return scene.camera.rect  # all of the picture is in the environment

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        return {
            "new_lights": None if facts.light is None else repr(lamps_of(facts.light))
        }

    def prepare(self, scene: Scene, level: str) -> Any:
        real = step1_mesh(scene, self.params.plane_albedo)
        volumes = step2_volumes(real, scene, self.params.voxels)
        grid = direction_grid(scene.camera)
        return PrintedPrepared(RayScene(real), RayScene(scene), volumes, grid)

    def run(self, view: View, prepared: PrintedPrepared) -> Mapping[Layer, ndarray]:
        lamps = lamps_of(view.light)
        real, virtual, volumes, _ = prepared
        turn = view.scene.world_from_anchor.rotation
        lights = [(d @ turn, rgb) for d, rgb in lamps]
        radiance = view.memo.of_light.get(
            repr(lamps), lambda: step2_radiance(volumes, real, virtual, lights)
        )
        objects = view[Layer.VIRTUAL].copy()
        shadow = view[Layer.SHADOW].copy()
        bias = np.array(view.facts.bias_rgb, np.float32)
        picture = np.clip(view[Layer.PLATE] - bias, 0, None)
        wanted = view.out.clip(view.rect)
        if self.params.strength > 0 and radiance.V_delta.any():
            camera = view.scene.camera.rect
            within = wanted.clip(self._mesh_rect(view.facts, view.scene, camera))
            for y in range(within.y0, within.y1, BAND_PX):
                band = within._replace(y0=y, y1=min(y + BAND_PX, within.y1))
                at, surfels = real_surfels(view, prepared, band)
                change = self.step4_real(volumes, radiance.V_delta, surfels)
                light = picture[at]
                ratio = np.minimum(change, light) / np.maximum(light, DARKEST)
                shadow[at] -= self.params.strength * ratio
        around = (
            step3_mipmap(step3_environment(picture, FACE_PX)),
            (view.pose @ view.scene.world_from_anchor).rotation,
        )
        rows, surfels = virtual_surfels(view, wanted.clip(view.facts.raster_box))
        coverage, rho, material = (
            view[name][rows]
            for name in (Layer.COVERAGE, Layer.ALBEDO, Layer.MATERIAL)
        )
        light = self.step4_virtual(
            volumes, radiance.V_mu, around, surfels, rho, material
        )
        objects[rows] += coverage[:, None] * light
        return {Layer.VIRTUAL: objects, Layer.SHADOW: np.maximum(shadow, 0)}

    def step4_real(self, volumes: Volumes, V_delta: ndarray, at: Surfels) -> ndarray:
        """(m, 3) of V_delta on real surfaces: by the wide cones, and by the mirror cone, in which
        the object is reflected."""
        p = self.params
        out = p.plane_albedo * wide_cones(volumes, V_delta, at)[:, :3]
        if p.plane_gloss > 0:
            rough = np.full(len(out), p.plane_roughness)
            mirrored = mirror_cones(volumes, V_delta, at, rough)
            a, b = fresnel(rough, at.cosine)
            out += (p.plane_gloss * a + b) * mirrored[:, :3]
        return out

    def step4_virtual(
        self,
        volumes: Volumes,
        V_mu: ndarray,
        around: Around,
        at: Surfels,
        rho: ndarray,
        material: ndarray,
    ) -> ndarray:
        """(m, 3) of V_mu, the rebuilt volume, and the environment behind it, on the object's
        surfaces."""
        metal, roughness, specular = np.split(material[:, :3], 3, 1)
        roughness = roughness[:, 0]
        six = wide_cones(volumes, V_mu, at, around)
        mirrored = mirror_cones(volumes, V_mu, at, roughness, around)
        a, b = fresnel(roughness, at.cosine)
        f0 = 0.08 * specular * (1 - metal)
        gloss = np.where(f0 + metal > 0, (f0 + rho * metal) * a + b, 0)
        diffuse = rho * (1 - metal) * (1 - np.where(f0 > 0, f0 * a + b, 0))
        return diffuse * six[:, :3] + gloss * mirrored[:, :3]

    def _mesh_rect(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Rect:
        """Pixels in which the mesh of the real planes can be seen."""
        if self.params.strength <= 0:
            return EMPTY
        corners = step1_mesh(scene, self.params.plane_albedo).model_points_m
        return seen_rect(scene.camera, facts.pose.apply(corners), 1.0).clip(frame)


def lamps_of(light: Light) -> list[tuple[ndarray, ndarray]]:
    """Direction (3,), unit, WORLD axes, and rgb (3,) of each directional light, in steps too small
    to show by way of voxels."""
    return [(lamp.unit, np.array(lamp.rgb)) for lamp in light_in_steps(light).lights]


def real_surfels(
    view: View, prepared: PrintedPrepared, within: Rect
) -> tuple[Rows, Surfels]:
    """(rows and columns, points) where the picture shows the mesh and not the object alone."""
    anchor_from_camera = (view.pose @ view.scene.world_from_anchor).inverse()
    # z = 1: distances are depths
    d = between_nodes(prepared.grid.astype(np.float32), within)
    seen = d.reshape(-1, 3) @ anchor_from_camera.rotation.T
    eyes = np.broadcast_to(anchor_from_camera.translation_m, seen.shape)
    met = prepared.real.nearest(eyes, seen)
    covered, depth = (
        view[name][within.slices_in(view.rect)].ravel()
        for name in (Layer.COVERAGE, Layer.REAL_DEPTH)
    )
    with np.errstate(invalid="ignore"):
        off = np.isfinite(depth) & (
            np.abs(depth - met.distance) > LIFT * met.distance
        )
    pixel = np.flatnonzero(np.isfinite(met.distance) & (covered < 1) & ~off)
    surface = prepared.real.surface(met.of(pixel), eyes[pixel], seen[pixel])
    front = (surface.normal * seen[pixel]).sum(-1) < 0
    pixel = pixel[front]
    row, column = np.unravel_index(pixel, d.shape[:2])
    corner = within.shift(-view.rect.x0, -view.rect.y0)
    rows = row + corner.y0, column + corner.x0
    return rows, Surfels(
        surface.position[front], surface.normal[front], normalise(seen[pixel])
    )


def virtual_surfels(view: View, within: Rect) -> tuple[Rows, Surfels]:
    """The same of the object's pixels."""
    row, column = np.nonzero(object_mask(view, within))
    rows = row, column
    position, normal, towards = object_points(view, rows)
    return rows, Surfels(position, normal, -towards)


def wide_cones(
    volumes: Volumes, V: ndarray, at: Surfels, around: Around | None = None
) -> ndarray:
    """(m, 4) of six cones about the normal, .25 of the one along it and .15 of each of the five
    around, and of what is around behind them."""
    six, weights, tan_half = six_cones()
    d = around_normals(at.normal.astype(np.float32), six)
    return np.asarray(
        weights @ gathered(volumes, V, at.position, d, tan_half, around)
    )


def mirror_cones(
    volumes: Volumes,
    V: ndarray,
    at: Surfels,
    roughness: ndarray,
    around: Around | None = None,
) -> ndarray:
    """(m, 4) of one narrow cone about the mirrored line of sight, and of what is around behind it.
    roughness (m,)"""
    tangent = mirror_tangent(np.rint(roughness * (LOBES - 1)) / (LOBES - 1))
    out = np.zeros((len(tangent), 4), np.float32)
    for one in np.unique(tangent):
        rows = tangent == one
        d = at.mirrored[rows][:, None]
        out[rows] = gathered(volumes, V, at.position[rows], d, one, around)[:, 0]
    return out


def gathered(
    volumes: Volumes,
    V: ndarray,
    position: ndarray,
    d: ndarray,
    tan_half: float,
    around: Around | None,
) -> ndarray:
    """(m, k, 4) of cones from positions (m, 3) in directions (m, k, 3), and of what is around
    behind them."""
    out = cone_trace(volumes, V, cone_steps(tan_half, volumes.volume.n), position, d)
    if around is not None:
        environment, turn = around
        half_deg = float(np.degrees(np.arctan(tan_half)))
        behind = step4_environment(environment, d.reshape(-1, 3) @ turn.T, half_deg)
        out[..., :3] += out[..., 3:] * behind.reshape(d.shape)
    return out


def fresnel(roughness: ndarray, cosine: ndarray) -> tuple[ndarray, ndarray]:
    """(a, b), (m, 1) each: F0 a + b of the mirrored light is reflected. roughness, cosine of view
    (m,)"""
    row = np.rint(np.clip(roughness, 0, 1) * (ROUGHNESSES - 1)).astype(int)
    column = np.rint(np.clip(cosine, 0, 1) * (COSINES - 1)).astype(int)
    entry = split_sum()[row, column]
    return entry[:, :1], entry[:, 1:]
