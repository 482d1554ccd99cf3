"""glTF brought into the form that trimesh reads whole: plain float accessors, lists of triangles, one set of
texture coordinates, nodes without extensions. Files that are in that form already are handed on as they are.

Sections of glTF 2.0: 3.6.2 accessors, 3.7.2 meshes, 3.9 materials."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from arfx.errors import InputError
from arfx.media.gltf import MAX_PARTS
from arfx.media.model_files import ModelFolder

_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_FLOAT, _INDEX = 5126, 5125
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_REPEAT = 10497
_UNLIT, _GLOSSY = "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness"
_TRANSFORM, _VISIBLE = "KHR_texture_transform", "KHR_node_visibility"
_INSTANCES = "EXT_mesh_gpu_instancing"


def rewrite(data: bytes, kind: str, header: dict[str, Any], folder: ModelFolder) -> tuple[bytes, str, list[str]]:
    """The file as trimesh reads it, its kind, and notices. header : of a glTF file, is changed; {} of other files."""
    if not header or not _is_needed(header):
        return data, kind, []
    rewriting = _Rewriting(data, kind, header, folder)
    rewriting.nodes()
    rewriting.materials()
    rewriting.meshes()
    notices = [f"model {folder.path.name}: {what}" for what in dict.fromkeys(rewriting.notices)]
    return rewriting.result(), "gltf", notices


def _is_needed(header: dict[str, Any]) -> bool:
    accessors = header.get("accessors", [])
    primitives = [p for m in header.get("meshes", []) for p in m["primitives"]]
    plain = {"POSITION", "NORMAL", "TEXCOORD_0"}
    return (
        any("sparse" in a for a in accessors)
        or any(p.get("mode", _TRIANGLES) != _TRIANGLES for p in primitives)
        or any(
            accessors[at]["componentType"] != _FLOAT for p in primitives for name, at in p["attributes"].items() if name in plain
        )
        or any("extensions" in n or "camera" in n for n in header.get("nodes", []))
        or "scenes" not in header
        or any(
            "extensions" in m or any(t.get("texCoord") or "extensions" in t for t in _slots(m))
            for m in header.get("materials", [])
        )
        or any(s.get("wrapS", _REPEAT) != _REPEAT or s.get("wrapT", _REPEAT) != _REPEAT for s in header.get("samplers", []))
    )


def _slots(material: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The textures of a material that are drawn, colour first."""
    pbr = material.get("pbrMetallicRoughness", {})
    for owner, key in ((pbr, "baseColorTexture"), (pbr, "metallicRoughnessTexture"), (material, "emissiveTexture")):
        if key in owner:
            yield owner[key]


