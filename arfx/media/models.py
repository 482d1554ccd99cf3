"""Virtual models from files, through trimesh: geometry with normals, materials and textures in arfx's own terms.

glTF/GLB (scene graph applied), OBJ with MTL, PLY, STL, and what else trimesh reads here. Errors say what is wrong with
the file and how many vertices or faces it concerns; what was repaired is in `Model.notices`.
Leaves out: skins, animation, morph targets, normal and occlusion textures, lines and points."""

from __future__ import annotations

import io
import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.model import Model, Part
from arfx.core.numerics import normalise
from arfx.core.opener import read_bytes
from arfx.errors import ArfxError, ConfigError, InputError
from arfx.media.gltf import check_gltf, gltf_header
from arfx.media.gltf_rewrite import rewrite
from arfx.media.model_files import ModelFolder, restrict_pillow
from arfx.media.model_limits import check_faces, check_parts, check_size
from arfx.media.model_materials import Textures, material_of, precise_factors, vertex_colours
from arfx.media.model_normals import smooth_by_angle
from arfx.media.obj_files import decoded, obj_for_trimesh

# Formats that are read, with their up axis: glTF says y (section 3.4), COLLADA and OBJ exporters default to it; scans and
# CAD use z. Others that trimesh knows are left out: archives, which may unpack to anything, and formats without faces.
_UP = {"glb": "y", "gltf": "y", "obj": "y", "dae": "y", "ply": "z", "stl": "z", "off": "z"}
_BEGINNINGS = {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}  # recognised by content, whatever the name says
# Formats whose winding nobody promises: both sides are shown.
_TWO_SIDED = ("ply", "stl", "obj", "off", "dae")
# Beyond this float32 coordinates, which both renderers use, step by more than a thousandth of a unit times extent.
MAX_EXTENT = 1e9
# Squared double area below which a triangle has no plane, as a fraction of the model's extent to the fourth power:
# float32 coordinates are exact to 6e-8 of the extent, so a height below that is rounding.
_DEGENERATE = (6e-8) ** 4
_MOST_TOLD = 10  # files that are missing, by name


def load_model(path: Path | str | None, up: str | None = None) -> Model:
    """Read a model file.

    path : any format of trimesh; textures beside it, names with spaces included
    up : "x", "y" or "z", the file axis that points up; None = by file type (y for glTF, OBJ and DAE, z for PLY and STL)

    Returns a Model in the file's own axes and units, faces counter-clockwise from outside, normals unit.
    Raises InputError: missing or unreadable file, no faces, vertices that are not finite, absurd extent, texture above
    8192 px; ConfigError: no path, unknown up axis."""
    if path is None:
        raise ConfigError("no model file is given", "--model duck.glb, or file = \"duck.glb\" under [model]")  # fmt: skip
    if up not in (None, "x", "y", "z"):
        raise ConfigError(f"unknown up axis {up!r}", "x, y or z")
    path = Path(path)
    data = read_bytes(path, "model")
    if not data:
        raise InputError(f"model file {path} is empty")
    kind = _kind(path, data)
    header = gltf_header(data, kind, path)
    notices = check_gltf(header, path)
    check_size(data, kind, header, path)
    folder = ModelFolder(path)
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)  # its warnings come back as our own messages
    try:
        with np.errstate(all="ignore"):
            content, form, left_out = rewrite(data, kind, header, folder)
            check_gltf(header, path)
            parts = _read(content, form, folder, header, notices)
        notices += left_out
    except ArfxError:
        raise
    except ImportError as e:
        raise InputError(f"cannot read model {path}: {e}", "convert it to GLB, OBJ, PLY or STL") from e
    except Exception as e:  # trimesh's parsers raise whatever they stumble over, and hand on what they did not look at
        own = isinstance(e, (OSError, ValueError)) and not header
        what = (own and str(e).split("\n")[0][:300]) or "its values do not fit together"
        raise InputError(f"cannot read model {path} ({what})", "the file is damaged or not what its name says") from e
    finally:
        log.setLevel(level)
    if not parts:
        raise InputError(f"model {path} has no faces", "a mesh with triangles is needed; points and lines cannot be rendered")
    model = Model(tuple(parts), up or _UP[kind], str(path), tuple(notices), tuple(folder.files))
    low, high = model.bounds
    extent = float((high - low).max())
    if not extent > 0 or extent > MAX_EXTENT or np.abs(model.bounds).max() > MAX_EXTENT:
        hint = f"an extent above 0 and coordinates below {MAX_EXTENT:g}; look for stray vertices"
        raise InputError(f"model {path} spans {extent:g} units up to coordinate {np.abs(model.bounds).max():g}", hint)
    return model


