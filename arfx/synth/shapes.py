"""Models made by rule, for samples, tests and benches: written as GLB, metres, y up.

`shapes.toml` lists the parts of each, and says what a part may be."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from arfx.errors import ConfigError

_LISTED = tomllib.loads(Path(__file__).with_name("shapes.toml").read_text("utf-8"))
_GREY = (0.7, 0.7, 0.7)
SHAPES: Mapping[str, list[dict[str, Any]]] = _LISTED | {
    f"icosphere{n}": [{"icosphere": {"subdivisions": n, "radius": 0.5}, "rgb": _GREY}]
    for n in range(1, 8)
}


def write_model(name: str, path: Path) -> int:
    """Write a shape as GLB; returns its number of faces. icosphereN has 20·4^N.
    Raises ConfigError for an unknown name."""
    if name not in SHAPES:
        raise ConfigError(
            f"there is no shape {name!r}", f"one of {', '.join(SHAPES)}"
        )
    import trimesh

    scene = trimesh.Scene([_mesh(part) for part in SHAPES[name]])
    path.write_bytes(scene.export(file_type="glb"))
    return sum(len(g.faces) for g in scene.geometry.values())


def _mesh(part: Mapping[str, Any]) -> Any:
    from PIL import Image
    from trimesh import Trimesh, creation
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    uv = picture = None
    if "flag" in part:
        # both sides, so that no back end needs double-sided materials
        faces = [[0, 3, 1], [1, 3, 2], [4, 5, 7], [5, 6, 7]]
        mesh = Trimesh(part["flag"] * 2, faces, process=False)
        uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]] * 2, float)
        light = sum(np.indices((96, 128, 1)) // 16) % 2
        colours = np.where(light, [235, 235, 235], [20, 110, 40])
        picture = Image.fromarray(colours.astype(np.uint8))
    elif "cushion" in part:
        mesh = creation.icosphere(3)
        bulge = np.sign(mesh.vertices) * np.abs(mesh.vertices) ** 0.35
        mesh.vertices = bulge / np.abs(bulge).max(0) * np.array(part["cushion"]) / 2
    else:
        kind = next(iter(part))
        mesh = getattr(creation, kind)(**part[kind])
        if kind == "box":
            mesh.unmerge_vertices()
    mesh.apply_translation(part.get("at", (0, 0, 0)))
    material = PBRMaterial(
        name=f"{part['rgb']}",
        baseColorFactor=[*part["rgb"], 1.0],
        metallicFactor=part.get("metallic", 0.0),
        roughnessFactor=part.get("roughness", 0.7),
        baseColorTexture=picture,
    )
    uv = np.zeros((len(mesh.vertices), 2)) if uv is None else uv
    mesh.visual = TextureVisuals(uv=uv, material=material)
    return mesh
