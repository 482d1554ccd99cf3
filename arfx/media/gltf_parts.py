"""What a glTF file shows: its nodes walked from the scene's roots, meshes as triangles (glTF 2.0
sections 3.5, 3.7)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from arfx.core.model import Material
from arfx.core.numerics import normalise
from arfx.core.pose import rotation_from_quaternion
from arfx.errors import InputError
from arfx.media.gltf import Buffers, read_header
from arfx.media.gltf_materials import GltfMaterials
from arfx.media.model_files import ModelFile
from arfx.media.model_materials import plain_material, unit_colours
from arfx.media.model_parts import FileMesh

_TRIANGLES, _STRIP = 4, 5
_ROWS = {
    "POSITION": ("vertices", 3),
    "NORMAL": ("normals", 3),
    "TANGENT": ("tangents", 4),
    "TEXCOORD_0": ("uv", 2),
    "TEXCOORD_1": ("second_uv", 2),
}
_PLACES = ("translation", "rotation", "scale")
_INSTANCES, _VISIBLE = "EXT_mesh_gpu_instancing", "KHR_node_visibility"


class GltfScene:
    """The scene that a file shows.

    Raises InputError: limits, what is missing or does not fit together."""

    def __init__(self, file: ModelFile) -> None:
        self._file, header = file, read_header(file)
        self._nodes = header.get("nodes", [])
        self._meshes = header.get("meshes", [])
        self._scenes = header.get("scenes", [])
        self._shown = header.get("scene", 0)
        self._buffers = Buffers(file, header)
        self._materials = GltfMaterials(file, header, self._buffers)

    def __iter__(self) -> Iterator[tuple[FileMesh | None, np.ndarray, Material]]:
        """Each set of triangles, (4, 4) its place in the model, its material.

        For points and lines there is None in place of triangles."""
        placed = list(self._placed())
        faces_of = {number: self._face_count(number) for number, _ in placed}
        self._file.check_faces(sum(faces_of[number] for number, _ in placed))
        meshes = {number: list(self._triangles_of(number)) for number in faces_of}
        for number, model_from_mesh in placed:
            for mesh, material in meshes[number]:
                yield mesh, model_from_mesh, material

    def _placed(self) -> Iterator[tuple[int, np.ndarray]]:
        """Numbers of the meshes that are shown, each with its place in the model."""
        waiting = [(number, np.eye(4)) for number in self._roots()]
        count, seen = 0, set()
        while waiting:
            number, model_from_parent = waiting.pop()
            if number in seen:
                what = f"node {number} is below itself or below two others"
                raise InputError(
                    f"model {self._file.path}: {what}", "nodes must form a tree"
                )
            seen.add(number)
            node = self._nodes[number]
            extensions = node.get("extensions", {})
            if extensions.get(_VISIBLE, {}).get("visible") is False:
                continue
            model_from_node = model_from_parent @ _parent_from_node(node)
            if "mesh" in node:
                for node_from_mesh in self._copies(extensions):
                    count += 1
                    self._file.check_parts(count)
                    yield node["mesh"], model_from_node @ node_from_mesh
            waiting += [(child, model_from_node) for child in node.get("children", [])]

    def _face_count(self, number: int) -> int:
        """At most, of a mesh."""
        total = 0
        for primitive in self._meshes[number]["primitives"]:
            corners = primitive.get("indices", primitive["attributes"].get("POSITION"))
            if corners is not None:
                a_face = 3 if primitive.get("mode", _TRIANGLES) == _TRIANGLES else 1
                total += self._buffers.count(corners) // a_face
        return total

    def _roots(self) -> list[int]:
        """Those of the scene that is shown; of a file without scenes every node that is below
        none."""
        if not self._scenes:
            below = {child for node in self._nodes for child in node.get("children", [])}
            return [number for number in range(len(self._nodes)) if number not in below]
        if len(self._scenes) > 1:
            what = (
                f"{len(self._scenes)} scenes, number {self._shown} is shown (from 0 on)"
            )
            self._file.notices.append(what)
        return list(self._scenes[self._shown].get("nodes", []))

    def _copies(self, extensions: dict[str, Any]) -> Iterator[np.ndarray]:
        """Where a node shows its mesh, (4, 4) in the node's axes."""
        given = extensions.get(_INSTANCES, {}).get("attributes", {})
        columns = {
            p: self._buffers.array(given[p.upper()])
            for p in _PLACES
            if p.upper() in given
        }
        if not columns:
            yield np.eye(4)
            return
        for row in zip(*columns.values(), strict=False):
            yield _parent_from_node(dict(zip(columns, row, strict=True)))

    def _triangles_of(self, number: int) -> Iterator[tuple[FileMesh | None, Material]]:
        for primitive in self._meshes[number]["primitives"]:
            given, mode = primitive["attributes"], primitive.get("mode", _TRIANGLES)
            if "POSITION" not in given:
                continue
            if mode < _TRIANGLES:
                yield None, Material()
                continue
            read = self._buffers.array
            rows = {}
            for name, (own, columns) in _ROWS.items():
                if name in given:
                    rows[own] = read(given[name], columns).astype(float)
            corners = np.arange(len(rows["vertices"]))
            if "indices" in primitive:
                corners = read(primitive["indices"], 1)[:, 0].astype(np.int64)
            if "COLOR_0" in given:
                rows["colours"] = unit_colours(read(given["COLOR_0"]))
            if "material" in primitive:
                material = self._materials.of(primitive["material"])
            else:
                material = plain_material("colours" in rows, double_sided=False)
            yield FileMesh(_triangles(corners, mode), rows), material


def _parent_from_node(node: dict[str, Any]) -> np.ndarray:
    """(4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    turn = normalise(np.array(node.get("rotation", (0, 0, 0, 1)), float))
    scale = np.array(node.get("scale", (1, 1, 1)), float)
    out = np.eye(4)
    out[:3, :3] = rotation_from_quaternion(np.roll(turn, 1)) * scale
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return out


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """(m, 3) corners, from those of a list of triangles, a strip or a fan (section 3.7.2.1)."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    odd = i % 2
    order = (i, i + 1 + odd, i + 2 - odd) if mode == _STRIP else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1)]
