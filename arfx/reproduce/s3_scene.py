"""The scene of the rows of Jia, Tang 2013: teapot, cube and rabbit, of one model file, on a
desk with real things near and far.

`Shown` is a frame of it with the object in it, before it is painted: what either formula's
class is given."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.ndimage import binary_dilation

from arfx.core.colour import SRGB
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.pixels import Pixels
from arfx.core.scene import Scene
from arfx.core.stage import ReadyStage, View
from arfx.papers.s3_watercolor import PrintedWatercolor, PrintedWatercolorParams
from arfx.reproduce.work import Work
from arfx.stages.watercolor import Watercolor
from arfx.stages.watercolor.params import WatercolorParams

CELL_PX = 8
OBJECTS = ("teapot", "cube", "rabbit")
SCENE = """
seed = 3
[clip]
file = "clip.mkv"
width = {width}
height = {height}
fps = 24
[lens]
fov_deg = 52
[[shot]]
frames = 1
[shot.path]
kind = "static"
position_m = [-0.02, -0.46, 0.27]
target_m = [0.0, 0.02, 0.05]
[[plane]]
size_m = [1.6, 1.2]
position_m = [0, 0.1, "-0.2mm"]
texture = {{ kind = "wood", colour = [0.20, 0.11, 0.06], second = [0.60, 0.42, 0.26], feature_m = "2cm" }}
[[plane]]
size_m = [9, 2.6]
position_m = [0, 1.5, 0.6]
rotate_deg = [90, 0, 0]
texture = {{ kind = "poster", feature_m = "12cm" }}
[[box]]
size_m = ["12cm", "17cm", "4cm"]
position_m = [-0.27, 0.16, 0]
rotate_deg = [0, 0, 18]
texture = {{ kind = "noise", colour = [0.35, 0.04, 0.03], second = [0.60, 0.12, 0.06], feature_m = "1cm" }}
[[box]]
size_m = ["4cm", "4cm", "8cm"]
position_m = [0.12, -0.20, 0]
rotate_deg = [0, 0, 25]
texture = {{ kind = "noise", colour = [0.05, 0.20, 0.30], second = [0.12, 0.42, 0.55], feature_m = "1cm" }}
[[sphere]]
radius_m = "4cm"
position_m = [0.24, 0.22, 0.04]
colour = [0.75, 0.28, 0.03]
[[marker]]
spec = "36h11:3:100mm"
[light]
ambient_rgb = [0.30, 0.32, 0.35]
lamps = [{{ azimuth_deg = -140, elevation_deg = 50, rgb = [0.56, 0.53, 0.48], angular_size_deg = 5 }}]
[depth]
file = "depth.mkv"
noise = 0.004
[model]
shape = "block"
fit = "12cm"
[job]
stages = ["lightmap", "watercolor"]
[job.settings.light]
given = [-140, 50]
"""


class Shown(NamedTuple):
    """layers : that the watercolour reads, and the objects' numbers, of the whole frame
    real : (h, w, 3) uint8, the camera's"""

    layers: Layers
    facts: FrameFacts
    scene: Scene
    real: np.ndarray

    @property
    def image(self) -> np.ndarray:
        """(h, w, 3) float32 coded: the frame with the objects."""
        return coded(self.layers[Layer.IMAGE])

    def ready(self, stage: Watercolor) -> ReadyStage:
        return ReadyStage.of(stage, self.scene, "standard")

    def view(self, stage: Watercolor) -> View:
        return self.ready(stage).view(self.layers, self.facts)

    def painted(self, ready: ReadyStage) -> np.ndarray:
        """(h, w, 3) float32 coded. ready : keeps what frames share"""
        return coded(ready.run(self.layers, self.facts)[Layer.IMAGE])

    def paint_anew(self, ready: ReadyStage) -> None:
        """For timing."""
        ready.memo.of_frame.clear()
        ready.run(self.layers, self.facts)

    def toon_shaded(self, stage: Watercolor) -> np.ndarray:
        """(h, w, 3) float32 coded: the frame with the objects toon-shaded by either formula."""
        if isinstance(stage, PrintedWatercolor):
            return stage.frame(self.view(stage))
        return coded(stage.with_toon(self.view(stage)))

    def noisy(self, index: int, sigma: float) -> Shown:
        """The same moment once more, as frame `index` of a resting camera: with other noise."""
        g = np.random.default_rng(index)
        noisy = np.clip(self.image + g.normal(0, sigma, self.image.shape), 0, 1)
        rect = self.layers.rect
        image = SRGB.decode(noisy).astype(np.float32)
        layers = Layers(
            rect, {**self.layers.written, Layer.IMAGE: Pixels(rect, image)}
        )
        return self._replace(layers=layers, facts=replace(self.facts, index=index))

    def objects(self) -> dict[str, np.ndarray]:
        """(h, w) bool of the pixels of each object: the model's parts from left to right."""
        middle = np.array([p.vertices[:, 0].mean() for p in self.scene.model.parts])
        place = (middle - middle.min()) / np.ptp(
            middle
        )  # teapot, then cube, then rabbit
        kind = np.append(-1, (place >= 0.5).astype(int) + (place >= 1))
        number = kind[self.layers[Layer.OBJECT_ID]]
        return {name: number == k for k, name in enumerate(OBJECTS)}

    def real_outlines(self) -> np.ndarray:
        """(h, w) bool: pixels that are nearer by a tenth than one beside them, of the real
        scene beside the objects.
        """
        depth = self.layers[Layer.REAL_DEPTH]
        own = self.layers[Layer.COVERAGE] > 0
        farther = cv2.dilate(depth, np.ones((3, 3), np.uint8))
        return (farther > 1.1 * depth) & ~binary_dilation(own, np.ones((9, 9)))


def coded(linear: np.ndarray | Pixels) -> np.ndarray:
    """(h, w, 3) float32."""
    return SRGB.encode(np.clip(np.asarray(linear), 0, 1)).astype(np.float32)


def shown(work: Work) -> Shown:
    """The scene's frame up to the composite, lit by the corrected method: both formulas'
    classes paint the same picture.
    """
    width, height = work.scaled((640, 360), (240, 136))
    clip = work.clip(SCENE.format(width=width, height=height))
    model = {"file": work.model("group"), "fit": "26cm"}
    shot = work.shot(clip, {"model": model})
    layers = shot.renderer.after(shot.up_to("watercolor")[:-1]).view(
        shot.renderer.window
    )
    return Shown(layers, shot.facts, shot.job.scene, shot.renderer.original())


def cells_of(shown: Shown) -> tuple[int, int]:
    """m, n: rows and columns of cells of about CELL_PX."""
    rect = shown.layers.rect
    return max(round(rect.height / CELL_PX), 1), max(round(rect.width / CELL_PX), 1)


def printed(**settings: Any) -> PrintedWatercolor:
    return PrintedWatercolor(PrintedWatercolorParams(cell_px=CELL_PX, **settings))


def corrected(**settings: Any) -> Watercolor:
    return Watercolor(WatercolorParams(**settings))


EFFECTS = "wash lines lightness deepest edge_darkening flow wobble_px grain"
# cells alone
FLAT = {"saturation": 1.0, "toon": False, **dict.fromkeys(EFFECTS.split(), 0.0)}
