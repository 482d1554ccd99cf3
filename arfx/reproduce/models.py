"""The models of the papers' tables and figures, made by rule: written as GLB, y up, about
one unit wide.

teapot 6,000 faces, apple 4,000, aeroplane 21,000 (table 1 of Tan, Chen, Sun 2009); cube,
rabbit, and teapot, cube and rabbit side by side (figure 5 of Jia, Tang 2013); and what
shows indirect light."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from arfx.errors import ConfigError
from arfx.reproduce import teapot as newell

Colour = tuple[float, float, float]
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # from z up


def write_model(name: str, path: Path) -> int:
    """Write a model; returns its number of faces. Raises ConfigError for an unknown name."""
    if name not in MODELS:
        raise ConfigError(f"there is no model {name!r}", f"one of {', '.join(MODELS)}")
    import trimesh

    meshes = MODELS[name]()
    path.write_bytes(trimesh.Scene(meshes).export(file_type="glb"))
    return sum(len(m.faces) for m in meshes)


def lofted(
    rings: np.ndarray,
    colour: Colour,
    first: Any = None,
    last: Any = None,
    roughness: float = 0.6,
    metallic: float = 0.0,
) -> Any:
    """A mesh through closed rings, its faces outward: 2 (k - 1) n faces, and n for each end
    that is closed.

    rings : (k, n, 3) points;  first, last : (3,) point that closes the tube there, None =
    it is open;  z up
    """
    k, n = rings.shape[:2]
    at = np.arange(k * n).reshape(k, n)
    a, b, c, d = at[:-1], np.roll(at, -1, 1)[:-1], at[1:], np.roll(at, -1, 1)[1:]
    faces = [np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)]
    points = [rings.reshape(-1, 3)]
    for ring, pole, way in ((at[0], first, 1), (at[-1], last, -1)):
        if pole is not None:
            middle = np.full(n, sum(map(len, points)))
            faces.append(np.stack([middle, np.roll(ring, -1), ring][::way], -1))
            points.append(np.asarray(pole, float).reshape(1, 3))
    vertices, triangles = np.concatenate(points), np.concatenate(faces)
    corner = vertices[triangles[: 2 * (k - 1) * n]]
    centres = np.repeat(rings.mean(1), n, 0)  # of the ring where a face begins
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outward = np.einsum(
        "ij,ij->", normal, corner.mean(1) - np.concatenate([centres[: (k - 1) * n]] * 2)
    )
    return coloured(
        vertices,
        triangles if outward > 0 else triangles[:, ::-1],
        colour,
        roughness,
        metallic,
    )


def coloured(
    vertices: np.ndarray,
    faces: np.ndarray,
    colour: Colour,
    roughness: float = 0.6,
    metallic: float = 0.0,
) -> Any:
    """A mesh from points with z up."""
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.apply_transform(Y_UP)
    material = PBRMaterial(
        baseColorFactor=[*colour, 1.0],
        metallicFactor=metallic,
        roughnessFactor=roughness,
        doubleSided=True,
        name=f"{colour}",
    )
    mesh.visual = TextureVisuals(uv=np.zeros((len(vertices), 2)), material=material)
    return mesh


def teapot(colour: Colour = (0.75, 0.72, 0.66)) -> list[Any]:
    """6,000 faces; open between lid and rim and at the spout, as Newell made it."""
    body, lid = (
        newell.turned(newell.BODY, (6, 10, 10, 8), 48),
        newell.turned(newell.LID, (9, 8), 48),
    )
    handle, spout = (
        newell.tube(newell.HANDLE, (7, 7), 20),
        newell.tube(newell.SPOUT, (8, 8), 20),
    )
    parts = [
        lofted(body[:-1], colour, last=body[-1, 0]),
        lofted(lid[1:], colour, first=lid[0, 0]),
        lofted(handle, colour),
        lofted(spout, colour),
    ]
    for part in parts:
        part.apply_scale(1 / 6.4)
    return parts


def apple() -> list[Any]:
    """4,000 faces: a closed body with a dimple above and five bumps below, and a closed stem."""
    from scipy.interpolate import CubicSpline

    # (radius, height) from the bottom of the lower dimple to that of the upper one
    knots = np.array(
        [
            (0, 0.07),
            (0.1, 0.03),
            (0.2, 0),
            (0.33, 0.05),
            (0.45, 0.21),
            (0.5, 0.46),
            (0.45, 0.7),
            (0.29, 0.83),
            (0.12, 0.8),
            (0, 0.68),
        ]
    )
    length = np.concatenate(
        [[0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))]
    )
    profile = CubicSpline(length, knots)(np.linspace(0, length[-1], 42))
    angle = np.arange(48) * 2 * np.pi / 48
    bumps = np.clip(1 - profile[:, 1:] / 0.45, 0, 1) ** 2 * np.cos(5 * angle)
    radius = profile[:, :1] * (1 + 0.03 * bumps)
    height = profile[:, 1:] - 0.012 * bumps * (profile[:, :1] > 0.1)
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)
    bottom, top = (0, 0, profile[0, 1]), (0, 0, profile[-1, 1])
    body = lofted(rings[1:-1], (0.6, 0.035, 0.03), bottom, top, 0.35)
    t = np.linspace(0, 1, 10)[:, None]
    side, thick = np.arange(8) * np.pi / 4, 0.017 + 0.012 * t**3
    stem = np.stack(
        [
            0.1 * t**2 + thick * np.cos(side),
            thick * np.sin(side),
            0.66 + 0.37 * t + 0 * side,
        ],
        -1,
    )
    return [body, lofted(stem, (0.12, 0.06, 0.02), stem[0].mean(0), stem[-1].mean(0))]


def aeroplane() -> list[Any]:
    """21,000 faces: an airliner, its fuselage 1 long, every part closed."""
    white, blue, grey = (0.78, 0.79, 0.8), (0.05, 0.16, 0.5), (0.35, 0.36, 0.38)
    t = np.linspace(0, 1, 61)[1:-1]
    nose, tail = np.clip(t / 0.16, 0, 1), np.clip((1 - t) / 0.42, 0, 1)
    radius = 0.055 * np.sqrt(1 - (1 - nose) ** 2) * (1 - (1 - tail) ** 2) ** 0.7
    rise = (
        0.045 * (1 - tail) ** 2 - 0.012 * (1 - nose) ** 2
    )  # the tail goes up, the nose down
    angle = np.arange(60) * 2 * np.pi / 60
    along = np.broadcast_to((0.5 - t)[:, None], (59, 60))
    rings = np.stack(
        [
            along,
            radius[:, None] * np.cos(angle),
            radius[:, None] * np.sin(angle) + rise[:, None],
        ],
        -1,
    )
    parts = [lofted(rings, white, (0.5, 0, -0.012), (-0.5, 0, 0.045), 0.35)]
    for side in (-1, 1):
        parts.append(
            _wing(
                (0.09, 0.02, -0.025), (-0.16, 0.47 * side, 0.035), 0.2, 0.05, 40, 48, grey
            )
        )
        parts.append(
            _wing((-0.37, 0.01, 0.035), (-0.47, 0.18 * side, 0.05), 0.1, 0.04, 24, 28, grey)
        )
        parts.append(_engine((0.1, 0.16 * side, -0.045), blue))
    parts.append(_wing((-0.34, 0, 0.05), (-0.49, 0, 0.22), 0.13, 0.06, 24, 28, blue))
    for part in parts:
        part.apply_translation((0, 0.12, 0))
    return parts


def _wing(
    root: tuple[float, float, float],
    tip: tuple[float, float, float],
    chord: float,
    tip_chord: float,
    sides: int,
    rings: int,
    colour: Colour,
) -> Any:
    """A tapered wing from the leading edge at the root to that at the tip; its sections are
    symmetric, 12 % thick (NACA 0012).
    """
    s = np.linspace(0, 1, rings)[:, None]
    turn = np.arange(sides) * 2 * np.pi / sides
    x = (1 - np.cos(turn)) / 2  # from the leading edge, back and round
    half = 0.6 * (
        0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4
    )
    span = np.subtract(tip, root)
    across = np.array([0, -span[2], span[1]]) / np.hypot(span[1], span[2])
    size = chord + s * (tip_chord - chord)
    edge = np.array(root) + s[..., None] * span
    points = (
        edge
        + np.stack([-size * x, 0 * size * x, 0 * size * x], -1)
        + (size * half * np.sign(np.sin(turn)))[..., None] * across
    )
    return lofted(points, colour, points[0].mean(0), points[-1].mean(0), 0.4)


def _engine(front: tuple[float, float, float], colour: Colour) -> Any:
    """A nacelle: a ring at the front, closed a little within, and a cone at the back."""
    knots = np.array(
        [
            (0, -0.012),
            (0.02, -0.01),
            (0.024, 0),
            (0.029, -0.02),
            (0.028, -0.06),
            (0.018, -0.095),
            (0, -0.12),
        ]
    )
    at = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    steps = np.linspace(0, at[-1], 25)
    radius, x = (np.interp(steps, at, knots[:, i]) for i in range(2))
    angle = np.arange(24) * 2 * np.pi / 24
    rings = (
        np.stack(
            [
                x[:, None] + 0 * angle,
                radius[:, None] * np.cos(angle),
                radius[:, None] * np.sin(angle),
            ],
            -1,
        )
        + front
    )
    return lofted(rings[1:-1], colour, rings[0, 0], rings[-1, 0], 0.4)


def cube(colour: Colour = (0.1, 0.3, 0.65)) -> list[Any]:
    """12 faces, flat, standing on the ground."""
    import trimesh

    box = trimesh.creation.box((0.5, 0.5, 0.5))
    box.unmerge_vertices()
    return [coloured(np.add(box.vertices, (0, 0, 0.25)), box.faces, colour)]


def ball(
    colour: Colour = (0.95, 0.95, 0.95), roughness: float = 0.0, metallic: float = 1.0
) -> list[Any]:
    """12,160 faces; a mirror, unless its material is another."""
    t, angle = np.linspace(0, np.pi, 97)[1:-1], np.arange(64) * np.pi / 32
    across, up = np.sin(t)[:, None] / 2, (1 - np.cos(t))[:, None] / 2
    rings = np.stack([across * np.cos(angle), across * np.sin(angle), up + 0 * angle], -1)
    return [lofted(rings, colour, (0, 0, 0), (0, 0, 1), roughness, metallic)]


# Of the rabbit: centre, half axes, and turn about y in degrees; it sits, looking towards x
_RABBIT = (
    ((-0.1, 0, 0.25), (0.28, 0.2, 0.23), 15),  # body
    ((0.1, 0, 0.24), (0.15, 0.14, 0.2), -20),  # breast
    ((0.24, 0, 0.5), (0.16, 0.11, 0.12), 20),  # head
    ((0.34, 0, 0.46), (0.065, 0.06, 0.055), 0),  # nose
    ((0.12, 0.075, 0.74), (0.05, 0.022, 0.2), -16),
    ((0.12, -0.075, 0.74), (0.05, 0.022, 0.2), -16),  # ears
    ((-0.16, 0.15, 0.16), (0.17, 0.07, 0.16), 0),
    ((-0.16, -0.15, 0.16), (0.17, 0.07, 0.16), 0),  # thighs
    ((0.0, 0.17, 0.035), (0.17, 0.045, 0.04), 0),
    ((0.0, -0.17, 0.035), (0.17, 0.045, 0.04), 0),  # hind feet
    ((0.2, 0.07, 0.13), (0.05, 0.042, 0.15), 8),
    ((0.2, -0.07, 0.13), (0.05, 0.042, 0.15), 8),  # fore legs
    ((-0.39, 0, 0.2), (0.08, 0.075, 0.08), 0),  # tail
)


def rabbit(colour: Colour = (0.62, 0.56, 0.5)) -> list[Any]:
    """A closed smooth union of ellipsoids, by marching cubes."""
    from skimage.measure import marching_cubes

    step, low = 0.016, np.array([-0.5, -0.32, -0.1])
    grid = np.stack(
        np.meshgrid(
            *(np.arange(a, b, step) for a, b in zip(low, (0.45, 0.32, 1.05), strict=True)),
            indexing="ij",
        ),
        -1,
    )
    total = np.zeros(grid.shape[:3])
    for centre, axes, turn in _RABBIT:
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        local = (grid - centre) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        far = np.linalg.norm(local / axes, axis=-1)
        total += np.exp(
            -60 * (far - 1) * min(axes)
        )  # so deep is a point in it, about in units: a smooth maximum
    points, faces, _, _ = marching_cubes(total, 1.0)
    points = points * step + low
    return [
        coloured(
            points - [0, 0, points[:, 2].min()], np.asarray(faces)[:, ::-1], colour, 0.9
        )
    ]


def group() -> list[Any]:
    """Teapot, cube and rabbit side by side."""
    out = []
    for meshes, at, size in (
        (teapot((0.7, 0.3, 0.12)), -0.62, 0.85),
        (cube(), 0.05, 0.75),
        (rabbit(), 0.7, 0.7),
    ):
        for mesh in meshes:
            mesh.apply_scale(size)
            mesh.apply_translation((at, 0, 0))
        out += meshes
    return out


MODELS: dict[str, Callable[[], list[Any]]] = {
    "teapot": teapot,
    "apple": apple,
    "aeroplane": aeroplane,
    "cube": cube,
    "rabbit": rabbit,
    "group": group,
    "red teapot": lambda: teapot((0.55, 0.04, 0.03)),
    "red cube": lambda: cube((0.7, 0.03, 0.02)),
    "black cube": lambda: cube((0.0, 0.0, 0.0)),
    "mirror": ball,
    "ball": lambda: ball((0.7, 0.7, 0.7), 0.8, 0.0),
}