def _kind(path: Path, data: bytes) -> str:
    kind = _BEGINNINGS.get(data[:4]) or path.suffix.lower().removeprefix(".")
    if kind == "glb" and data[:4] != b"glTF" and data.lstrip()[:1] == b"{":
        kind = "gltf"
    if kind not in _UP:
        raise InputError(f"cannot read model {path}: {path.suffix or 'no suffix'} is not a format that is read",
                         "a GLB, glTF, OBJ, PLY, STL, OFF or DAE file")  # fmt: skip
    if kind == "dae" and (b"<!ENTITY" in data or b"\0" in data[:200]):
        raise InputError(f"cannot read model {path}: it defines XML entities, or is not UTF-8", "export it again")
    return kind


def _read(data: bytes, kind: str, folder: ModelFolder, header: dict[str, Any], notices: list[str]) -> list[Part]:
    import trimesh

    refused: list[str] = []
    if kind == "obj":
        data = obj_for_trimesh(data, folder, notices)
    head, end, body = data.partition(b"end_header") if kind == "ply" else (b"", b"", data)
    data = decoded(head).encode() + end + body
    with restrict_pillow(refused):
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, resolver=folder, process=False)  # type: ignore[arg-type]
        parts = _parts(scene, folder.path, kind, header, notices)
    named = len(re.findall(rb"\ncomment\s+TextureFile\s", head, re.IGNORECASE))
    shown = int(any(p.material.base_texture is not None for p in parts))
    if named > 1 or (named > shown and not (refused or folder.left_out)):
        notices.append(f"model {folder.path.name}: {named - shown} of its textures left out: one, with coordinates, is shown")
    missing = list(folder.left_out.values())
    notices += [f"model {folder.path.name}: left out {why}" for why in missing[:_MOST_TOLD]]
    if len(missing) > _MOST_TOLD:
        notices.append(f"model {folder.path.name}: left out {len(missing) - _MOST_TOLD} more files")
    if refused:
        notices.append(f"model {folder.path.name}: {len(refused)} textures left out: {refused[0]}")
    return parts


def _parts(scene: Any, path: Path, kind: str, header: dict[str, Any], notices: list[str]) -> list[Part]:
    factors = precise_factors(header)
    materials: dict[int, Any] = {}  # parts of one file material share it
    textures = Textures(path)
    parts: list[Part] = []
    dropped = skipped = faces = covered = 0
    check_parts(len(scene.graph.nodes_geometry), path)
    for node in scene.graph.nodes_geometry:
        world_from_mesh, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces"):
            skipped += 1
            continue
        faces += len(mesh.faces)
        check_faces(faces, path)
        part, lost = _part(mesh, np.asarray(world_from_mesh, float), textures, kind in _TWO_SIDED, factors, materials)
        dropped += lost
        if part is not None and part.material.base_texture is not None and "_ply_raw" in mesh.metadata:
            covered += part.colours is not None  # both show the same surface
            part = replace(part, colours=None)
        if part is not None:
            parts.append(part)
    textures.close()
    if dropped:
        notices.append(f"model {path.name}: {dropped} faces without area left out")
    if covered:
        notices.append(f"model {path.name}: its colours by vertex are left out: its texture is shown")
    if skipped:
        notices.append(f"model {path.name}: {skipped} sets of points or lines left out")
    return parts


