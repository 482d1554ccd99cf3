"""Shading by a dynamic light map, as printed: Tan, Chen, Sun 2009, equation (3) and the
shadows of section 2.3. The map itself, (2) and (4) to (9), is made by the analysis:
s1_light.py.

Lights are those at the peaks of the map M, without a size. A surface that all of them reach
shows M. Shadows are hard.

Not printed, chosen here: what a shadow takes. On the object as on the plane it is the
hidden lights' share of all lights and of the even light beside them. Phong's model is
named, not written down: its lobe is here as wide as the material's roughness makes it, its
strength what glTF's materials mirror seen from above.

Deviations. M comes from s1_light, with its own. Where the analysis has no map (a light that
is given) the light's own soft part and its lights are in its place."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from arfx.core.cube import CubeMap, look_up
from arfx.core.layers import Layers
from arfx.core.light import harmonics
from arfx.core.numerics import divide, normalise
from arfx.core.stage import View
from arfx.errors import RenderError
from arfx.stages.light.beams import FrameLight
from arfx.stages.lightmap import Lightmap
from arfx.stages.lightmap.shading import Surface
from arfx.stages.lightmap.stage import LightmapParams

LEAST_ROUGHNESS = 0.05
SHARPEST = 500.0


class PrintedLightmapParams(LightmapParams):
    formula: str = "paper"


def printed_map(light_map_: CubeMap | None) -> tuple[ndarray, ndarray] | None:
    """(cube (6, n, n, 3), map_from_world (3, 3)) of M; None where no map was written."""
    if light_map_ is None:
        return None
    cube = light_map_.faces().astype(np.float32)
    axes = np.reshape(
        np.eye(3) if light_map_.axes is None else light_map_.axes, (3, 3)
    )
    if (
        cube.shape[1] < 2
        or not np.isfinite(cube).all()
        or not np.isfinite(axes).all()
    ):
        raise RenderError(
            "facts: the light map needs faces of finite numbers, 2 x 2 or more"
        )
    return cube, axes


def phong(n: ndarray, v: ndarray, d: ndarray, roughness: ndarray) -> ndarray:
    """(p,) highlight of a light in direction d, seen from v: the cosine to its mirrored
    direction, to a power.
    """
    n_d = n @ d
    r_v = np.maximum(2 * n_d * (n * v).sum(-1) - v @ d, 1e-8)
    # a lobe about the mirrored direction is four times as wide as one about the half-vector
    width = np.maximum(roughness, LEAST_ROUGHNESS) ** 4
    return np.where(n_d > 0, r_v ** np.clip((2 / width - 2) / 4, 1, SHARPEST), 0)


class PrintedLightmap(Lightmap):
    levels = ("standard",)
    facts = frozenset({"pose", "light"})
    Params = PrintedLightmapParams
    hard = True

    def shaded(
        self,
        surface: Surface,
        soft_visibility: ndarray,
        visibility: ndarray,
        reaching: Sequence[int],
        light: FrameLight,
        view: View,
        now: Layers,
    ) -> ndarray:
        """(3): I(v) = g rho_v M(n_v) + b, with g = 1, times the share of the light that is
        not hidden.
        """
        covered = surface.coverage > 0
        n, rho_v, material = (
            a[covered] for a in (surface.normal, surface.albedo, surface.material)
        )
        metal, roughness, specular = np.split(material[:, :3], 3, 1)
        mirrored = 0.08 * specular * (1 - metal) + rho_v * metal
        eye = view.pose.inverse().translation_m
        v = normalise(eye - surface.position[covered])
        even = np.broadcast_to(light.ambient, n.shape)
        if len(light.soft):
            even = np.clip(harmonics(n) @ light.soft, 0, None)
        received = even * self.soft
        highlight = np.zeros(n.shape)
        for k, visible in zip(reaching, visibility, strict=True):
            d = light.towards[k]
            arrives = light.rgb[k] * light.on_object[k] * visible[covered][:, None]
            received = received + arrives * np.maximum(n @ d, 0)[:, None]
            highlight += arrives * phong(n, v, d, roughness[:, 0])[:, None]
        light_map_ = printed_map(view.facts.light_map)
        if light_map_ is not None:
            cube, map_from_world = light_map_
            M = np.maximum(look_up(cube, n @ map_from_world.T), 0)
            unhidden = even + np.maximum(n @ light.towards.T, 0) @ light.rgb
            received = M * divide(received, unhidden, where_zero=float(self.soft))
        I_v = rho_v * (1 - metal) * received + mirrored * highlight
        out = I_v + surface.emissive[covered] + np.array(view.facts.bias_rgb)
        virtual = np.zeros(surface.normal.shape, np.float32)
        virtual[covered] = surface.coverage[covered][:, None] * out
        return virtual
