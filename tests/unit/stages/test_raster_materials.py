"""Whole materials in the layers: normal maps, both UV sets, transforms, samplers, and what
few models have.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.core.layers import Layer
from arfx.core.model import Material, Part, Texture
from arfx.core.rect import Rect
from tests.unit.stages.raster_scenes import PLAIN, in_front, render, scene_of, square

WHITE = Material(base_colour=(1, 1, 1, 1), double_sided=True)
MIDDLE = Rect(130, 110, 172, 152)
AT = (131 - 110, 151 - 130)


def textured(material: Material, **more: np.ndarray) -> Part:
    """A square from -.2 to .2 m, the picture upright on it, tangents along x."""
    part = square(0.2, 0, material)
    return replace(part, tangents=np.tile([1.0, 0, 0, 1], (4, 1)), **more)


def flat(r: int, g: int, b: int, a: int = 255) -> Texture:
    return Texture(np.full((4, 4, 4), (r, g, b, a), np.uint8))


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_normal_map_bends_the_normal_to_the_pictures_right_and_up(
    scale: float,
) -> None:
    material = replace(WHITE, normal_texture=flat(204, 166, 230), normal_scale=scale)
    out = render(scene_of([textured(material)]), in_front(), "rays", rect=MIDDLE)
    expected = (2 * np.array([204, 166, 230]) / 255 - 1) * [scale, scale, 1]
    np.testing.assert_allclose(
        out[Layer.NORMAL][AT], expected / np.linalg.norm(expected), atol=1e-3
    )
    np.testing.assert_allclose(out[Layer.SMOOTH_NORMAL][AT], [0, 0, 1], atol=1e-6)


def test_a_mirrored_tangent_turns_the_maps_up() -> None:
    material = replace(WHITE, normal_texture=flat(128, 200, 230))
    parts = (
        replace(textured(material), tangents=np.tile([1.0, 0, 0, sign], (4, 1)))
        for sign in (1, -1)
    )
    up, down = (
        render(scene_of([part]), in_front(), "rays", rect=MIDDLE) for part in parts
    )
    assert up[Layer.NORMAL][AT][1] > 0.3
    np.testing.assert_allclose(
        down[Layer.NORMAL][AT], up[Layer.NORMAL][AT] * [1, -1, 1], atol=1e-2
    )


def gradient() -> np.ndarray:
    """Red grows to the right, green downwards."""
    row, column = np.mgrid[:64, :64] * 4
    return np.stack([column, row, 0 * row, 0 * row + 255], -1).astype(np.uint8)


def test_each_texture_lies_by_its_own_coordinates_and_transform() -> None:
    second = np.array([[0.25, 0.25]] * 4)
    turned = np.array([[0.0, 1, 0], [1, 0, 0]])  # swaps u and v
    material = replace(
        PLAIN,
        base_colour=(1, 1, 1, 1),
        metallic=1.0,
        roughness=1.0,
        metallic_roughness_texture=Texture(
            gradient()[..., [2, 0, 1, 3]], 0, turned
        ),  # roughness = red, metallic = green
        emissive=(1.0, 1.0, 1.0),
        emissive_texture=Texture(gradient(), 1),
    )
    out = render(
        scene_of([textured(material, second_uv=second)]),
        in_front(),
        "rays",
        rect=Rect(100, 100, 210, 150),
    )
    roughness, metallic = out[Layer.MATERIAL][20, :, 1], out[Layer.MATERIAL][20, :, 0]
    assert np.ptp(roughness) < 0.01 and np.ptp(metallic) > 0.5, (
        "turned: red grows downwards"
    )
    glow = out[Layer.EMISSIVE][20]
    assert (
        np.ptp(glow, axis=0).max() < 1e-6
        and glow[0, 0] == pytest.approx(glow[0, 1], abs=1e-5)
        and glow[0, 0] > 0.02
    )


def test_nearest_texels_show_as_squares() -> None:
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[:, 1::2] = 255
    part = square(0.2, 0, replace(WHITE, base_texture=Texture(picture, nearest=True)))
    row = render(scene_of([part]), in_front(), "rays", samples=1)[Layer.ALBEDO][
        131, 100:200, 0
    ]
    assert set(np.round(row, 6)) == {0.0, 1.0}


def test_extras_are_written_where_the_model_has_them() -> None:
    material = replace(
        WHITE,
        occlusion_texture=flat(51, 0, 0),
        occlusion_strength=0.5,
        clearcoat=0.8,
        clearcoat_texture=flat(128, 0, 0),
        clearcoat_roughness=0.4,
        clearcoat_roughness_texture=flat(0, 64, 0),
        sheen_colour=(0.2, 0.4, 0.6),
        sheen_roughness=0.5,
        sheen_roughness_texture=flat(0, 0, 0, 128),
    )
    out = render(
        scene_of([textured(material), square(0.05, 0.1, PLAIN)]), in_front(), "rays"
    )
    beside = (131, 151 + 40)
    assert out[Layer.OCCLUSION][beside] == pytest.approx(1 - 0.5 * 0.8, abs=1e-4)
    np.testing.assert_allclose(
        out[Layer.COAT][beside], [0.8 * 128 / 255, 0.4 * 64 / 255], atol=1e-4
    )
    np.testing.assert_allclose(
        out[Layer.SHEEN][beside], [0.2, 0.4, 0.6, 0.5 * 128 / 255], atol=1e-4
    )
    inside, nothing = (131, 151), (5, 5)
    for at in (inside, nothing):
        assert (
            out[Layer.OCCLUSION][at] == 1
            and not out[Layer.COAT][at].any()
            and not out[Layer.SHEEN][at].any()
        )
    assert Layer.COAT not in render(
        scene_of([square(0.05, 0.1, PLAIN)]), in_front(), "rays"
    )