def _part(
    mesh: Any, transform: np.ndarray, textures: Textures, two_sided: bool, factors: dict, materials: dict[int, Any]
) -> tuple[Part | None, int]:
    """One mesh under its node's transform, and the number of faces without area."""
    path = textures.path
    given = np.asarray(mesh.vertices, float)
    faces = np.asarray(mesh.faces)
    if not len(faces):
        return None, 0
    if faces.min() < 0 or faces.max() >= len(given):
        raise InputError(f"model {path}: faces refer to vertex {faces.max()}, there are {len(given)}", "the file is damaged")
    if not np.isfinite(transform).all():
        raise InputError(f"model {path}: a node's transform is not finite")
    if bad := int((~np.isfinite(given)).any(1).sum()):
        hint = "export it again; look for NaN or inf"
        raise InputError(f"model {path}: {bad} of {len(given)} vertices are not finite numbers", hint)
    # trimesh would make normals up on access; only the file's own are wanted
    normals = np.array(mesh.vertex_normals, float) if "vertex_normals" in mesh._cache else None
    if normals is not None and not (normals.shape == given.shape and np.isfinite(normals).all()):
        normals = None
    linear = transform[:3, :3]
    vertices = given @ linear.T + transform[:3, 3]
    if np.linalg.det(linear) < 0:  # a mirror turns every triangle inside out
        faces = faces[:, ::-1]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    extent = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    keep = (np.cross(b - a, c - a) ** 2).sum(1) > _DEGENERATE * extent**4
    lost = int((~keep).sum())
    faces = faces[keep]
    if not len(faces):
        return None, lost
    uv, colours, corner_colours = _uv(mesh, len(given)), *vertex_colours(mesh, keep)
    if corner_colours is not None:  # colours by face: no corner can be shared
        vertices, uv = vertices[faces].reshape(-1, 3), None if uv is None else uv[faces].reshape(-1, 2)
        normals = None if normals is None else normals[faces].reshape(-1, 3)
        colours, faces = np.repeat(corner_colours, 3, 0), np.arange(3 * len(faces)).reshape(-1, 3)
    if normals is not None:
        # cofactors (the inverse transpose times the determinant) turn normals rightly under any matrix, singular ones
        # included; a mirror's sign is taken out again: normals keep to the outside while the winding is turned
        cofactors = np.stack([np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])])
        normals = normalise(normals @ (cofactors * (np.sign(np.linalg.det(linear)) or 1.0)).T)
    if normals is None or not (np.abs(normals[faces]).sum(-1) > 0).all():
        faces, source, normals = smooth_by_angle(vertices, faces, split=uv is not None or colours is not None)
        vertices = vertices[source]
        uv, colours = (None if a is None else a[source] for a in (uv, colours))
    used, faces = np.unique(faces, return_inverse=True)
    uv, colours = (None if a is None else a[used] for a in (uv, colours))
    key = id(getattr(mesh.visual, "material", mesh))
    if key not in materials:
        materials[key] = material_of(mesh, textures, two_sided, factors, has_colours=colours is not None)
    return Part(vertices[used], faces.reshape(-1, 3).astype(np.int32), normals[used], materials[key], uv, colours), lost


def _uv(mesh: Any, n: int) -> np.ndarray | None:
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or np.shape(uv)[:1] != (n,):
        return None
    uv = np.array(uv, float)[:, :2]
    kwargs = getattr(getattr(mesh.visual, "material", None), "kwargs", None) or {}
    su, sv, ou, ov = map(float, kwargs.get("map_uv", (1, 1, 0, 0)))  # options of an MTL file's map
    uv = uv * (su, sv) + (ou, ov)
    uv[~np.isfinite(uv).all(1)] = 0.0
    return np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1)  # trimesh counts v from the bottom
