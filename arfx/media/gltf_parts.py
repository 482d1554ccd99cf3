"""What a glTF file shows: its nodes walked from the scene's roots, meshes as triangles (glTF 2.0
sections 3.5, 3.7)."""

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.model import Material
from arfx.core.numerics import normalise
from arfx.core.pose import rotation_from_quaternion
from arfx.errors import InputError
from arfx.media.gltf import Gltf, gltf_material
from arfx.media.model_files import NO_TRIANGLES, TABLES, ModelFile
from arfx.media.model_parts import Placed, Rows, plain_material, unit_colours

_TRIANGLES, _STRIP = 4, 5
_PLACES = ("translation", "rotation", "scale")


def gltf_meshes(file: ModelFile) -> Iterator[Placed]:
    """Each set of triangles of the scene that a file shows.

    Raises InputError: limits, what is missing or does not fit together."""
    gltf = Gltf(file)
    material_of = cache(partial(gltf_material, gltf))

    @cache
    def triangles_of(number: int) -> list[tuple[ndarray, Rows, Material]]:
        out = []
        for primitive in gltf.header["meshes"][number]["primitives"]:
            given, mode = primitive["attributes"], primitive.get("mode", _TRIANGLES)
            if "POSITION" not in given:
                continue
            if mode < _TRIANGLES:
                file.notices.append(NO_TRIANGLES)
                continue
            rows = {
                own: gltf.array(given[name], columns).astype(float)
                for name, (own, columns) in TABLES["attributes"].items()
                if name in given
            }
            corners = np.arange(len(rows["vertices"]))
            if "indices" in primitive:
                corners = gltf.array(primitive["indices"], 1)[:, 0].astype(np.int64)
            if coloured := "COLOR_0" in given:
                rows["colours"] = unit_colours(gltf.array(given["COLOR_0"]))
            if "material" in primitive:
                material = material_of(primitive["material"], coloured)
            else:
                material = plain_material(coloured, double_sided=False)
            out.append((_triangles(corners, mode), rows, material))
        return out

    for number, model_from_mesh in _placed(gltf):
        for faces, rows, material in triangles_of(number):
            yield faces, rows, model_from_mesh, material


def _placed(gltf: Gltf) -> Iterator[tuple[int, ndarray]]:
    """Numbers of the meshes that are shown, each with its place in the model, (4, 4)."""
    nodes = gltf.header.get("nodes", [])
    if scenes := gltf.header.get("scenes", []):
        shown = gltf.header.get("scene", 0)
        roots = scenes[shown].get("nodes", [])
        if len(scenes) > 1:
            gltf.file.notices.append(
                f"{len(scenes)} scenes, number {shown} is shown (from 0 on)"
            )
    else:
        below = {child for node in nodes for child in node.get("children", [])}
        roots = sorted(set(range(len(nodes))) - below)
    waiting = [(number, np.eye(4)) for number in roots]
    seen = set()
    while waiting:
        number, model_from_parent = waiting.pop()
        if number in seen:
            what = f"node {number} is below itself or below two others"
            raise InputError(what, "nodes must form a tree")
        seen.add(number)
        node = nodes[number]
        extensions = node.get("extensions", {})
        if extensions.get("KHR_node_visibility", {}).get("visible") is False:
            continue
        model_from_node = model_from_parent @ _parent_from_node(node)
        if "mesh" in node:
            for node_from_mesh in _copies(
                gltf, extensions.get("EXT_mesh_gpu_instancing", {})
            ):
                yield node["mesh"], model_from_node @ node_from_mesh
        waiting += [(child, model_from_node) for child in node.get("children", [])]


def _copies(gltf: Gltf, instances: dict[str, Any]) -> Iterator[ndarray]:
    """Where a node shows its mesh, (4, 4) in the node's axes."""
    given = instances.get("attributes", {})
    columns = {p: gltf.array(given[p.upper()]) for p in _PLACES if p.upper() in given}
    if not columns:
        yield np.eye(4)
    for values in columns.values():
        gltf.file.check_counts(0, len(values))
    for row in zip(*columns.values(), strict=False):
        yield _parent_from_node(dict(zip(columns, row, strict=True)))


def _parent_from_node(node: dict[str, Any]) -> ndarray:
    """(4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    turn = normalise(np.array(node.get("rotation", (0, 0, 0, 1)), float))
    scale = np.array(node.get("scale", (1, 1, 1)), float)
    out = np.eye(4)
    out[:3, :3] = rotation_from_quaternion(np.roll(turn, 1)) * scale
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return out


def _triangles(corners: ndarray, mode: int) -> ndarray:
    """(m, 3) corners, from those of a list of triangles, a strip or a fan (section 3.7.2.1)."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    odd = i % 2
    order = (i, i + 1 + odd, i + 2 - odd) if mode == _STRIP else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1)]
