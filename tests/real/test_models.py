"""The public sample models: parts, materials and orientation as their makers describe them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from arfx.core.model import BLEND, MASK
from arfx.errors import InputError
from arfx.media.models import load_model

MODELS = (
    Path(__file__).parents[2].parent / "shared" / "data" / "models" / "mikedh-trimesh"
)
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not MODELS.is_dir(), reason=f"sample models are absent ({MODELS})"
    ),
]


@pytest.mark.parametrize(
    ("name", "faces", "up"),
    [("Duck.glb", 4212, "y"), ("CesiumMilkTruck.glb", 3624, "y"), ("AlphaBlendModeTest.glb", 61, "y"), ("fuze.obj", 1000, "y"),
     ("bunny.ply", 16301, "z"), ("suzanne.ply", 968, "z"), ("featuretype.STL", 3476, "z")],
)  # fmt: skip
def test_reads(name: str, faces: int, up: str) -> None:
    m = load_model(MODELS / name)
    left_out = ["animations"] if name == "CesiumMilkTruck.glb" else []
    assert (m.face_count, m.up, len(m.notices)) == (faces, up, len(left_out))
    assert all(
        what in notice for what, notice in zip(left_out, m.notices, strict=True)
    )
    for p in m.parts:
        v = p.vertices[p.faces]
        outward = (
            np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]) * p.normals[p.faces].sum(1)
        ).sum(1) > 0
        assert outward.mean() > 0.99, "winding and normals disagree"
        np.testing.assert_allclose(np.linalg.norm(p.normals, axis=1), 1, atol=1e-6)


def test_textures_and_alpha_modes() -> None:
    assert load_model(MODELS / "fuze.obj").parts[
        0
    ].material.base_texture.picture.shape == (
        1024,
        1024,
        4,
    )
    modes = [
        p.material.alpha_mode
        for p in load_model(MODELS / "AlphaBlendModeTest.glb").parts
    ]
    assert modes.count(BLEND) == 2 and modes.count(MASK) == 3
    truck = load_model(MODELS / "CesiumMilkTruck.glb")
    np.testing.assert_allclose(
        truck.parts[1].material.base_colour, [0, 0.0405063, 0.0212407, 1], atol=1e-6
    )


def test_the_duck_stands_upright() -> None:
    low, high = load_model(MODELS / "Duck.glb").bounds
    assert high[1] - low[1] == pytest.approx(1.54, abs=0.01), (
        "node scale of .01 is applied"
    )


def test_collada_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="dae is not a format that is read"):
        load_model(MODELS / "duck.dae")
