"""The scenes of sample_scenes/0041-indirect-light/path-traced: an outside path tracer's
pictures, and ours of the same.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import trimesh

from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light
from arfx.core.model import Material, Model, Part
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.plan.planner import plan_frame
from arfx.run.frame import run_frame
from arfx.stages import STAGES
from arfx.stages.gi import Gi, GiParams
from arfx.stages.lightmap import Lightmap
from arfx.stages.raster import Raster, RasterParams
from tests.scenes import box_model, facts
from tests.unit.stages.lightmap_scenes import ground_points, on_plane

FOLDER = (
    Path(__file__).parents[3]
    / "sample_scenes"
    / "0041-indirect-light"
    / "path-traced"
)
NAMES = ("coloured-box", "mirror-ball", "glowing-ball", "box-in-a-corner")
REGIONS = ("object", "contact", "plane")
NO_GI = "no gi"
CONTACT_M, PLANE_M = 0.11, 0.4  # from the foot's middle
EDGE_GREY = 6.0  # grey levels between neighbours


@dataclass(frozen=True, eq=False)
class Traced:
    """truth, plate : (h, w, 3) linear, with and without the object"""

    scene: Scene
    facts: FrameFacts
    truth: np.ndarray
    plate: np.ndarray


def read_linear(name: str) -> np.ndarray:
    coded = cv2.imread(str(FOLDER / f"{name}.png"), cv2.IMREAD_UNCHANGED)
    assert coded is not None and coded.dtype == np.uint16
    return SRGB.decode(coded[..., ::-1] / 65535.0).astype(np.float32)


@cache
def traced(name: str) -> Traced:
    document = tomllib.loads((FOLDER / "scenes.toml").read_text(encoding="utf-8"))
    c, light, told = document["camera"], document["light"], document["scene"][name]
    w, h, f = c["width"], c["height"], c["focal_px"]
    camera = Camera(
        w, h, np.array([[f, 0, w / 2 - 0.5], [0, f, h / 2 - 0.5], [0, 0, 1]])
    )
    forward = np.array(c["target"]) - np.array(c["eye"])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = Pose(rotation, -rotation @ np.array(c["eye"]))
    emission = tuple(told.get("emission", (0.0, 0.0, 0.0)))
    mirror = told.get("mirror", False)
    material = Material(
        base_colour=(*told["albedo"], 1.0), metallic=float(mirror), roughness=0.0 if mirror else 1.0, specular=0.0,
        emissive=emission,
    )  # fmt: skip
    model = box_model(material=material)
    if told["shape"] == "ball":
        b = trimesh.creation.icosphere(subdivisions=5)
        model = Model(
            (
                Part(
                    np.array(b.vertices),
                    np.array(b.faces, np.int32),
                    np.array(b.vertices),
                    material,
                ),
            ),
            up="z",
        )
    d = np.array(told["towards_lamp"]) / np.linalg.norm(told["towards_lamp"])
    lit = Light(
        tuple(light["ambient"]),
        (DirectionalLight(tuple(d.tolist()), tuple(light["lamp"]), 0.5),),
    )
    scene = on_plane(model, lit, camera)
    albedo = np.array(document["planes"]["albedo"])
    plate = np.broadcast_to(
        (albedo * lit.radiance(np.array([0, 0, 1.0]))).astype(np.float32), (h, w, 3)
    ).copy()
    if "wall_normal" in told:
        n = np.array(told["wall_normal"]) / np.linalg.norm(told["wall_normal"])
        wall = Pose(
            np.stack([np.cross([0, 0, 1], n), [0, 0, 1], n], 1),
            np.array(told["wall_point"]),
        )
        changed = {"floor": Pose.identity(), "wall": wall}
        scene = Scene(
            camera,
            model,
            scene.world_from_model,
            light=lit,
            world_from_marker=changed,
        )
        plate = read_linear(f"{name}-empty")
    return Traced(scene, facts(scene, pose), read_linear(name), plate)


# Lightmap's `high` would cost more than all of gi, for a tenth of a grey level where gi
# does not run.
BESIDE = {"raster": "high", "lightmap": "standard", "composite": "high"}


@cache
def kept(name: str, stage: str) -> ReadyStage:
    """A stage beside gi, with the shadow of the scene's lamp once that is made: for every run."""
    made = (
        Raster(RasterParams(backend="rays")) if stage == "raster" else STAGES[stage]()
    )
    return ReadyStage.of(
        made, traced(name).scene, level_named(made.levels, BESIDE[stage])
    )


def ours(name: str, level: str, samples: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """(picture (h, w, 3) linear, coverage (h, w)). level : of gi, or NO_GI"""
    t = traced(name)
    gi = level != NO_GI
    stages = {
        "raster": Raster(RasterParams(backend="rays")),
        "lightmap": Lightmap(),
    }
    stages["lightmap"].soft = not gi  # type: ignore[attr-defined]
    if gi:
        stages["gi"] = Gi(GiParams(samples=samples))  # type: ignore[assignment]
    stages["composite"] = STAGES["composite"]()
    wanted = {"gi": level, **BESIDE}
    levels = {n: level_named(s.levels, wanted[n]) for n, s in stages.items()}
    plan = plan_frame(
        list(stages.values()), levels, t.facts, t.scene, t.scene.camera.rect
    )
    ready = {
        n: replace(kept(name, n), stage=s) for n, s in stages.items() if n != "gi"
    }
    if gi:
        ready["gi"] = ReadyStage.of(stages["gi"], t.scene, levels["gi"])
    made = run_frame(
        np.ascontiguousarray(t.plate[plan.rect.slices]), t.facts, plan, ready
    )
    out = t.plate.copy()
    out[plan.changed.slices] = made.image
    coverage = made.layers.view(t.scene.camera.rect)[Layer.COVERAGE]
    return out, coverage


@cache
def regions(name: str) -> dict[str, np.ndarray]:
    """Masks by name. Left out: pixels that the object covers in part and those where the
    picture without indirect light has an edge or a highlight, as those are the raster's and
    lightmap's, whose lamp has a size."""
    t = traced(name)
    image, coverage = ours(name, NO_GI)
    shown = (255 * SRGB.encode(np.clip(image, 0, 1))).astype(np.float32)
    span = np.ones((3, 3), np.uint8)
    even = (cv2.dilate(shown, span) - cv2.erode(shown, span)).max(-1) < EDGE_GREY
    assert t.facts.camera_from_world is not None
    g = ground_points(t.scene, t.facts.camera_from_world)
    away = np.nan_to_num(np.hypot(g[..., 0], g[..., 1]), nan=np.inf)
    bare = (cv2.dilate((coverage > 0).astype(np.uint8), span) == 0) & even
    near = CONTACT_M if len(t.scene.world_from_marker) < 2 else 0.16
    return {
        "object": (coverage > 0.99) & even,
        "contact": bare & (away < near),
        "plane": bare & (away >= near) & (away < PLANE_M),
    }


def errors(
    name: str, level: str, samples: int = 64
) -> dict[str, tuple[float, float]]:
    """By region: (PSNR in dB, mean error in grey levels) of the pictures as shown."""
    t = traced(name)
    image, _ = ours(name, level, samples)
    off = 255 * (
        SRGB.encode(np.clip(image, 0, 1)) - SRGB.encode(np.clip(t.truth, 0, 1))
    )
    out = {}
    for region, mask in regions(name).items():
        e = off[mask]
        out[region] = (
            float(10 * np.log10(255**2 / max(float((e**2).mean()), 1e-9))),
            float(np.abs(e).mean()),
        )
    return out
