"""glTF brought into the form that trimesh reads whole: plain float accessors, lists of triangles, one set of
texture coordinates that repeats, metallic-roughness materials, nodes without extensions.

Sections of glTF 2.0: 3.6.2 accessors, 3.7.2 meshes, 3.8.4 samplers, 3.9 materials."""

from __future__ import annotations

import base64
import io
import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from arfx.core.colour import SRGB
from arfx.errors import InputError
from arfx.media.gltf import LISTS, MAX_PARTS, SHAPES
from arfx.media.model_files import PICTURES, ModelFolder
from arfx.media.model_materials import MAX_TEXTURE_PX

_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_FLOAT, _INDEX = 5126, 5125
_TRIANGLES, _STRIP = 4, 5
_REPEAT, _CLAMP, _MIRROR = 10497, 33071, 33648
_SIDE = 4096  # of a picture that is made anew, in texels: larger ones are scaled down
_ROWS = 256  # of a picture, worked on at a time
_DIELECTRIC = 0.04  # reflected by what is no metal
_UNLIT, _GLOSSY = "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness"
_TRANSFORM, _VISIBLE = "KHR_texture_transform", "KHR_node_visibility"
_PLACES = ("TRANSLATION", "ROTATION", "SCALE")
_INSTANCES, _WEBP = "EXT_mesh_gpu_instancing", "EXT_texture_webp"


def rewrite(data: bytes, kind: str, header: dict[str, Any], folder: ModelFolder) -> tuple[bytes, str, list[str]]:
    """The file as trimesh reads it, its kind, and notices. header : of a glTF file, is changed; {} of other files."""
    if not header:
        return data, kind, []
    rewriting = _Rewriting(data, kind, header, folder)
    rewriting.materials()
    rewriting.meshes()
    rewriting.nodes()
    notices = [f"model {folder.path.name}: {what}" for what in dict.fromkeys(rewriting.notices)]
    return rewriting.result(), "gltf", notices


