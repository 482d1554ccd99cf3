"""Virtual models from files: geometry with normals, materials and textures in arfx's own terms.

glTF/GLB is read by gltf_parts.py; OBJ with MTL by obj_files.py; PLY, STL, OFF and DAE through
trimesh. Errors say what is wrong with the file and how many vertices or faces it concerns; what was
repaired is in `Model.notices`. Leaves out: skins, animation, morph targets, lines and points."""

import importlib.util
import io
import logging
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.model import Material, Model, Texture
from arfx.core.numerics import same_rows
from arfx.core.opener import read_bytes
from arfx.errors import ArfxError, InputError
from arfx.media.gltf_parts import gltf_meshes
from arfx.media.model_files import DAMAGED, NO_TRIANGLES, TABLES, ModelFile
from arfx.media.model_parts import (
    Placed,
    Rows,
    checked,
    linear_colours,
    part_of,
    plain_material,
)
from arfx.media.obj_files import decoded, obj_meshes

_UP = TABLES["up"]
# Recognised by content, whatever the name says.
_BEGINNINGS = {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}
# Beyond this float32 coordinates, which renderers use, step by more than a thousandth of a unit
# times extent.
MAX_EXTENT = 1e9
_MOST_NOTICES = 20
_FACES_OF = {
    "ply": rb"\belement\s+face\s+(\d+)",
    "off": rb"OFF\s+(?:#[^\n]*\s+)*\d+\s+(\d+)",
}
_PLY_UV = re.compile(
    r"(\nproperty\s.*\s)(texture_u|texture_v|texcoord|[uvst])\s*(?=\n)"
)


def load_model(path: Path | str, up: str | None = None) -> Model:
    """Read a model file.

    path : of a format in models.toml; textures beside it, names with spaces included
    up : "x", "y" or "z", the file axis that points up; None = of its kind (glTF, OBJ, DAE: y)

    Returns a Model in the file's own axes and units, faces counter-clockwise from outside, normals
    unit. Raises InputError: missing or unreadable file, no faces, vertices that are not finite,
    absurd extent, texture above 8192 px."""
    path = Path(path)
    data = read_bytes(path, "model")
    try:
        file = ModelFile(path, data, _kind(path, data))
        readers = {"glb": gltf_meshes, "gltf": gltf_meshes, "obj": obj_meshes}
        placed, faces = list[Placed](), 0
        with np.errstate(all="ignore"):
            for found in readers.get(file.kind, trimesh_meshes)(file):
                placed.append(found)
                faces += len(found[0])
                file.check_counts(faces, len(placed))
            parts = [p for found in placed if (p := part_of(*found)) is not None]
        if lost := faces - sum(len(part.faces) for part in parts):
            file.notices.append(f"{lost} faces without area left out")
        if not parts:
            raise InputError(
                "it has no faces",
                "a mesh with triangles is needed; points and lines cannot be rendered",
            )
        model = Model(tuple(parts), up or _UP[file.kind], str(path))
        extent, furthest = np.ptp(model.bounds, 0).max(), np.abs(model.bounds).max()
        if not 0 < extent <= MAX_EXTENT or furthest > MAX_EXTENT:
            what = f"it spans {extent:g} units up to coordinate {furthest:g}"
            below = f"an extent above 0 and coordinates below {MAX_EXTENT:g}"
            raise InputError(what, f"{below}; look for stray vertices")
    except ArfxError as e:
        raise InputError(f"cannot read model {path}: {e.message}", e.hint) from e
    except Exception as e:  # parsers raise whatever they stumble over
        what = f"cannot read model {path}: what it holds does not fit together"
        raise InputError(what, DAMAGED) from e
    notices = [f"model {path.name}: {what}" for what in dict.fromkeys(file.notices)]
    if (more := len(notices) - _MOST_NOTICES) > 0:
        notices[_MOST_NOTICES:] = [f"model {path.name}: {more} more notices"]
    return replace(model, notices=tuple(notices), files=tuple(file.files))


def _kind(path: Path, data: bytes) -> str:
    if not data:
        raise InputError("it is empty")
    kind = _BEGINNINGS.get(data[:4]) or path.suffix.lower().removeprefix(".")
    if kind == "glb" and data[:4] != b"glTF" and data.lstrip()[:1] == b"{":
        kind = "gltf"
    if kind not in _UP:
        what = f"{path.suffix or 'no suffix'} is not a format that is read"
        raise InputError(what, "a GLB, glTF, OBJ, PLY, STL, OFF or DAE file")
    if kind == "dae" and (b"<!ENTITY" in data or b"\0" in data[:200]):
        raise InputError(
            "it defines XML entities, or is not UTF-8", "export it again"
        )
    if kind == "dae" and importlib.util.find_spec("collada") is None:
        what = "the package pycollada is not installed"
        raise InputError(what, "convert it to GLB or OBJ")
    return kind


