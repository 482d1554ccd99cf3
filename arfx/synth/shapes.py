"""Models made by rule, for samples, tests and benches: written as GLB, metres, y up."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from arfx.errors import ConfigError

Rgb = tuple[float, float, float]
Place = tuple[float, ...]


def _coloured(
    mesh: Any,
    rgb: Rgb,
    metallic: float = 0.0,
    roughness: float = 0.7,
    texture: Any = None,
    uv: np.ndarray | None = None,
) -> Any:
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    material = PBRMaterial(
        baseColorFactor=[*rgb, 1.0],
        metallicFactor=metallic,
        roughnessFactor=roughness,
        baseColorTexture=texture,
        name=f"{rgb}",
    )
    mesh.visual = TextureVisuals(
        uv=np.zeros((len(mesh.vertices), 2)) if uv is None else uv, material=material
    )
    return mesh


def _rounded_box(size: Rgb, at: Place, rgb: Rgb) -> Any:
    """A box whose edges are cut by a sphere's curvature: shows soft shading, 1,280 faces."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    v = ball.vertices
    cushion = np.sign(v) * np.abs(v) ** 0.35
    ball.vertices = cushion / np.abs(cushion).max(0) * np.array(size) / 2 + np.array(at)
    return _coloured(ball, rgb)


def _robot() -> list[Any]:
    """A toy robot: white body, red chest light, blue arms, dark feet, a chequered flag in
    its left hand; about 5,000 faces.
    """
    import trimesh
    from PIL import Image

    def cylinder(radius: float, start: Place, end: Place, *look: Any) -> Any:
        axis = np.array([start, end])
        mesh = trimesh.creation.cylinder(radius=radius, segment=axis, sections=32)
        return _coloured(mesh, *look)

    def ball(radius: float, at: Place, *look: Any) -> Any:
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
        mesh.apply_translation(at)
        return _coloured(mesh, *look)

    blue, dark, red = (0.05, 0.2, 0.6), (0.05, 0.05, 0.06), (0.8, 0.03, 0.03)
    steel = (0.6, 0.6, 0.62), 0.6, 0.35
    parts = [
        _rounded_box((0.5, 0.5, 0.34), (0, 0.55, 0), (0.85, 0.85, 0.82)),
        _rounded_box((0.38, 0.28, 0.3), (0, 0.98, 0), (0.9, 0.55, 0.05)),
        cylinder(0.07, (0, 0.75, 0), (0, 0.88, 0), *steel),
        cylinder(0.012, (0, 1.1, 0), (0, 1.26, 0), *steel),
        ball(0.035, (0, 1.28, 0), red),
        ball(0.06, (0.1, 0.6, 0.165), red),
    ]
    for side in (-1, 1):
        parts += [
            ball(0.045, (side * 0.09, 1.0, 0.135), dark),
            ball(0.085, (side * 0.3, 0.7, 0), blue),
            cylinder(0.05, (side * 0.3, 0.7, 0), (side * 0.42, 0.45, 0.06), blue),
            ball(0.065, (side * 0.42, 0.45, 0.06), *steel),
            cylinder(0.075, (side * 0.13, 0.08, 0), (side * 0.13, 0.35, 0), blue),
            _rounded_box((0.2, 0.12, 0.3), (side * 0.13, 0.06, 0.04), dark),
        ]
    parts.append(cylinder(0.012, (0.42, 0.3, 0.06), (0.42, 1.05, 0.06), *steel))
    squares = (np.indices((6, 8)).sum(0) % 2).astype(np.uint8)
    pixels = np.kron(
        np.where(squares[..., None], [235, 235, 235], [20, 110, 40]), np.ones((16, 16, 1))
    ).astype(np.uint8)
    corners = np.array(
        [[0.42, 1.05, 0.06], [0.72, 1.05, 0.06], [0.72, 0.83, 0.06], [0.42, 0.83, 0.06]]
    )
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]] * 2, float)
    # both sides, so that no back end needs double-sided materials
    faces = [[0, 3, 1], [1, 3, 2], [4, 5, 7], [5, 6, 7]]
    flag = trimesh.Trimesh(np.concatenate([corners, corners]), faces, process=False)
    picture = Image.fromarray(pixels)
    parts.append(_coloured(flag, (1.0, 1.0, 1.0), texture=picture, uv=uv))
    return parts


def _icosphere(subdivisions: int) -> list[Any]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    return [_coloured(ball, (0.7, 0.7, 0.7))]


def _block() -> list[Any]:
    import trimesh

    box = trimesh.creation.box((1.0, 1.0, 1.0))
    box.unmerge_vertices()
    box.apply_translation((0, 0.5, 0))
    return [_coloured(box, (0.7, 0.35, 0.1))]


SHAPES: dict[str, Callable[[], list[Any]]] = {
    "robot": _robot,
    "block": _block,
    **{f"icosphere{n}": partial(_icosphere, n) for n in range(1, 8)},
}


def write_model(name: str, path: Path) -> int:
    """Write a shape as GLB; returns its number of faces. icosphereN has 20·4^N.
    Raises ConfigError for an unknown name."""
    if name not in SHAPES:
        raise ConfigError(f"there is no shape {name!r}", f"one of {', '.join(SHAPES)}")
    import trimesh

    scene = trimesh.Scene(SHAPES[name]())
    path.write_bytes(scene.export(file_type="glb"))
    return sum(len(g.faces) for g in scene.geometry.values())