def _slots(material: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """(owner, key) of the textures of a material that are drawn, colour first."""
    pbr = material.get("pbrMetallicRoughness", {})
    for owner, key in ((pbr, "baseColorTexture"), (pbr, "metallicRoughnessTexture"), (material, "emissiveTexture")):
        if key in owner:
            yield owner, key


class _Rewriting:
    def __init__(self, data: bytes, kind: str, header: dict[str, Any], folder: ModelFolder) -> None:
        self.header, self.folder = header, folder
        self.notices: list[str] = []
        self._added = bytearray()
        self._made: dict[tuple, int] = {}
        for name in LISTS:
            header.setdefault(name, [])
        self._buffers = [self._bytes_of(b.get("uri"), data, kind) for b in header["buffers"]]
        for b, content in zip(header["buffers"], self._buffers, strict=True):
            if len(content) < b.get("byteLength", 0):
                text = f"model {folder.path}: a buffer holds {len(content)} of {b['byteLength']} bytes"
                raise InputError(text, "the file is cut short, or damaged")

    def _bytes_of(self, uri: str | None, data: bytes, kind: str) -> bytes:
        if uri is None:
            at = 20 + struct.unpack("<I", data[12:16])[0] if kind == "glb" else len(data)
            return data[at + 8 : at + 8 + struct.unpack("<I", data[at : at + 4])[0]] if at + 8 <= len(data) else b""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self.folder.get(uri)

    def result(self) -> bytes:
        self.header["buffers"] = []
        for content in [*self._buffers, bytes(self._added)]:
            self.header["buffers"].append({"uri": self._keep(content), "byteLength": len(content)})
        return json.dumps(self.header).encode()

    def _keep(self, content: bytes) -> str:
        """The name by which trimesh will ask for it."""
        name = f"arfx:{len(self.folder.memory)}"
        self.folder.memory[name] = content
        return name

    def read(self, at: int) -> np.ndarray:
        """(count, columns) of an accessor, sparse values put in, normalised whole numbers as floats."""
        a = self.header["accessors"][at]
        columns = SHAPES[a["type"]]
        out = np.zeros((a["count"], columns), _KINDS[a["componentType"]])
        if "bufferView" in a:
            out[:] = self._values(a, a["count"], columns)
        if sparse := a.get("sparse"):
            rows = self._values(sparse["indices"], sparse["count"], 1)[:, 0]
            out[rows] = self._values({"componentType": a["componentType"], **sparse["values"]}, sparse["count"], columns)
        if a.get("normalized") and out.dtype.kind in "iu":
            return np.maximum(out / np.float32(np.iinfo(out.dtype).max), -1.0).astype(np.float32)
        return out

    def _values(self, a: dict[str, Any], count: int, columns: int) -> np.ndarray:
        view, kind = self.header["bufferViews"][a["bufferView"]], np.dtype(_KINDS[a["componentType"]])
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * columns)
        return np.ndarray((count, columns), kind, self._buffers[view["buffer"]], start, (stride, kind.itemsize))

    def add(self, values: np.ndarray, key: tuple) -> int:
        """The number of a new accessor. key : of values that are the same for all who ask"""
        if key in self._made:
            return self._made[key]
        whole = values.dtype.kind in "iu"
        content = np.ascontiguousarray(values, "<u4" if whole else "<f4").tobytes()
        view = {"buffer": len(self._buffers), "byteOffset": len(self._added), "byteLength": len(content)}
        self._added += content
        self.header["bufferViews"].append(view)
        shape = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
        row = {"bufferView": len(self.header["bufferViews"]) - 1, "count": len(values), "type": shape}
        self.header["accessors"].append(row | {"componentType": _INDEX if whole else _FLOAT})
        self._made[key] = len(self.header["accessors"]) - 1
        return self._made[key]

    def nodes(self) -> None:
        """Hidden nodes lose what they show, copies of a mesh become nodes, without scenes every root is shown."""
        nodes, scenes = self.header["nodes"], self.header.get("scenes")
        if not scenes:
            below = {c for n in nodes for c in n.get("children", [])}
            self.header["scenes"] = [{"nodes": [i for i in range(len(nodes)) if i not in below]}]
            self.header["scene"] = 0
        elif len(scenes) > 1:
            self.notices.append(f"{len(scenes)} scenes, number {self.header.get('scene', 0)} is shown (from 0 on)")
        copies = 0
        for node in list(nodes):
            node.pop("camera", None)  # trimesh leaves out such a node, and what is below it
            extensions = node.pop("extensions", {})
            if extensions.get(_VISIBLE, {}).get("visible") is False:
                node.pop("mesh", None)
                node.pop("children", None)
            if "mesh" in node and not self.header["meshes"][node["mesh"]]["primitives"]:
                del node["mesh"]
            where = extensions.get(_INSTANCES, {}).get("attributes", {})
            columns = {k.lower(): self.read(at).tolist() for k, at in where.items() if k in _PLACES}
            if not columns or "mesh" not in node:
                continue
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
        primitives = [p for m in self.header["meshes"] for p in m["primitives"]]
        coloured = {p.get("material") for p in primitives if "COLOR_0" in p["attributes"]}
        for number, m in enumerate(self.header["materials"]):
            m["name"] = f"{m.get('name', 'material')} {number}"  # one of its own: factors are looked up by it
            extensions = m.get("extensions", {})
            if (glossy := extensions.pop(_GLOSSY, None)) is not None:
                self._convert_glossy(m, glossy)
            if extensions.pop(_UNLIT, None) is None:
                continue
            if number in coloured:  # they are not part of what shines
                self.notices.append(f"material {m['name']} is unlit with colours by vertex: it is shown lit")
                continue
            pbr = m.setdefault("pbrMetallicRoughness", {})
            r, g, b, alpha = pbr.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
            m["emissiveFactor"] = [r, g, b]
            m.pop("emissiveTexture", None)
            if "baseColorTexture" in pbr:
                m["emissiveTexture"] = pbr["baseColorTexture"]
            pbr |= {"baseColorFactor": [0.0, 0.0, 0.0, alpha], "metallicFactor": 0.0, "roughnessFactor": 1.0}
            m["extensions"] = {"KHR_materials_specular": {"specularFactor": 0.0}}

    def _convert_glossy(self, m: dict[str, Any], glossy: dict[str, Any]) -> None:
        """Specular-glossiness to metallic-roughness, texel by texel where it has textures."""
        diffuse = np.array(glossy.get("diffuseFactor", [1.0] * 4), np.float32)
        shine = np.array([*glossy.get("specularFactor", [1.0] * 3), glossy.get("glossinessFactor", 1.0)], np.float32)
        slots = [glossy.get(k) for k in ("diffuseTexture", "specularGlossinessTexture")]
        pictures = [self._picture(slot) for slot in slots]
        sizes = [p.size for p in pictures if p is not None]
        if len(sizes) < 2 - slots.count(None):
            self.notices.append(f"material {m['name']}: a texture is missing, damaged or above {MAX_TEXTURE_PX} px a side")
        pbr: dict[str, Any] = {}
        m["pbrMetallicRoughness"] = pbr
        if not sizes:
            colour, metal = _metallic(diffuse, shine)
            pbr |= {"baseColorFactor": [*colour.tolist(), float(diffuse[3])], "metallicFactor": float(metal)}
            pbr["roughnessFactor"] = 1.0 - float(shine[3])
            return
        wide, high = max(sizes)
        texels = [None if p is None else np.asarray(p.resize((wide, high))) for p in pictures]
        base, rough = np.empty((high, wide, 4), np.uint8), np.zeros((high, wide, 3), np.uint8)
        for a in range(0, high, _ROWS):
            d, s = (_linear(t, a, f) for t, f in zip(texels, (diffuse, shine), strict=True))
            colour, metal = _metallic(d, s)
            base[a : a + _ROWS, :, :3] = np.round(SRGB.encode(colour) * 255)
            base[a : a + _ROWS, :, 3] = np.round(d[..., 3] * 255)
            rough[a : a + _ROWS, :, 1] = np.round((1.0 - s[..., 3]) * 255)
            rough[a : a + _ROWS, :, 2] = np.round(metal * 255)
        pbr["baseColorTexture"] = self._texture(base, slots[0] or slots[1] or {})
        pbr["metallicRoughnessTexture"] = self._texture(rough, slots[1] or slots[0] or {})

    def _picture(self, slot: dict[str, Any] | None) -> Any:
        """The Pillow picture, RGBA, of a texture; None: none that can be read."""
        from PIL import Image

        if slot is None:
            return None
        texture = self.header["textures"][slot["index"]]
        at = texture.get("extensions", {}).get(_WEBP, texture).get("source")
        if at is None:
            return None
        image = self.header["images"][at]
        try:
            if "bufferView" in image:
                view = self.header["bufferViews"][image["bufferView"]]
                start = view.get("byteOffset", 0)
                content = self._buffers[view["buffer"]][start : start + view["byteLength"]]
            else:
                content = self._bytes_of(image["uri"], b"", "gltf")
            given = Image.open(io.BytesIO(content), formats=PICTURES)
            if max(given.size) > MAX_TEXTURE_PX:
                return None
            picture = given.convert("RGBA")
            picture.thumbnail((_SIDE, _SIDE))
            return picture
        except (InputError, OSError, ValueError, SyntaxError):
            return None

    def _texture(self, texels: np.ndarray, like: dict[str, Any]) -> dict[str, Any]:
        """Reference to a new texture, laid as another one is."""
        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(texels).save(file, "TIFF")
        self.header["images"].append({"uri": self._keep(file.getvalue())})
        sampler = {k: v for k, v in self.header["textures"][like["index"]].items() if k == "sampler"}
        self.header["textures"].append(sampler | {"source": len(self.header["images"]) - 1})
        return like | {"index": len(self.header["textures"]) - 1}

    def meshes(self) -> None:
        """Lists of triangles with float coordinates."""
        laid: dict[int, list[dict[str, int]]] = {}  # attributes by material
        for m in self.header["meshes"]:
            m["primitives"] = [p for p in m["primitives"] if "POSITION" in p["attributes"]]
        for p in (p for m in self.header["meshes"] for p in m["primitives"]):
            at, mode = p["attributes"], p.get("mode", _TRIANGLES)
            p.pop("extensions", None)
            if mode < _TRIANGLES:
                p["mode"] = 0  # lines are left out as points are: counted
                continue
            count = self.header["accessors"][at["POSITION"]]["count"]
            corners = self.read(p["indices"])[:, 0] if "indices" in p else np.arange(count)
            p["mode"] = _TRIANGLES
            p["indices"] = self.add(_triangles(corners, mode), (mode, p.get("indices"), count))
            if "material" in p:
                laid.setdefault(p["material"], []).append(at)
            for name in at.keys() & {"POSITION", "NORMAL", "COLOR_0"}:
                a = self.header["accessors"][at[name]]
                if "sparse" in a or (a["componentType"] != _FLOAT and name != "COLOR_0"):
                    at[name] = self.add(self.read(at[name]).astype(np.float32), ("values", at[name]))
        for number, rows in laid.items():
            self._texture_coordinates(rows, self.header["materials"][number])

    def _texture_coordinates(self, rows: list[dict[str, int]], material: dict[str, Any]) -> None:
        """Those of the colour's texture, transformed, become TEXCOORD_0 of all that the material covers."""
        slots = list(_slots(material))
        if not slots:
            return
        ways = []
        for owner, key in slots:
            change = owner[key].get("extensions", {}).get(_TRANSFORM, {})
            number = change.get("texCoord", owner[key].get("texCoord", 0))
            ways.append((number, *change.get("offset", [0, 0]), change.get("rotation", 0), *change.get("scale", [1, 1])))
        if len(set(ways)) > 1:
            self.notices.append(f"material {material['name']}: its textures are laid differently, all are shown as the first")
        number, x, y, angle, wide, high = ways[0]
        name = f"TEXCOORD_{number}"
        rows = [at for at in rows if name in at]
        c, s = np.cos(angle), np.sin(angle)
        matrix = np.array([[wide * c, -wide * s], [high * s, high * c]])
        laid = {at[name]: self.read(at[name]) @ matrix + [x, y] for at in rows}
        low, size = self._repeating(material, slots, list(laid.values()))
        for at in rows:
            uv = laid[at[name]]
            at["TEXCOORD_0"] = self.add((uv - low) / size, (name, at[name], ways[0], *low, *size))

    def _repeating(self, material: dict, slots: list, laid: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Makes textures that end or are mirrored beyond their edges into larger ones that repeat.

        Returns low, size : (2,) what part of the texture plane they cover, where one picture is 1 x 1."""
        low, size = np.zeros(2), np.ones(2)
        every = np.concatenate([np.zeros((1, 2)), *laid])
        every = every[np.isfinite(every).all(1)]
        modes = [self._wraps(owner[key]) for owner, key in slots]
        for axis in range(2):
            least, most = every[:, axis].min(), every[:, axis].max()
            found = {m[axis] for m in modes}
            if least < -1e-4 or most > 1 + 1e-4:
                if _CLAMP in found:
                    low[axis] = np.floor(least)
                    size[axis] = max(np.ceil(most), 1) - low[axis]
                elif _MIRROR in found:
                    size[axis] = 2
        pictures = [self._picture(owner[key]) for owner, key in slots] if (size > 1).any() else []
        if any(p is None or p.width * p.height * size.prod() > _SIDE**2 for p in pictures):
            what = "end or are mirrored beyond their edges (sampler wrap modes): they are repeated"
            self.notices.append(f"material {material['name']}: its textures {what}")
            return np.zeros(2), np.ones(2)
        for (owner, key), mode, picture in zip(slots, modes, pictures, strict=False):
            across, down = (_texels_of(n, low[i], size[i], mode[i]) for i, n in enumerate(picture.size))
            owner[key] = self._texture(np.asarray(picture)[down][:, across], owner[key])
        return low, size

    def _wraps(self, slot: dict[str, Any]) -> tuple[int, int]:
        texture = self.header["textures"][slot["index"]]
        sampler = self.header["samplers"][texture["sampler"]] if "sampler" in texture else {}
        return sampler.get("wrapS", _REPEAT), sampler.get("wrapT", _REPEAT)


def _texels_of(n: int, low: float, size: float, mode: int) -> np.ndarray:
    """Columns (or rows) of a picture of n that lie along a stretch of the texture plane."""
    i = np.arange(int(low) * n, int(low + size) * n)
    if mode == _CLAMP:
        return np.clip(i, 0, n - 1)
    return np.minimum(i % (2 * n), 2 * n - 1 - i % (2 * n)) if mode == _MIRROR else i % n


def _linear(texels: np.ndarray | None, a: int, factor: np.ndarray) -> np.ndarray:
    """Some rows of a picture in linear light, alpha as it is, times a factor; of no picture the factor."""
    if texels is None:
        return factor[None, None]
    rows = texels[a : a + _ROWS] / np.float32(255)
    rows[..., :3] = SRGB.decode(rows[..., :3])
    return rows * factor


def _metallic(diffuse: np.ndarray, shine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base colour (..., 3) and metallic (...) of diffuse colour with alpha and specular colour with glossiness.

    Source: Khronos' convert-between-workflows; brightness: root of the weighted squares (HSP)."""
    weights = np.array([0.299, 0.587, 0.114])
    d, s = (np.sqrt(x[..., :3] ** 2 @ weights) for x in (diffuse, shine))
    rest = (1.0 - shine[..., :3].max(-1)) / (1.0 - _DIELECTRIC)
    b = d * rest + s - 2 * _DIELECTRIC
    root = np.sqrt(np.maximum(b * b - 4 * _DIELECTRIC * (_DIELECTRIC - s), 0.0))
    metal = np.where(s < _DIELECTRIC, 0.0, np.clip((root - b) / (2 * _DIELECTRIC), 0.0, 1.0))
    m = metal[..., None]
    matt = diffuse[..., :3] * rest[..., None] / np.maximum(1.0 - m, 1e-6)
    shiny = (shine[..., :3] - _DIELECTRIC * (1.0 - m)) / np.maximum(m, 1e-6)
    return np.clip(matt + (shiny - matt) * m * m, 0.0, 1.0), metal


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """Corners of a list of triangles, from those of a strip or fan (section 3.7.2.1)."""
    if mode == _TRIANGLES:
        return corners
    i = np.arange(max(len(corners) - 2, 0))
    odd = i % 2
    order = (i, i + 1 + odd, i + 2 - odd) if mode == _STRIP else (i + 1, i + 2, 0 * i)
    return corners[np.stack(order, 1).ravel()]
