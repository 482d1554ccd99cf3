"""The JSON of a glTF file before anything is made of it: version, extensions, what is left out;
and its numbers and bytes: buffers, views of them, accessors (glTF 2.0 section 3.6)."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.opener import parse_json
from arfx.errors import InputError
from arfx.media.model_files import MAX_FACES
from arfx.media.model_parts import ModelFile

_LISTS: tuple[str, ...] = ("accessors", "animations", "bufferViews", "buffers", "images")
_LISTS += ("materials", "meshes", "nodes", "samplers", "scenes", "skins", "textures")
# What is done with each extension: "" = read, else what will be missing where it is only used.
# Those that are not in the table, or not read, must not be in extensionsRequired.
_EXTENSIONS = {
    "KHR_materials_emissive_strength": "",
    "KHR_materials_ior": "",
    "KHR_materials_specular": "",
    "EXT_texture_webp": "",
    "KHR_xmp_json_ld": "",
    "KHR_lights_punctual": "its lamps: the clip's own light is used",
    "KHR_materials_variants": "its variants: the default one is shown",
    "KHR_materials_clearcoat": "",
    "KHR_materials_transmission": "transmission: glass looks solid",
    "KHR_materials_volume": "colour by depth of glass",
    "KHR_materials_sheen": "",
    "KHR_materials_iridescence": "iridescence",
    "KHR_materials_anisotropy": "anisotropic highlights",
    "KHR_materials_dispersion": "dispersion",
    "KHR_materials_unlit": "",
    "KHR_materials_pbrSpecularGlossiness": "",
    "KHR_mesh_quantization": "",
    "KHR_texture_transform": "",
    "KHR_node_visibility": "",
    "EXT_mesh_gpu_instancing": "",
    "KHR_animation_pointer": "animation",
    "KHR_texture_basisu": "textures in the KTX2 format",
}
_CONVERT = "npx @gltf-transform/cli"
_CONVERTERS = {
    "KHR_draco_mesh_compression": "copy",
    "EXT_meshopt_compression": "copy",
    "KHR_texture_basisu": "ktxdecompress",
    "EXT_texture_avif": "png",
}


_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


def gltf_header(data: bytes, kind: str, path: Path) -> dict[str, Any]:
    """The JSON of a .glb or .gltf, {} for other kinds. Raises InputError."""
    if kind not in ("glb", "gltf"):
        return {}
    text = data
    if kind == "glb":
        if len(data) < 20 or data[:4] != b"glTF":
            raise _damaged(path, "it does not begin as a GLB file")
        text = data[20 : 20 + struct.unpack("<I", data[12:16])[0]]
    try:
        header = parse_json(text)
    except UnicodeDecodeError:
        raise _damaged(path, "its JSON is not UTF-8") from None
    except json.JSONDecodeError as e:
        raise _damaged(
            path, f"its JSON breaks off or is wrong at line {e.lineno}, column {e.colno}"
        ) from None
    except ValueError as e:
        raise _damaged(path, f"its JSON: {e}") from None
    if not isinstance(header, dict):
        raise _damaged(path, "its JSON is no object")
    _check_version(header, path)
    for name in _LISTS:
        rows = header.get(name, [])
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise _damaged(path, f"{name} is no list of objects")
    return header


def check_gltf(header: dict[str, Any], path: Path) -> list[str]:
    """Notices of what is left out. Raises InputError: an extension that is required is not read."""
    left_out = _check_extensions(header, path)
    at_rest = [
        f"{len(header[key])} {what}{'s' if len(header[key]) > 1 else ''}"
        for key, what in (("animations", "animation"), ("skins", "skin"))
        if header.get(key)
    ]
    if any("targets" in p for m in header.get("meshes", []) for p in m["primitives"]):
        at_rest.append("morph targets")
    notices = []
    if at_rest:
        what = " and ".join(at_rest)
        notices.append(f"{what} left out: it is shown as it stands at rest")
    return notices + [f"left out {what}" for what in left_out]


def _check_version(header: dict[str, Any], path: Path) -> None:
    asset = header.get("asset", {})
    if not isinstance(asset, dict):
        raise _damaged(path, "its asset is no object")
    version = json.dumps(asset.get("version", "2.0") or "of no version").strip('"')[:20]
    if not version.startswith("2."):
        hint = (
            "export it again as glTF 2.0; Blender and `npx gltf-pipeline -i OLD -o NEW` do"
        )
        raise InputError(f"model {path} is glTF {version}, glTF 2.0 is read", hint)


def _check_extensions(header: dict[str, Any], path: Path) -> list[str]:
    """What extensions that are used leave out.

    Raises InputError: one that is required is not read.
    """
    keys = ("extensionsRequired", "extensionsUsed")
    required, used = ([name[:80] for name in header.get(key, [])] for key in keys)
    for name in required:
        if _EXTENSIONS.get(name) != "":
            how = (
                f": {_CONVERT} {_CONVERTERS[name]} {path.name} NEW.glb"
                if name in _CONVERTERS
                else ""
            )
            raise InputError(
                f"model {path} requires {name}, which is not read",
                f"export it without{how}",
            )
    texts = {name: _EXTENSIONS.get(name, "an extension that is not read") for name in used}
    return [f"{text} ({name})" for name, text in texts.items() if text]


def _damaged(path: Path, what: str) -> InputError:
    return InputError(
        f"cannot read model {path}: {what}", "the file is damaged or not what its name says"
    )


class Buffers:
    """All buffers of a file, read at once. Raises InputError: one is missing or cut short."""

    def __init__(self, file: ModelFile) -> None:
        folder, header = file.folder, file.header
        self._folder = folder
        self._accessors = header.get("accessors", [])
        self._views = header.get("bufferViews", [])
        chunk = _binary_chunk(file.data) if file.kind == "glb" else b""
        self._contents = []
        for buffer in header.get("buffers", []):
            content = self.file(buffer["uri"]) if "uri" in buffer else chunk
            size = buffer.get("byteLength", 0)
            if len(content) < size:
                raise _damaged(
                    folder.path, f"a buffer holds {len(content)} of {size} bytes"
                )
            self._contents.append(content)
        for number, view in enumerate(self._views):
            end = view.get("byteOffset", 0) + view["byteLength"]
            if end > len(self._contents[view["buffer"]]):
                raise _damaged(folder.path, f"view {number} ends beyond its buffer")

    def file(self, uri: str) -> bytes:
        """A file beside the model, or what is written in the address itself. Raises InputError."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self._folder.read(uri)

    def view(self, number: int) -> bytes:
        """The bytes of a view."""
        view = self._views[number]
        start = view.get("byteOffset", 0)
        return self._contents[view["buffer"]][start : start + view["byteLength"]]

    def count(self, number: int) -> int:
        """Of the rows of an accessor. Raises InputError: more than three a face."""
        count = self._accessors[number]["count"]
        if not 0 <= count <= 3 * MAX_FACES:
            raise _damaged(self._folder.path, f"accessor {number} counts {count}")
        return int(count)

    def array(self, number: int, columns: int | None = None) -> np.ndarray:
        """(count, columns) of an accessor, sparse values put in; normalised numbers are floats.

        columns : how many there must be, None = any. Raises InputError."""
        accessor, count = self._accessors[number], self.count(number)
        found = _SHAPES[accessor["type"]]
        if columns not in (None, found):
            what = f"accessor {number} is of type {accessor['type']}"
            raise _damaged(self._folder.path, what)
        out = np.zeros((count, found), _KINDS[accessor["componentType"]])
        if "bufferView" in accessor:
            out[:] = self._values(accessor, count, found)
        if sparse := accessor.get("sparse"):
            rows = self._values(sparse["indices"], sparse["count"], 1)[:, 0]
            values = {"componentType": accessor["componentType"], **sparse["values"]}
            out[rows] = self._values(values, sparse["count"], found)
        return shares(out) if accessor.get("normalized") else out

    def _values(self, place: dict[str, Any], count: int, columns: int) -> np.ndarray:
        """place : an accessor, or a part of a sparse one"""
        view, kind = (
            self._views[place["bufferView"]],
            np.dtype(_KINDS[place["componentType"]]),
        )
        start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * columns)
        content = self._contents[view["buffer"]]
        return np.ndarray((count, columns), kind, content, start, (stride, kind.itemsize))


def shares(values: np.ndarray) -> np.ndarray:
    """Whole numbers as float32 shares of the largest one, at least -1; floats as they are."""
    if values.dtype.kind == "f":
        return values
    return np.maximum(values / np.float32(np.iinfo(values.dtype).max), -1.0).astype(
        np.float32
    )


def _binary_chunk(data: bytes) -> bytes:
    """The second chunk of a GLB file, nothing where there is none."""
    start = 20 + struct.unpack("<I", data[12:16])[0]
    if start + 8 > len(data):
        return b""
    return data[start + 8 : start + 8 + struct.unpack("<I", data[start : start + 4])[0]]
