"""Scenes that an outside renderer has rendered too: balls of five materials, and models
that stand on a plane, in three lights.

Models are glTF binaries and surroundings Radiance pictures, so that both renderers read the
same files. All are made anew by these functions: only what the outside renderer made of
them is committed, beside this file. WORLD axes: z up, metres.

    python -m tests.outside.scenes FOLDER    # writes what tools/outside_render.py reads
"""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

BALL_RADIUS_M = 0.05
SIZE_M = 0.08  # of a model that stands on the plane
WALL_M, OPEN_RAD = (
    0.002,
    np.pi / 4,
)  # of the thin wall, bent to a tube: thickness, half of its slit
NEAR = 0.05  # of a model's size: how far from its contact the plane is looked at
PLANE_ALBEDO = 0.5

Mesh = tuple[
    np.ndarray, np.ndarray, np.ndarray, np.ndarray
]  # vertices, normals, uv, faces


@dataclass(frozen=True)
class Camera:
    """Pinhole, its principal point in the picture's middle; it looks from `eye_m` to `target_m`."""

    width: int
    height: int
    focal_px: float
    eye_m: tuple[float, float, float]
    target_m: tuple[float, float, float]


@dataclass(frozen=True)
class OutsideScene:
    """shows : "object" = the object alone, before nothing; "plane" = the plane's light with
    the object over that without it
    """

    name: str
    model: str
    environment: str
    camera: Camera
    shows: str


def _material(
    colour: tuple[float, float, float], metallic: float, roughness: float
) -> dict[str, Any]:
    factors = {"baseColorFactor": [*colour, 1.0], "metallicFactor": metallic}
    return {"pbrMetallicRoughness": {**factors, "roughnessFactor": roughness}}


def _extended(material: dict[str, Any], name: str, **factors: Any) -> dict[str, Any]:
    return {**material, "extensions": {f"KHR_materials_{name}": factors}}


MATERIALS: dict[str, dict[str, Any]] = {
    "rough_metal": _material((0.9, 0.6, 0.3), 1.0, 0.5),
    "smooth_metal": _material((0.95, 0.93, 0.88), 1.0, 0.15),
    "clear_coat": _extended(
        _material((0.6, 0.05, 0.04), 0.0, 0.7),
        "clearcoat",
        clearcoatFactor=1.0,
        clearcoatRoughnessFactor=0.1,
    ),
    "cloth": _extended(
        _material((0.08, 0.1, 0.25), 0.0, 0.9),
        "sheen",
        sheenColorFactor=[0.7, 0.55, 0.4],
        sheenRoughnessFactor=0.5,
    ),
    "stone": {**_material((0.5, 0.46, 0.4), 0.0, 0.6), "normalTexture": {"index": 0}},
}
BLACK = _extended(
    _material((0.0, 0.0, 0.0), 0.0, 1.0), "specular", specularFactor=0.0
)


