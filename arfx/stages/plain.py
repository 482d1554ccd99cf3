"""The default light: ambient from above and below, one soft direction, and a highlight on glossy materials.

Used where no light is measured. Diffuse plus Blinn-Phong with Schlick's Fresnel; the metallic-roughness model of
glTF 2.0 decides how much of each. Cost: O(covered pixels). Leaves out: shadows on the object itself, reflections.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from arfx.core.cost import Cost
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Level, Window
from arfx.errors import ConfigError


@dataclass(frozen=True)
class PlainParams:
    """gain : multiplies the default light, 1 = a white surface that faces the light is nearly white
    sky : how much more ambient light comes from above than from below, 0..1
    """

    gain: float = 1.0
    sky: float = 0.35

    def __post_init__(self) -> None:
        if not 0 <= self.gain <= 1e4:
            raise ConfigError(f"plain.gain must be between 0 and 10000, is {self.gain:g}")
        if not 0 <= self.sky <= 1:
            raise ConfigError(f"plain.sky must be between 0 and 1, is {self.sky:g}")


class Plain:
    name = "plain"
    reads = frozenset({Layer.COVERAGE, Layer.NORMAL, Layer.POSITION, Layer.ALBEDO, Layer.MATERIAL, Layer.EMISSIVE})
    writes = frozenset({Layer.VIRTUAL})
    levels = (Level("standard", 0.02),)
    needs_facts = frozenset({"pose"})
    reach = 0
    Params = PlainParams

    def __init__(self, params: PlainParams | None = None) -> None:
        self.params = params or PlainParams()

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        if facts.camera_from_world is None or facts.opacity <= 0:
            return Demand(EMPTY, "marker not visible")
        rect = facts.drawn_box.clip(frame)
        return Demand(rect, "model is lit" if not rect.empty else "model out of view")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Rect:
        return out

    def cost(self, need: Rect, facts: FrameFacts, scene: Scene, level: Level) -> Cost:
        return Cost(level.seconds_per_mpx * need.area / 1e6, need.area * 4.0 * 20)

    def prepare(self, scene: Scene, level: Level) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        light = scene.light
        g = self.params.gain
        directions = np.array([li.unit for li in light.lights], float).reshape(-1, 3)
        colours = np.array([li.rgb for li in light.lights], float).reshape(-1, 3) * g
        up = scene.world_from_anchor.rotation[:, 2]
        ambient = np.asarray(light.ambient_rgb, float) * g
        f32 = np.float32
        return directions.astype(f32), colours.astype(f32), ambient.astype(f32), up.astype(f32)

    def run(
        self, window: Window, scene: Scene, prepared: Any, level: Level, rng: np.random.Generator
    ) -> Mapping[Layer, np.ndarray]:
        now, pose = window.now, window.facts[-1].camera_from_world
        directions, colours, ambient, up = prepared
        assert pose is not None
        eye = pose.inverse().translation_m
        virtual = _shade(
            now[Layer.COVERAGE], now[Layer.NORMAL], now[Layer.POSITION],
            now[Layer.ALBEDO], now[Layer.MATERIAL], now[Layer.EMISSIVE],
            eye.astype(np.float32), directions, colours, ambient, up, np.float32(self.params.sky),
        )  # fmt: skip
        return {Layer.VIRTUAL: virtual}


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "arcp"})
def _shade(
    coverage, normal, position, albedo, material, emissive, eye, directions, colours, ambient, up, sky
):  # pragma: no cover - compiled
    out = np.zeros(albedo.shape, np.float32)
    one, zero = np.float32(1), np.float32(0)
    for y in range(coverage.shape[0]):
        for x in range(coverage.shape[1]):
            cov = coverage[y, x]
            if cov <= 0:
                continue
            nx, ny, nz = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            vx, vy, vz = eye[0] - position[y, x, 0], eye[1] - position[y, x, 1], eye[2] - position[y, x, 2]
            length = np.sqrt(vx * vx + vy * vy + vz * vz)
            if length > 0:
                vx, vy, vz = vx / length, vy / length, vz / length
            metallic, rough, specular = material[y, x, 0], max(material[y, x, 1], np.float32(0.05)), material[y, x, 2]
            r2 = rough * rough
            # Blinn exponent of the GGX width roughness^2
            shininess = min(max(np.float32(2) / (r2 * r2) - np.float32(2), one), np.float32(2000))
            high = one + sky * (nx * up[0] + ny * up[1] + nz * up[2])
            base, matt = np.float32(0.08) * specular * (one - metallic), one - metallic
            for c in range(3):
                a = albedo[y, x, c]
                # without a picture of the surroundings a metal reflects the ambient light only
                out[y, x, c] = (a * matt + base + a * metallic) * ambient[c] * high + emissive[y, x, c]
            for k in range(directions.shape[0]):
                lx, ly, lz = directions[k, 0], directions[k, 1], directions[k, 2]
                nl = nx * lx + ny * ly + nz * lz
                if nl <= 0:
                    continue
                hx, hy, hz = lx + vx, ly + vy, lz + vz
                hl = np.sqrt(hx * hx + hy * hy + hz * hz)
                lobe, grazing = zero, zero
                if hl > 0:
                    nh = max((nx * hx + ny * hy + nz * hz) / hl, zero)
                    vh = one - min(max((vx * hx + vy * hy + vz * hz) / hl, zero), one)
                    lobe = (shininess + np.float32(8)) / np.float32(8) * nh**shininess
                    grazing = vh * vh * vh * vh * vh
                for c in range(3):
                    a = albedo[y, x, c]
                    f0 = base + a * metallic
                    out[y, x, c] += (a * matt + (f0 + (one - f0) * grazing) * lobe) * colours[k, c] * nl
            for c in range(3):
                out[y, x, c] *= cov
    return out
