"""Pictures for the tests of stage dof: a textured real scene, a box on its marker, all
layers of a frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.model import Material
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, level_named
from arfx.plan.planner import plan_frame
from arfx.run.frame import ready_stages, run_frame
from arfx.stages import STAGES
from arfx.stages.dof import Dof
from tests.scenes import box_model, camera, facts, layers_of, look_at, scene

MAKING = ("raster", "lightmap", "composite")


@dataclass(frozen=True, eq=False)
class Shot:
    """scene, facts of its one frame, and the layers that dof reads, over the whole frame."""

    scene: Scene
    facts: FrameFacts
    layers: Layers


def texture(
    height: int, width: int, seed: int = 1, highlights: float = 0.0
) -> np.ndarray:
    """(h, w, 3) linear light: noise of several sizes with hard edges, as pictures have; few
    pixels of `highlights`.
    """
    g = np.random.default_rng(seed)
    out = np.full((height, width, 3), 0.25)
    for sigma, share in ((1.0, 0.08), (3.0, 0.1), (9.0, 0.15)):
        noise = gaussian_filter(g.normal(size=(height, width, 3)), (sigma, sigma, 0))
        out += share * noise / noise.std()
    bars = gaussian_filter(g.normal(size=(height, width)), 6) > 0
    out = np.where(bars[..., None], out, 0.4 * out)
    out = np.clip(gaussian_filter(out, (0.5, 0.5, 0)), 0.01, 0.9)
    if highlights > 0:
        out[g.random((height, width)) < 1 / 900] = highlights
    return out.astype(np.float32)


@cache
def shot(
    kind: str = "plain",
    width: int = 320,
    height: int = 240,
    fit_m: float = 0.14,
    tilt_deg: float = 40.0,
) -> Shot:
    """kind : plain, highlights (50 x white), bright (an object that is seen against a dark
    plate)
    """
    cam = camera(width, height, (0.05, -0.02, 0.001, 0.0005))
    colour = (0.9, 0.25, 0.1, 1.0) if kind != "bright" else (1.0, 1.0, 1.0, 1.0)
    s = scene(cam, box_model(material=Material(base_colour=colour)), fit_m)
    return compose(
        s,
        facts(s, look_at(0.5, tilt_deg)),
        texture(height, width, highlights=50.0 if kind == "highlights" else 0.0),
    )


def compose(s: Scene, f: FrameFacts, plate: np.ndarray) -> Shot:
    """Run the stages before dof on the whole frame."""
    stages = {name: STAGES[name]() for name in MAKING}
    levels = {
        name: level_named(
            stages[name].levels, "high" if name == "raster" else "standard"
        )
        for name in MAKING
    }
    plan = plan_frame(list(stages.values()), levels, f, s, s.camera.rect, skip=False)
    made = run_frame(plate, f, plan, ready_stages(plan, stages, s))
    layers = made.layers.view(s.camera.rect)
    return Shot(s, f, layers)


def blurred(
    at: Shot, level: str, seconds: list[float] | None = None, made: type[Dof] = Dof, **params: object
) -> np.ndarray:  # fmt: skip
    """IMAGE (h, w, 3) of dof over the whole frame."""
    import time

    ready = ReadyStage.of(
        made(made.Params(**params)), at.scene, level_named(made.levels, level)
    )
    start = time.perf_counter()
    out = ready.run(at.layers, at.facts)[Layer.IMAGE]
    if seconds is not None:
        seconds.append(time.perf_counter() - start)
    return out.part(at.layers.rect) if isinstance(out, Pixels) else out


def with_layers(at: Shot, **arrays: np.ndarray) -> Shot:
    """Some layers replaced, by name; PLATE also as IMAGE unless that is given."""
    new = {Layer(k): v for k, v in arrays.items()}
    return Shot(at.scene, at.facts, layers_of(at.layers.rect, new, at.layers))


def moved(at: Shot, pose: Pose) -> Shot:
    return compose(
        at.scene, facts(at.scene, pose), np.asarray(at.layers[Layer.PLATE])
    )