def ball(radius_m: float, middle_m: float, columns: int = 64, rows: int = 32) -> Mesh:
    """Its middle at that height; u goes round it twice."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    turn, down = 2 * np.pi * u, np.pi * v
    normals = np.stack(
        [np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)], -1
    )
    number = np.arange(u.size).reshape(u.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    lower, upper = (
        np.stack([a, b, c], -1)[:-1],
        np.stack([a, c, d], -1)[1:],
    )  # none of no area at the poles
    faces = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    normals = normals.reshape(-1, 3)
    return (
        radius_m * normals + [0, 0, middle_m],
        normals,
        np.stack([2 * u, v], -1).reshape(-1, 2),
        faces,
    )


def _flat(quads: np.ndarray) -> Mesh:
    """Of quads (n, 4, 3), each with its own normal, corners counter-clockwise."""
    normal = np.cross(quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    first = 4 * np.arange(len(quads))[:, None]
    faces = np.concatenate(
        [first + np.array(corners) for corners in ([0, 1, 2], [0, 2, 3])]
    )
    vertices = quads.reshape(-1, 3)
    return vertices, np.repeat(normal, 4, 0), np.zeros((len(vertices), 2)), faces


def _extruded(outline: np.ndarray, pieces: np.ndarray, height_m: float) -> Mesh:
    """outline : (n, 2) counter-clockwise;  pieces : (k, 4, 2) convex quads that fill it,
    counter-clockwise
    """

    def raised(xy: np.ndarray, z: float) -> np.ndarray:
        return np.concatenate([xy, np.full((*xy.shape[:-1], 1), z)], -1)

    after = np.roll(outline, -1, 0)
    corners = [
        raised(outline, 0),
        raised(after, 0),
        raised(after, height_m),
        raised(outline, height_m),
    ]
    top, base = raised(pieces, height_m), raised(pieces[:, ::-1], 0)
    return _flat(np.concatenate([np.stack(corners, 1), top, base]))


def box() -> Mesh:
    half = SIZE_M / 2
    square = half * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    return _extruded(square, square[None], SIZE_M)


def thin_wall(pieces: int = 48) -> Mesh:
    """A tube of a thin wall with a slit along it, towards -y."""
    angle = -np.pi / 2 + np.linspace(OPEN_RAD, 2 * np.pi - OPEN_RAD, pieces + 1)
    around = np.stack([np.cos(angle), np.sin(angle)], -1)
    outer, inner = SIZE_M / 2 * around, (SIZE_M / 2 - WALL_M) * around
    quads = np.stack([outer[:-1], outer[1:], inner[1:], inner[:-1]], 1)
    return _extruded(np.concatenate([outer, inner[::-1]]), quads, SIZE_M)


def contact_distance_m(model: str, places: np.ndarray) -> np.ndarray:
    """(n,) metres of places (n, 2) on the plane from where the model touches it; 0 where it
    does.
    """
    x, y = places.T
    if model == "box":
        return np.hypot(*(np.maximum(np.abs(v) - SIZE_M / 2, 0) for v in (x, y)))
    radius = np.hypot(x, y)
    if model == "ball":
        return radius
    outer, inner = SIZE_M / 2, SIZE_M / 2 - WALL_M
    from_wall = np.maximum(np.maximum(radius - outer, inner - radius), 0)
    end = np.array([np.sin(OPEN_RAD), -np.cos(OPEN_RAD)])
    across = np.clip(np.abs(x) * end[0] + y * end[1], inner, outer)
    from_end = np.hypot(np.abs(x) - across * end[0], y - across * end[1])
    in_slit = np.arctan2(np.abs(x), -y) < OPEN_RAD
    return np.where(in_slit, from_end, from_wall)


def bumps(size: int = 128) -> np.ndarray:
    """(size, size, 3) uint8 normal map of rough stone that repeats."""
    rng = np.random.default_rng(3)
    v, u = np.meshgrid(
        *[2 * np.pi * (np.arange(size) + 0.5) / size] * 2, indexing="ij"
    )
    slope = np.zeros((2, size, size))
    for _ in range(24):
        k, m = rng.integers(-6, 7), rng.integers(-6, 7)
        wave = np.cos(k * u + m * v + rng.uniform(0, 2 * np.pi)) / (
            4 + np.hypot(k, m)
        )
        slope += np.array([k, m])[:, None, None] * wave * 0.35
    normal = np.stack([-slope[0], slope[1], np.ones_like(u)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.rint((normal * 0.5 + 0.5) * 255).astype(np.uint8)


def glb(mesh: Mesh, material: dict[str, Any]) -> bytes:
    """A glTF 2.0 binary, y up, with one mesh; `bumps` is its one texture where the material
    has any.
    """
    vertices, normals, uv, faces = mesh
    y_up = [
        np.stack([a[:, 0], a[:, 2], -a[:, 1]], -1).astype("<f4")
        for a in (vertices, normals)
    ]
    arrays = [*y_up, uv.astype("<f4"), faces.astype("<u2").reshape(-1)]
    data = [a.tobytes() for a in arrays]
    accessors = [
        {
            "bufferView": k,
            "componentType": 5123 if k == 3 else 5126,
            "count": len(a),
            "type": kind,
        }
        for k, (a, kind) in enumerate(
            zip(arrays, ("VEC3", "VEC3", "VEC2", "SCALAR"), strict=True)
        )
    ]
    accessors[0] |= {"min": y_up[0].min(0).tolist(), "max": y_up[0].max(0).tolist()}
    primitive = {
        "attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2},
        "indices": 3,
        "material": 0,
    }
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [material],
        "extensionsUsed": list(material.get("extensions", ())),
        "accessors": accessors,
    }
    if "normalTexture" in material:
        data.append(cv2.imencode(".png", bumps()[..., ::-1])[1].tobytes())
        images = [{"bufferView": 4, "mimeType": "image/png"}]
        document |= {"textures": [{"source": 0}], "images": images}
    views, start = [], 0
    for block in data:
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(block)})
        start += len(block) + -len(block) % 4
    document |= {"bufferViews": views, "buffers": [{"byteLength": start}]}
    binary = b"".join(block + b"\0" * (-len(block) % 4) for block in data)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(binary))
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text,
        struct.pack("<II", len(binary), 0x4E4942) + binary,
    )
    return header + b"".join(chunks)


def _direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _room(d: np.ndarray) -> np.ndarray:
    """(..., 3) radiance of a room with a window, a dark door and a bright wall, in
    directions (..., 3).
    """
    height, azimuth = d[..., 2:], np.degrees(np.arctan2(d[..., 1], d[..., 0]))
    ceiling = 0.35 + 0.35 * np.clip(height, 0, 1)
    light = np.where(
        height > 0,
        ceiling * [1.0, 0.97, 0.9],
        (0.22 + 0.1 * height) * np.array([1.0, 0.85, 0.7]),
    )
    elevation = np.degrees(np.arcsin(np.clip(d[..., 2], -1, 1)))
    window = (np.abs(azimuth + 100) < 25) & (elevation > 10) & (elevation < 50)
    door = (np.abs(azimuth + 35) < 14) & (np.abs(elevation) < 28)
    wall = (np.abs(azimuth - 150) < 20) & (np.abs(elevation - 15) < 12)
    light[window], light[door], light[wall] = (
        [1.7, 1.9, 2.1],
        [0.06, 0.05, 0.05],
        [1.1, 0.7, 0.45],
    )
    return light


def _disc(
    d: np.ndarray, towards: np.ndarray, radius_deg: float, white: float
) -> np.ndarray:
    """Radiance (..., 1) of a disc that a white surface which faces it shows as `white`."""
    radiance = white / np.sin(np.radians(radius_deg)) ** 2
    return radiance * (d @ towards > np.cos(np.radians(radius_deg)))[..., None]


def _even(d: np.ndarray) -> np.ndarray:
    return (0.5 + 0.3 * d @ _direction(-100, 40))[..., None] * np.array(
        [0.9, 1.0, 1.1]
    )


ENVIRONMENTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "soft": _even,
    "lamp": lambda d: 0.6 * _room(d) + _disc(d, _direction(-60, 50), 4.0, 0.5),
    "sun": lambda d: (
        0.5 * _even(d) + _disc(d, _direction(200, 40), 0.8, 0.7) * [1.0, 0.95, 0.85]
    ),
}


def panorama(name: str, height: int = 128, finer: int = 6) -> np.ndarray:
    """(height, 2 height, 3) float32 radiance, equirectangular: z is on top, x in the middle
    column.
    """
    rows = (0.5 - (np.arange(height * finer) + 0.5) / (height * finer)) * np.pi
    columns = (
        (0.5 - (np.arange(2 * height * finer) + 0.5) / (2 * height * finer))
        * 2
        * np.pi
    )
    e, a = np.meshgrid(rows, columns, indexing="ij")
    light = ENVIRONMENTS[name](
        np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    )
    return (
        light.reshape(height, finer, 2 * height, finer, 3)
        .mean((1, 3))
        .astype(np.float32)
    )


BALL_HEIGHT_M = 1.0  # so high over arfx's plane that the ball hardly meets it
BALL_CAMERA = Camera(112, 112, 960.0, (0.0, -1.0, 1.15), (0.0, 0.0, BALL_HEIGHT_M))
CONTACT_CAMERA = Camera(240, 180, 800.0, (-0.17, -0.40, 0.30), (0.0, 0.0, 0.025))
MODELS: dict[str, Callable[[], tuple[Mesh, dict[str, Any]]]] = {
    "box": lambda: (box(), BLACK),
    "ball": lambda: (ball(SIZE_M / 2, SIZE_M / 2), BLACK),
    "thin_wall": lambda: (thin_wall(), BLACK),
    **{
        name: lambda m=m: (ball(BALL_RADIUS_M, BALL_HEIGHT_M), m)
        for name, m in MATERIALS.items()
    },
}
SCENES = [
    *(OutsideScene(name, name, "lamp", BALL_CAMERA, "object") for name in MATERIALS),
    *(
        OutsideScene(f"{model}_{light}", model, light, CONTACT_CAMERA, "plane")
        for model in ("box", "ball", "thin_wall")
        for light in ENVIRONMENTS
    ),
]  # fmt: skip


def write(scene: OutsideScene, folder: Path) -> tuple[Path, Path]:
    """(model, surroundings): its files, written to the folder."""
    model, surroundings = (
        folder / f"{scene.model}.glb",
        folder / f"{scene.environment}.hdr",
    )
    model.write_bytes(glb(*MODELS[scene.model]()))
    cv2.imwrite(str(surroundings), panorama(scene.environment)[..., ::-1])
    return model, surroundings


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.mkdir(parents=True, exist_ok=True)
    for each in SCENES:
        write(each, target)
    (target / "scenes.json").write_text(
        json.dumps([asdict(s) for s in SCENES], indent=1)
    )
