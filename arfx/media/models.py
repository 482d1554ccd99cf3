"""Virtual models from files: geometry with normals, materials and textures in arfx's own terms.

glTF/GLB is read by gltf_parts.py; OBJ with MTL by obj_files.py; PLY, STL, OFF and DAE through
trimesh. Errors say what is wrong with the file and how many vertices or faces it concerns; what was
repaired is in `Model.notices`. Leaves out: skins, animation, morph targets, lines and points."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np

from arfx.core.model import Model, Part
from arfx.core.opener import read_bytes
from arfx.errors import ArfxError, InputError
from arfx.media.gltf_parts import gltf_meshes
from arfx.media.model_files import DAMAGED, TABLES, ModelFile
from arfx.media.model_parts import part_of
from arfx.media.obj_files import obj_meshes
from arfx.media.trimesh_models import trimesh_meshes

_UP = TABLES["up"]
# Recognised by content, whatever the name says.
_BEGINNINGS = {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}
# Beyond this float32 coordinates, which renderers use, step by more than a thousandth of a unit
# times extent.
MAX_EXTENT = 1e9
_MOST_NOTICES = 20


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
        with np.errstate(all="ignore"):
            parts = _read(file)
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


def _read(file: ModelFile) -> list[Part]:
    readers = {"glb": gltf_meshes, "gltf": gltf_meshes, "obj": obj_meshes}
    placed, faces = [], 0
    for found in readers.get(file.kind, trimesh_meshes)(file):
        placed.append(found)
        faces += len(found[0])
        file.check_counts(faces, len(placed))
    made = [part_of(*found) for found in placed]
    parts = [part for part in made if part is not None]
    if lost := faces - sum(len(part.faces) for part in parts):
        file.notices.append(f"{lost} faces without area left out")
    if not parts:
        hint = "a mesh with triangles is needed; points and lines cannot be rendered"
        raise InputError("it has no faces", hint)
    return parts
