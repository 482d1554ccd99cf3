"""The JSON of a glTF file before anything is made of it: version, extensions, what is left out;
and its numbers and bytes: buffers, views of them, accessors (glTF 2.0 section 3.6)."""

from __future__ import annotations

import base64
import struct
from typing import Any

import numpy as np

from arfx.core.opener import parse_json
from arfx.errors import InputError
from arfx.media.model_files import DAMAGED, MAX_FACES, ModelFile
from arfx.media.model_materials import shares

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


def read_header(file: ModelFile) -> dict[str, Any]:
    """The JSON of a .glb or .gltf. The file gets notices of what is left out.

    Raises InputError: of no glTF 2, or an extension that is required is not read; what Python
    raises where it does not fit together."""
    data = file.data
    if file.kind == "glb":
        if len(data) < 20 or data[:4] != b"glTF":
            raise InputError("it does not begin as a GLB file", DAMAGED)
        data = data[20 : 20 + struct.unpack("<I", data[12:16])[0]]
    try:
        header: dict[str, Any] = parse_json(data.decode("utf-8-sig"))
    except ValueError as e:
        raise InputError(f"its JSON: {e}", DAMAGED) from None
    version = str(header.get("asset", {}).get("version") or "2.0")
    if not version.startswith("2."):
        hint = "export it again as glTF 2.0; Blender and `npx gltf-pipeline -i OLD -o NEW` do"
        raise InputError(f"it is glTF {version[:20]}, glTF 2.0 is read", hint)
    _check_extensions(header, file)
    at_rest = [key for key in ("animations", "skins") if header.get(key)]
    if any("targets" in p for m in header.get("meshes", []) for p in m["primitives"]):
        at_rest.append("morph targets")
    if at_rest:
        what = " and ".join(at_rest)
        file.notices.append(f"{what} left out: it is shown as it stands at rest")
    return header


def _check_extensions(header: dict[str, Any], file: ModelFile) -> None:
    """Notices of what extensions that are used leave out.

    Raises InputError: one that is required is not read."""
    for name in header.get("extensionsRequired", []):
        if _EXTENSIONS.get(name) != "":
            hint = "export it without"
            if name in _CONVERTERS:
                hint += f": {_CONVERT} {_CONVERTERS[name]} {file.path.name} NEW.glb"
            raise InputError(f"it requires {name[:80]}, which is not read", hint)
    for name in header.get("extensionsUsed", []):
        if text := _EXTENSIONS.get(name, "an extension that is not read"):
            file.notices.append(f"left out {text} ({name[:80]})")


class Buffers:
    """All buffers of a file, read at once. Raises InputError: one is missing or cut short."""

    def __init__(self, file: ModelFile, header: dict[str, Any]) -> None:
        self._file = file
        self._accessors = header.get("accessors", [])
        self._views = header.get("bufferViews", [])
        chunk = _binary_chunk(file.data) if file.kind == "glb" else b""
        self._contents = []
        for buffer in header.get("buffers", []):
            content = self.file(buffer["uri"]) if "uri" in buffer else chunk
            size = buffer.get("byteLength", 0)
            if len(content) < size:
                raise InputError(
                    f"a buffer holds {len(content)} of {size} bytes", DAMAGED
                )
            self._contents.append(content)

    def file(self, uri: str) -> bytes:
        """A file beside the model, or what is written in the address itself. Raises InputError."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self._file.read(uri)

    def view(self, number: int) -> bytes:
        """The bytes of a view."""
        view = self._views[number]
        start = view.get("byteOffset", 0)
        return self._contents[view["buffer"]][start : start + view["byteLength"]]

    def array(self, number: int, columns: int | None = None) -> np.ndarray:
        """(count, columns) of an accessor, sparse values put in; normalised numbers are floats.

        columns : how many there must be, None = any. Raises InputError."""
        accessor = self._accessors[number]
        count, found = accessor["count"], _SHAPES[accessor["type"]]
        if not 0 <= count <= 3 * MAX_FACES:
            raise InputError(f"accessor {number} counts {count}", DAMAGED)
        if columns not in (None, found):
            raise InputError(f"accessor {number} is of type {accessor['type']}", DAMAGED)
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
        view = self._views[place["bufferView"]]
        kind = np.dtype(_KINDS[place["componentType"]])
        start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * columns)
        content = self._contents[view["buffer"]]
        return np.ndarray((count, columns), kind, content, start, (stride, kind.itemsize))


def _binary_chunk(data: bytes) -> bytes:
    """The second chunk of a GLB file, nothing where there is none."""
    start = 20 + struct.unpack("<I", data[12:16])[0]
    if start + 8 > len(data):
        return b""
    return data[start + 8 : start + 8 + struct.unpack("<I", data[start : start + 4])[0]]
