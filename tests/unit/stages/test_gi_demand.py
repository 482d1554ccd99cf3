"""What `gi` leaves out, why, and that nobody can see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.core.model import Material, Texture
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.gi import Gi, GiParams
from arfx.stages.gi import stage as stage_module
from tests.scenes import facts
from tests.unit.stages.gi_scenes import CAMERA, LAMP, MATT_RED, MATT_WHITE, ball, box, from_above, on_plane, run_gi

GREY = Material(base_colour=(0.5, 0.5, 0.5, 1.0), specular=0.0, roughness=1.0)


def far(model: Material, distance_m: float = 90.0) -> tuple:  # type: ignore[type-arg]
    s = on_plane(box(model), LAMP, CAMERA)
    return s, from_above(35, distance_m)


def test_a_grey_matt_object_of_a_few_pixels_needs_no_cones(monkeypatch: pytest.MonkeyPatch) -> None:
    s, pose = far(GREY)
    f = facts(s, pose)
    told = Gi().demand(f, s, CAMERA.rect)
    assert "no cones: the model is matt and grey, and what it changes is" in told.reason and told.rect.area < 100
    made = run_gi(s, pose=pose)
    monkeypatch.setattr(stage_module, "SMALL_PX", 0)
    full = run_gi(s, pose=pose)
    assert "no cones" not in Gi().demand(f, s, CAMERA.rect).reason
    shown = [
        SRGB.encode(np.clip(m[Layer.VIRTUAL] + (1 - m[Layer.COVERAGE][..., None]) * 0.5 * m[Layer.SHADOW], 0, 1))
        for m in (made, full)
    ]
    off = 255 * np.abs(shown[0] - shown[1])
    assert off.max() < 12 and (off.max(-1) > 0.5).sum() <= 6, "within a few pixels"


@pytest.mark.parametrize(
    "material",
    [
        MATT_RED, replace(GREY, specular=0.5), replace(GREY, metallic=1.0), replace(GREY, emissive=(0.1, 0.1, 0.1)),
        replace(GREY, base_texture=Texture(np.zeros((2, 2, 4), np.uint8))),
    ],
)  # fmt: skip
def test_what_colours_glows_or_mirrors_keeps_its_cones(material: Material) -> None:
    s, pose = far(material)
    assert "no cones" not in Gi().demand(facts(s, pose), s, CAMERA.rect).reason
    s, pose = far(GREY)
    assert "no cones" not in Gi(GiParams(plane_gloss=0.2)).demand(facts(s, pose), s, CAMERA.rect).reason
    s, pose = far(GREY, 25.0)
    assert "no cones" not in Gi().demand(facts(s, pose), s, CAMERA.rect).reason


def test_nothing_where_the_object_is_out_of_view() -> None:
    s = on_plane(box(GREY), LAMP, CAMERA)
    f = facts(s, from_above())
    aside = f.with_(camera_from_world=Pose(from_above().rotation, np.array([40.0, 0, 0.6])), model_box=Rect(0, 0, 0, 0))
    told = Gi().demand(aside, s, CAMERA.rect)
    assert told.rect.empty and "out of view" in told.reason


@pytest.mark.parametrize("shape", [ball, box])
def test_no_mirror_cone_where_it_would_not_show(shape, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    """A faint gloss: cones for grazing views alone, and no pixel is off by half a grey level."""
    s = on_plane(shape(replace(MATT_WHITE, specular=0.01, roughness=0.7)), LAMP, CAMERA)
    gathered: list[int] = []
    real = stage_module.gather_points

    def counted(points, wanted, *rest):  # type: ignore[no-untyped-def]
        gathered.append(int((wanted & 2).astype(bool).sum()))
        return real(points, wanted, *rest)

    monkeypatch.setattr(stage_module, "gather_points", counted)
    monkeypatch.setattr(stage_module, "SHOWS", 0.0)
    full = run_gi(s)[Layer.VIRTUAL]
    every = sum(gathered)
    monkeypatch.undo()
    monkeypatch.setattr(stage_module, "gather_points", counted)
    gathered.clear()
    made = run_gi(s)[Layer.VIRTUAL]
    assert every > 100 and sum(gathered) < 0.95 * every
    assert 255 * np.abs(SRGB.encode(np.clip(made, 0, 1)) - SRGB.encode(np.clip(full, 0, 1))).max() < 0.5
    gathered.clear()
    run_gi(on_plane(shape(replace(GREY, specular=0.5, roughness=0.3)), LAMP, CAMERA))
    assert sum(gathered) > 100
