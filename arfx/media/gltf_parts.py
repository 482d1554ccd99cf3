"""What a glTF file shows: its nodes walked from the scene's roots, meshes as triangles (glTF 2.0
sections 3.5, 3.7)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from arfx.core.model import Material
from arfx.core.numerics import normalise
from arfx.core.pose import rotation_from_quaternion
from arfx.media.gltf_buffers import Buffers, shares
from arfx.media.gltf_materials import GltfMaterials
from arfx.media.model_materials import plain_material
from arfx.media.model_parts import FileMesh

_TRIANGLES, _STRIP = 4, 5
_ROWS = {
    "POSITION": "vertices",
    "NORMAL": "normals",
    "TANGENT": "tangents",
    "TEXCOORD_0": "uv",
    "TEXCOORD_1": "second_uv",
}
_PLACES = ("translation", "rotation", "scale")
_INSTANCES, _VISIBLE = "EXT_mesh_gpu_instancing", "KHR_node_visibility"


class GltfScene:
    """The scene that a file shows. header : its JSON, checked;  notices : gets what is left out"""

    def __init__(
        self,
        header: dict[str, Any],
        buffers: Buffers,
        materials: GltfMaterials,
        notices: list[str],
    ) -> None:
        self._nodes = header.get("nodes", [])
        self._meshes = header.get("meshes", [])
        self._scenes = header.get("scenes", [])
        self._shown = header.get("scene", 0)
        self._buffers, self._materials, self._notices = buffers, materials, notices

    def __iter__(self) -> Iterator[tuple[FileMesh | None, np.ndarray, Material]]:
        """Each set of triangles, (4, 4) its place in the model, and its material; None for points
        and lines."""
        meshes: dict[int, list[tuple[FileMesh | None, Material]]] = {}
        for number, model_from_mesh in self._placed():
            if number not in meshes:
                meshes[number] = list(self._triangles_of(number))
            for mesh, material in meshes[number]:
                yield mesh, model_from_mesh, material

    def _placed(self) -> Iterator[tuple[int, np.ndarray]]:
        """Numbers of the meshes that are shown, each with its place in the model."""
        waiting = [(number, np.eye(4)) for number in self._roots()]
        while waiting:
            number, model_from_parent = waiting.pop()
            node = self._nodes[number]
            extensions = node.get("extensions", {})
            if extensions.get(_VISIBLE, {}).get("visible") is False:
                continue
            model_from_node = model_from_parent @ _parent_from_node(node)
            if "mesh" in node:
                for node_from_mesh in self._copies(extensions):
                    yield node["mesh"], model_from_node @ node_from_mesh
            waiting += [(child, model_from_node) for child in node.get("children", [])]

    def _roots(self) -> list[int]:
        """Those of the scene that is shown; of a file without scenes every node that is below
        none."""
        if not self._scenes:
            below = {child for node in self._nodes for child in node.get("children", [])}
            return [number for number in range(len(self._nodes)) if number not in below]
        if len(self._scenes) > 1:
            what = f"{len(self._scenes)} scenes, number {self._shown} is shown (from 0 on)"
            self._notices.append(what)
        return list(self._scenes[self._shown].get("nodes", []))

    def _copies(self, extensions: dict[str, Any]) -> Iterator[np.ndarray]:
        """Where a node shows its mesh, (4, 4) in the node's axes."""
        given = extensions.get(_INSTANCES, {}).get("attributes", {})
        columns = {p: self._buffers.array(given[p.upper()]) for p in _PLACES if p.upper() in given}
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
            numbers = {own: given[name] for name, own in _ROWS.items() if name in given}
            rows = {own: read(number).astype(float) for own, number in numbers.items()}
            corners = np.arange(len(rows["vertices"]))
            if "indices" in primitive:
                corners = read(primitive["indices"])[:, 0].astype(np.int64)
            if "COLOR_0" in given:
                rows["colours"] = _colours(read(given["COLOR_0"]))
            if "material" in primitive:
                material = self._materials.of(primitive["material"])
            else:
                material = plain_material("colours" in rows, double_sided=False)
            yield FileMesh(_triangles(corners, mode), rows), material


def _parent_from_node(node: dict[str, Any]) -> np.ndarray:
    """(4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = normalise(np.array(node.get("rotation", (0, 0, 0, 1)), float))
    scale = np.array(node.get("scale", (1, 1, 1)), float)
    out = np.eye(4)
    out[:3, :3] = rotation_from_quaternion(w, x, y, z) * scale
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return out


def _colours(given: np.ndarray) -> np.ndarray:
    """(n, 4) of red, green, blue and maybe alpha; what is no number leaves the factor alone."""
    values = shares(given).astype(float)
    whole = np.ones((len(values), 4))
    whole[:, : values.shape[1]] = np.clip(np.where(np.isfinite(values), values, 1.0), 0.0, 1.0)
    return whole


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """(m, 3) corners, from those of a list of triangles, a strip or a fan (section 3.7.2.1)."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    odd = i % 2
    order = (i, i + 1 + odd, i + 2 - odd) if mode == _STRIP else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1)]
