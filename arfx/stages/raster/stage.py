"""Raster: the virtual object's geometry and material, pixel by pixel, as seen by the real camera.
No light here.

Two back ends say which faces are seen: `pyrender` (OpenGL) and `rays` (no OpenGL); all that follows
is the same code. Edge pixels: COVERAGE is the fraction covered; colours, materials and normals are
means over the covering samples only, never mixed with what is behind; DEPTH, POSITION and OBJECT_ID
belong to the pixel's centre, or to the covering sample next to it. MASK materials are cut out;
BLEND ones multiply COVERAGE by their opacity and are blended front to back; DEPTH is the nearest
layer's. OCCLUSION, COAT, SHEEN and SMOOTH_NORMAL are written where the model has any of them.
Two levels beside the reference: of the .3 to .5 grey levels that `standard` is off, half is
rounding to 8 bits, and four times the samples leave two thirds of them. `reference` is 256 rays in
every pixel, by rays whatever the back end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.settings import Settings, setting
from arfx.core.stage import Demand, Stage, View
from arfx.stages.raster.backends import choose_backend

if TYPE_CHECKING:
    from arfx.stages.raster.renderer import Renderer


class RasterParams(Settings):
    backend: Literal["auto", "pyrender", "rays"] = setting(
        "auto",
        "auto (pyrender where a graphics card runs OpenGL, else rays), pyrender or rays",
    )
    samples: int = setting(
        0,
        "in a pixel that an edge crosses, 1 to 256; 0 = by level (rays 4, 64; pyrender 9, 25,"
        " an odd square of them); a texture gets half as many taps along a pixel's side as"
        " there are samples along it",
        ge=0,
        le=256,
    )


class Raster(Stage):
    name = "raster"
    levels = ("draft", "standard", "reference")
    Params = RasterParams
    terms = ("frames", "mpx", "object_mpx", "texture_mpx", "mfaces")

    @classmethod
    def settled(cls, params: RasterParams) -> RasterParams:
        """With the back end that `auto` takes here."""
        return params.model_copy(
            update={"backend": choose_backend(params.backend).name}
        )

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        rect = facts.raster_box.clip(frame)
        return Demand(
            rect,
            f"model covers up to {rect.area} px"
            if not rect.empty
            else "model out of view",
        )

    def prepare(self, scene: Scene, level: str) -> Renderer:
        """Raises InputError for a model too large for the scene, RenderError where the
        chosen back end cannot open.
        """
        from arfx.stages.raster.renderer import Renderer

        backend = choose_backend(
            "rays" if level == "reference" else self.params.backend
        )
        samples = self.params.samples if level != "reference" else 0
        samples = samples or backend.samples[level]
        return Renderer(scene.mesh, scene.camera, backend.find_faces, samples)

    def run(self, view: View, prepared: Any) -> Mapping[Layer, ndarray]:
        rect, box = view.rect, view.facts.raster_box.clip(view.scene.camera.rect)
        shown = box.clip(rect)
        if shown.empty:
            return prepared.nothing(rect)
        area = shown if prepared.faces.any_rectangle else box
        layers: dict[Layer, ndarray] = prepared.render(area, view.pose)
        if area == rect:
            return layers
        out: dict[Layer, ndarray] = prepared.nothing(rect)
        for name in layers:
            out[name][shown.slices_in(rect)] = layers[name][shown.slices_in(area)]
        return out