def trimesh_meshes(file: ModelFile) -> Iterator[Placed]:
    """All meshes of a file. Nobody promises the winding of these formats: both sides are shown.

    Raises InputError: limits, damaged materials; what trimesh's parsers raise."""
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # we say it ourselves
    file.check_counts(_stated_faces(file.data, file.kind))
    data, texture = _ply(file) if file.kind == "ply" else (file.data, None)
    scene = trimesh.load_scene(
        io.BytesIO(data),
        file_type=file.kind,
        resolver=file,  # type: ignore[arg-type]
        process=False,
    )
    materials: dict[int, Material] = {}  # the scene keeps what is known by its id
    for node in scene.graph.nodes_geometry:
        model_from_mesh, name = scene.graph[node]
        mesh: Any = scene.geometry[name]
        if not hasattr(mesh, "faces"):
            file.notices.append(NO_TRIANGLES)
            continue
        faces, rows = _mesh(mesh)
        given = getattr(mesh.visual, "material", None)
        if texture is not None:
            plain = plain_material(has_colours=True, double_sided=True)
            material = replace(plain, base_texture=texture, roughness=1.0)
        elif type(given).__name__ == "PBRMaterial":
            if id(given) not in materials:
                materials[id(given)] = _of_collada(file, given)
            material = materials[id(given)]
        else:  # trimesh's own grey
            material = plain_material("colours" in rows, double_sided=True)
        yield faces, rows, np.asarray(model_from_mesh, float), material


def _ply(file: ModelFile) -> tuple[bytes, Texture | None]:
    """The file, without what trimesh would not read: other text than UTF-8, and, where no
    texture is shown, texture coordinates, which make it drop colours; and the texture."""
    start, end, body = file.data.partition(b"end_header")
    head = decoded(start)
    named = re.findall(r"(?i)\ncomment\s+TextureFile\s+(.*)", head)
    head = re.sub(r"(?i)\ncomment\b.*", "", head)
    picture = file.picture(named[0]) if named else None
    texture = None
    if picture is not None and _PLY_UV.search(head):
        texture = Texture(picture)
        if re.search(r"\nproperty\s.*\sred\s", head):
            what = "its colours by vertex are left out: its texture is shown"
            file.notices.append(what)
    else:
        head = _PLY_UV.sub(r"\1left_out_\2", head)
    lost = len(named[1:] if texture or picture is None else named)
    if lost:
        what = f"{lost} of its textures left out: one, with coordinates, is shown"
        file.notices.append(what)
    return head.encode() + end + body, texture


def _of_collada(file: ModelFile, given: Any) -> Material:
    """What trimesh reads of it; a texture is laid by the first coordinates as they are."""
    red, green, blue, alpha = (np.resize(given.baseColorFactor, 4) / 255.0).tolist()
    glow_red, glow_green, glow_blue = map(float, given.emissiveFactor)
    picture = file.texels(given.baseColorTexture)
    return checked(
        Material(
            base_colour=(red, green, blue, alpha),
            base_texture=None if picture is None else Texture(picture),
            roughness=float(given.roughnessFactor),
            emissive=(glow_red, glow_green, glow_blue),
        )
    )


def _stated_faces(data: bytes, kind: str) -> int:
    """As the file's beginning says; counted where it says nothing."""
    if kind == "stl":
        declared = int.from_bytes(data[80:84], "little")
        return (
            declared if len(data) >= 84 + 50 * declared else data.count(b"endfacet")
        )
    found = re.search(_FACES_OF[kind], data[:65536]) if kind in _FACES_OF else None
    return int(found[1][:18]) if found else 0


def _mesh(mesh: Any) -> tuple[ndarray, Rows]:
    rows, faces = (
        {"vertices": np.asarray(mesh.vertices, float)},
        np.asarray(mesh.faces),
    )
    # trimesh would make normals up on access; only the file's own are wanted
    if "vertex_normals" in mesh._cache:
        rows["normals"] = np.array(mesh.vertex_normals, float)
    visual = mesh.visual
    if getattr(visual, "uv", None) is not None:
        # trimesh counts v from the bottom
        rows["uv"] = np.array(visual.uv, float)[:, :2] * (1, -1) + (0, 1)
    if visual.kind == "vertex":
        rows["colours"] = linear_colours(visual.vertex_colors)
    if visual.kind == "face":
        corners = faces.ravel()
        colours = np.repeat(linear_colours(visual.face_colors), 3, 0)
        first, number = same_rows(np.column_stack([corners, colours]))
        rows = {name: values[corners[first]] for name, values in rows.items()}
        rows["colours"], faces = colours[first], number.reshape(-1, 3)
    return faces, rows