class _Rewriting:
    def __init__(self, data: bytes, kind: str, header: dict[str, Any], folder: ModelFolder) -> None:
        self.header, self.folder = header, folder
        self.notices: list[str] = []
        self._added = bytearray()
        self._made: dict[Any, int] = {}
        header.setdefault("bufferViews", [])
        header.setdefault("accessors", [])
        buffers = header.setdefault("buffers", [])
        self._buffers = [self._bytes_of(b.get("uri"), data, kind) for b in buffers]
        self._views = len(buffers)

    def _bytes_of(self, uri: str | None, data: bytes, kind: str) -> bytes:
        if uri is None:
            at = 20 + struct.unpack("<I", data[12:16])[0] if kind == "glb" else len(data)
            return data[at + 8 : at + 8 + struct.unpack("<I", data[at : at + 4])[0]] if at + 8 <= len(data) else b""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self.folder.get(uri)

    def result(self) -> bytes:
        self.header["buffers"] = []
        for number, content in enumerate([*self._buffers, bytes(self._added)]):
            name = f"arfx-buffer:{number}"
            self.folder.memory[name] = content
            self.header["buffers"].append({"uri": name, "byteLength": len(content)})
        return json.dumps(self.header).encode()

    def read(self, at: int) -> np.ndarray:
        """(count, columns) of an accessor, sparse values put in, normalised whole numbers as floats."""
        a = self.header["accessors"][at]
        columns = _SHAPES[a["type"]]
        out = np.zeros((a["count"], columns), _KINDS[a["componentType"]])
        if "bufferView" in a:
            out[:] = self._values(a, a["count"], columns)
        if sparse := a.get("sparse"):
            rows = self._values(sparse["indices"], sparse["count"], 1)[:, 0]
            if len(rows) and rows.max() >= len(out):
                raise InputError(f"model {self.folder.path}: accessor {at} replaces value {rows.max()} of {len(out)}")
            out[rows] = self._values({"componentType": a["componentType"], **sparse["values"]}, sparse["count"], columns)
        if a.get("normalized") and out.dtype.kind in "iu":
            return np.maximum(out / np.float32(np.iinfo(out.dtype).max), -1.0).astype(np.float32)
        return out

    def _values(self, a: dict[str, Any], count: int, columns: int) -> np.ndarray:
        view, kind = self.header["bufferViews"][a["bufferView"]], np.dtype(_KINDS[a["componentType"]])
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * columns)
        content = self._buffers[view["buffer"]]
        if count and start + stride * (count - 1) + kind.itemsize * columns > len(content):
            raise InputError(f"model {self.folder.path}: an accessor is longer than its buffer", "the file is damaged")
        return np.ndarray((count, columns), kind, content, start, (stride, kind.itemsize))

    def add(self, values: np.ndarray, key: Any = None) -> int:
        """The number of a new accessor. key : of values that are the same for all who ask"""
        if key is not None and key in self._made:
            return self._made[key]
        whole = values.dtype.kind in "iu"
        content = np.ascontiguousarray(values, "<u4" if whole else "<f4").tobytes()
        view = {"buffer": self._views, "byteOffset": len(self._added), "byteLength": len(content)}
        self._added += content
        self.header["bufferViews"].append(view)
        shape = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
        row = {"bufferView": len(self.header["bufferViews"]) - 1, "count": len(values), "type": shape}
        self.header["accessors"].append(row | {"componentType": _INDEX if whole else _FLOAT})
        self._made[key] = len(self.header["accessors"]) - 1
        return self._made[key]

    def nodes(self) -> None:
        """Hidden nodes lose what they show, copies of a mesh become nodes, without scenes every root is shown."""
        nodes = self.header.get("nodes", [])
        if "scenes" not in self.header:
            below = {c for n in nodes for c in n.get("children", [])}
            self.header["scenes"] = [{"nodes": [i for i in range(len(nodes)) if i not in below]}]
        copies = 0
        for node in list(nodes):
            node.pop("camera", None)
            extensions = node.pop("extensions", {})
            if extensions.get(_VISIBLE, {}).get("visible") is False:
                node.pop("mesh", None)
                node.pop("children", None)
            where = extensions.get(_INSTANCES, {}).get("attributes", {})
            keys = [k for k in ("TRANSLATION", "ROTATION", "SCALE") if k in where]
            if not keys or "mesh" not in node:
                continue
            columns = {k.lower(): self.read(where[k]).tolist() for k in keys}
            count = min(map(len, columns.values()))
            copies += count
            if copies > MAX_PARTS:
                hint = f"at most {MAX_PARTS}: join them first"
                raise InputError(f"model {self.folder.path} shows its meshes {copies} times", hint)
            mesh = node.pop("mesh")
            node["children"] = [*node.get("children", []), *range(len(nodes), len(nodes) + count)]
            nodes.extend({"mesh": mesh} | {k: v[i] for k, v in columns.items()} for i in range(count))

    def materials(self) -> None:
        """Unlit and glossy ones in terms of metallic-roughness."""
        for number, m in enumerate(self.header.get("materials", [])):
            m["name"] = f"{m.get('name', 'material')} {number}"  # one of its own: factors are looked up by it
            extensions = m.get("extensions", {})
            if (glossy := extensions.pop(_GLOSSY, None)) is not None:
                self._convert_glossy(m, glossy)
            if extensions.pop(_UNLIT, None) is not None:
                pbr = m.setdefault("pbrMetallicRoughness", {})
                r, g, b, alpha = pbr.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
                m["emissiveFactor"] = [r, g, b]
                m.pop("emissiveTexture", None)
                if "baseColorTexture" in pbr:
                    m["emissiveTexture"] = dict(pbr["baseColorTexture"])
                pbr |= {"baseColorFactor": [0.0, 0.0, 0.0, alpha], "metallicFactor": 0.0, "roughnessFactor": 1.0}
                m["extensions"] = {"KHR_materials_specular": {"specularFactor": 0.0}}

    def _convert_glossy(self, m: dict[str, Any], glossy: dict[str, Any]) -> None:
        """Metal where the specular colour is above a dielectric's 4 % (Khronos' conversion, by factors)."""
        diffuse = np.array(glossy.get("diffuseFactor", [1.0, 1.0, 1.0, 1.0]), float)
        specular = np.array(glossy.get("specularFactor", [1.0, 1.0, 1.0]), float)
        pbr: dict[str, Any] = {"roughnessFactor": 1.0 - float(glossy.get("glossinessFactor", 1.0)), "metallicFactor": 0.0}
        if "specularGlossinessTexture" in glossy:
            self.notices.append("left out textures of shine (specular-glossiness)")
        else:
            metal = float(np.clip((specular.max() - 0.04) / max(diffuse[:3].max() + specular.max() - 0.04, 1e-6), 0, 1))
            pbr["metallicFactor"] = metal
            diffuse[:3] = np.clip(diffuse[:3] / 0.96 * (1.0 - metal) + specular * metal, 0, 1)
        pbr["baseColorFactor"] = diffuse.tolist()
        if "diffuseTexture" in glossy:
            pbr["baseColorTexture"] = glossy["diffuseTexture"]
        m["pbrMetallicRoughness"] = pbr

    def meshes(self) -> None:
        """Lists of triangles with float coordinates."""
        materials = self.header.get("materials", [])
        for p in (p for m in self.header.get("meshes", []) for p in m["primitives"]):
            at, mode = p["attributes"], p.get("mode", _TRIANGLES)
            if "POSITION" not in at or mode < _TRIANGLES:
                continue
            if mode != _TRIANGLES:
                p["mode"] = _TRIANGLES
                corners = self.read(p["indices"])[:, 0] if "indices" in p else np.arange(len(self.read(at["POSITION"])))
                p["indices"] = self.add(_triangles(corners.astype(np.uint32), mode))
            elif "indices" in p and "sparse" in self.header["accessors"][p["indices"]]:
                p["indices"] = self.add(self.read(p["indices"])[:, 0], ("index", p["indices"]))
            if "material" in p:
                self._texture_coordinates(at, materials[p["material"]])
            for name in at.keys() & {"POSITION", "NORMAL", "COLOR_0"}:
                a = self.header["accessors"][at[name]]
                if "sparse" in a or (a["componentType"] != _FLOAT and name != "COLOR_0"):
                    at[name] = self.add(self.read(at[name]).astype(np.float32), ("values", at[name]))

    def _texture_coordinates(self, at: dict[str, int], material: dict[str, Any]) -> None:
        """Those of the colour's texture, transformed, become TEXCOORD_0."""
        slots = list(_slots(material))
        if not slots:
            return
        ways = []
        for slot in slots:
            change = slot.get("extensions", {}).get(_TRANSFORM, {})
            number = change.get("texCoord", slot.get("texCoord", 0))
            moved = (*change.get("offset", [0, 0]), float(change.get("rotation", 0)), *change.get("scale", [1, 1]))
            ways.append((number, moved))
        if len(set(ways)) > 1:
            self.notices.append(f"material {material['name']}: its textures are laid differently, all are shown as the first")
        name, moved = f"TEXCOORD_{ways[0][0]}", ways[0][1]
        if name not in at:
            return
        uv = self.read(at[name]).astype(float)
        x, y, angle, wide, high = moved
        c, s = np.cos(angle), np.sin(angle)
        uv = uv * [wide, high] @ np.array([[c, -s], [s, c]]) + [x, y]
        at["TEXCOORD_0"] = self.add(uv, (name, at[name], moved))
        beyond = bool((uv < -1e-4).any() or (uv > 1 + 1e-4).any())
        if beyond and any(self._is_cut(slot) for slot in slots):
            self.notices.append("textures that end or are mirrored beyond their edge (sampler wrap modes) are repeated")

    def _is_cut(self, slot: dict[str, Any]) -> bool:
        texture = self.header["textures"][slot["index"]]
        sampler = self.header["samplers"][texture["sampler"]] if "sampler" in texture else {}
        return sampler.get("wrapS", _REPEAT) != _REPEAT or sampler.get("wrapT", _REPEAT) != _REPEAT


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """Corners of a list of triangles, from those of a strip or fan (section 3.7.2.1)."""
    i = np.arange(max(len(corners) - 2, 0))
    odd = i % 2
    order = (i, i + 1 + odd, i + 2 - odd) if mode == _STRIP else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1).ravel()]
