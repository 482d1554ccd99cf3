"""A glTF file before anything is made of it: its JSON, what of it is left out, its numbers and
bytes: buffers, views of them, accessors (glTF 2.0 section 3.6)."""

from __future__ import annotations

import base64
import struct
from typing import Any

import numpy as np

from arfx.core.opener import parse_json
from arfx.errors import InputError
from arfx.media.model_files import DAMAGED, MAX_FACES, TABLES, ModelFile
from arfx.media.model_parts import shares

_CONVERT = "npx @gltf-transform/cli"
_SHAPES = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
_KINDS = {
    5120: "<i1",
    5121: "<u1",
    5122: "<i2",
    5123: "<u2",
    5125: "<u4",
    5126: "<f4",
}


class Gltf:
    """Its JSON and buffers, read at once.

    file : gets notices of what is left out;  header : its JSON
    Raises InputError: of no glTF 2, an extension that is required is not read, a buffer is
    missing or cut short; what Python raises where it does not fit together."""

    def __init__(self, file: ModelFile) -> None:
        self.file = file
        text, self._chunk = (
            _chunks(file.data) if file.kind == "glb" else (file.data, b"")
        )
        try:
            self.header: dict[str, Any] = parse_json(text.decode("utf-8-sig"))
        except ValueError as e:
            raise InputError(f"its JSON: {e}", DAMAGED) from None
        _check(self.header, file)
        self._views = self.header.get("bufferViews", [])
        self._buffers: list[bytes] = []
        for buffer in self.header.get("buffers", []):
            content, size = self.content(buffer), buffer.get("byteLength", 0)
            if len(content) < size:
                what = f"a buffer holds {len(content)} of {size} bytes"
                raise InputError(what, DAMAGED)
            self._buffers.append(content)

    def content(self, given: dict[str, Any]) -> bytes:
        """Of a buffer or a picture: a view, what is written in its address, a file beside the
        model, or what a GLB file holds behind its JSON. Raises InputError."""
        if "bufferView" in given:
            view = self._views[given["bufferView"]]
            start = view.get("byteOffset", 0)
            return self._buffers[view["buffer"]][start : start + view["byteLength"]]
        uri: str | None = given.get("uri")
        if uri is None:
            return self._chunk
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self.file.read(uri)

    def array(self, number: int, columns: int | None = None) -> np.ndarray:
        """(count, columns) of an accessor, sparse values put in; normalised numbers are floats.

        columns : how many there must be, None = any. Raises InputError."""
        accessor = self.header["accessors"][number]
        count, found = accessor["count"], _SHAPES[accessor["type"]]
        if not 0 <= count <= 3 * MAX_FACES:
            raise InputError(f"accessor {number} counts {count}", DAMAGED)
        if columns not in (None, found):
            raise InputError(
                f"accessor {number} is of type {accessor['type']}", DAMAGED
            )
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
        content = self._buffers[view["buffer"]]
        return np.ndarray(
            (count, columns), kind, content, start, (stride, kind.itemsize)
        )


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """The JSON of a GLB file, and what is behind it; nothing where there is none."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise InputError("it does not begin as a GLB file", DAMAGED)
    end = 20 + struct.unpack_from("<I", data, 12)[0]
    size = struct.unpack_from("<I", data, end)[0] if end + 8 <= len(data) else 0
    return data[20:end], data[end + 8 : end + 8 + size]


def _check(header: dict[str, Any], file: ModelFile) -> None:
    """Notices of what is left out. Raises InputError."""
    version = str(header.get("asset", {}).get("version") or "2.0")
    if not version.startswith("2."):
        hint = "export it again as glTF 2.0; Blender and `npx gltf-pipeline -i OLD -o NEW` do"
        raise InputError(f"it is glTF {version[:20]}, glTF 2.0 is read", hint)
    for name in header.get("extensionsRequired", []):
        if TABLES["extensions"].get(name) != "":
            hint = "export it without"
            if command := TABLES["converters"].get(name):
                hint += f": {_CONVERT} {command} {file.path.name} NEW.glb"
            raise InputError(f"it requires {name[:80]}, which is not read", hint)
    for name in header.get("extensionsUsed", []):
        if text := TABLES["extensions"].get(name, "an extension that is not read"):
            file.notices.append(f"left out {text} ({name[:80]})")
    at_rest = [key for key in ("animations", "skins") if header.get(key)]
    if any("targets" in p for m in header.get("meshes", []) for p in m["primitives"]):
        at_rest.append("morph targets")
    if at_rest:
        what = " and ".join(at_rest)
        file.notices.append(f"{what} left out: it is shown as it stands at rest")
