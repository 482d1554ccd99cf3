"""Numbers and bytes of a glTF file: buffers, views of them, accessors (glTF 2.0 section 3.6)."""

from __future__ import annotations

import base64
import struct
from typing import Any

import numpy as np

from arfx.errors import InputError
from arfx.media.model_limits import MAX_FACES
from arfx.media.model_parts import ModelFile

_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


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
                text = f"model {folder.path}: a buffer holds {len(content)} of {size} bytes"
                raise InputError(text, "the file is cut short, or damaged")
            self._contents.append(content)
        for number, view in enumerate(self._views):
            end = view.get("byteOffset", 0) + view["byteLength"]
            if end > len(self._contents[view["buffer"]]):
                text = f"model {folder.path}: view {number} ends beyond its buffer"
                raise InputError(text, "the file is damaged")

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
            raise InputError(f"model {self._folder.path}: accessor {number} counts {count}")
        return int(count)

    def array(self, number: int, columns: int | None = None) -> np.ndarray:
        """(count, columns) of an accessor, sparse values put in; normalised numbers are floats.

        columns : how many there must be, None = any. Raises InputError."""
        accessor, count = self._accessors[number], self.count(number)
        found = _SHAPES[accessor["type"]]
        if columns not in (None, found):
            what = f"accessor {number} is of type {accessor['type']}"
            raise InputError(f"model {self._folder.path}: {what}", "the file is damaged")
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
