"""What calibration files of all formats hold, as names and values, or as the rows of a
COLMAP model; recognised by content.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import re
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from arfx.core.opener import (
    LIMITS,
    MAX_NESTING,
    MIB,
    as_text,
    bounded,
    parse_json,
    read_bytes,
)
from arfx.errors import InputError

SUPPORTED = (
    "OpenCV YAML, XML or JSON (camera_matrix, distortion_coefficients, image_width,"
    " image_height), NumPy .npz with these names, ROS camera_info YAML, COLMAP cameras.txt"
    " or cameras.bin, Kalibr camchain YAML, WPILib or PhotonVision JSON; YAML or JSON with"
    " fx, fy, width, height and maybe cx, cy, distortion"
)
# How other files begin -> what they are, and what to do.
_OTHERS = {
    b"\x93NUMPY": (
        "a single NumPy array",
        (
            "np.savez(…, camera_matrix=, distortion_coefficients=, image_width=,"
            " image_height=)"
        ),
    ),
    b"\x80": (
        "a Python pickle, which could run code",
        "save the same as .npz with np.savez, or as YAML",
    ),
    b"MATLAB": (
        "a MATLAB file",
        "write camera_matrix, distortion_coefficients, image_width, image_height as YAML",
    ),
}
# COLMAP's models in the order of their numbers -> their parameters. Sources: COLMAP,
# src/colmap/sensor/models.h; its documentation, "Camera Models".
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
}
COLMAP_LEFT_OUT = ("FOV", "THIN_PRISM_FISHEYE")  # OpenCV has nothing like them


class _Loader(yaml.SafeLoader):
    """Plain YAML, with OpenCV's `!!opencv-matrix` read as the mapping that it is.
    No aliases, of which a few lines unfold to gigabytes, and no deep nesting, on which the
    library recurses."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not read: write the value out")
        if self.depth > MAX_NESTING:
            raise yaml.YAMLError(f"nested deeper than {MAX_NESTING}")
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(
        f"tag:yaml.org,2002:{_tag}",
        lambda loader, node: loader.construct_mapping(node, deep=True),
    )


def read_document(path: Path, where: str) -> Mapping[str, Any] | list[list[str]]:
    """Names and values, or the rows of a cameras.txt.

    where : the file, as messages call it. Raises InputError.
    """
    data = read_bytes(path, "camera file")
    if data.startswith(b"\x1f\x8b"):
        data = _unpacked(data, where)
    for start, (what, instead) in _OTHERS.items():
        if data.startswith(start):
            raise InputError(f"camera file {where} is {what}", instead)
    if data.startswith(b"PK"):
        return _numpy(data, where)
    rows = _colmap_binary(data)
    if rows is None:
        text = as_text(data, path, "camera file")
        rows = _colmap_rows(text)
    return _parse(text, where) if rows is None else rows


def _unpacked(data: bytes, where: str) -> bytes:
    limit = int(LIMITS["camera file"] * MIB)
    try:
        with gzip.open(io.BytesIO(data)) as file:
            out = file.read(limit + 1)
    except (OSError, EOFError, zlib.error):
        raise InputError(f"camera file {where} is a damaged gzip file") from None
    if len(out) > limit:
        raise InputError(
            f"camera file {where} unpacks to more than {limit} bytes",
            f"supported: {SUPPORTED}",
        )
    return out


def _numpy(data: bytes, where: str) -> Mapping[str, Any]:
    """Arrays by name, without those that hold Python objects."""
    out: dict[str, Any] = {}
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            if sum(member.file_size for member in arrays.zip.infolist()) > 4 * MIB:
                raise ValueError
            for name in arrays.files:
                with contextlib.suppress(ValueError):
                    out[name] = arrays[name].tolist()
    except Exception:  # whatever these readers stumble over
        raise InputError(
            f"camera file {where} is not a NumPy archive that can be read: it is damaged, or"
            " unpacks to more than 4 MiB"
        ) from None
    return out


def _colmap_binary(data: bytes) -> list[list[str]] | None:
    """The rows of a cameras.bin as in a cameras.txt, or None if the bytes are something else."""
    rows = list[list[str]]()
    with contextlib.suppress(struct.error, IndexError):
        (count,), at = struct.unpack_from("<Q", data), 8
        while at < len(data):
            number, model, width, height = struct.unpack_from("<IIQQ", data, at)
            name, names = list(COLMAP_MODELS.items())[model]
            parameters = len(names.split())
            values = struct.unpack_from(f"<{parameters}d", data, at + 24)
            rows.append([str(number), name, *map(str, (width, height, *values))])
            at += 24 + 8 * parameters
        return rows if 0 < len(rows) == count else None
    return None


def _colmap_rows(text: str) -> list[list[str]] | None:
    """The rows of a cameras.txt, or None if the text is something else."""
    rows = [
        line.split()
        for line in text.splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows or any(
        len(r) < 5 or not r[0].isdigit() or not re.fullmatch(r"[A-Z][A-Z_]+", r[1])
        for r in rows
    ):
        return None
    return rows


def _parse(text: str, where: str) -> Mapping[str, Any]:
    try:
        if text.lstrip().startswith("<"):
            return _xml(text, where)
        if text.lstrip().startswith("{"):
            document = parse_json(text)
        # OpenCV writes "%YAML:1.0", which is not a YAML directive; messages echoed by ROS
        # end in "---"
        else:
            body = re.sub(r"\A\s*%YAML[^\n]*\n", "", text)
            parts = [p for p in yaml.load_all(body, _Loader) if p is not None]
            document = bounded(parts[0] if parts else None)
    except (
        ValueError,
        TypeError,
        SyntaxError,
        yaml.YAMLError,
    ) as e:  # TypeError: a key that is a list; SyntaxError: of XML
        first = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise InputError(
            f"camera file {where} is neither valid YAML, XML nor JSON: {first}",
            f"supported: {SUPPORTED}",
        ) from None
    if not isinstance(document, Mapping):
        raise InputError(
            f"camera file {where} holds no camera calibration", f"supported: {SUPPORTED}"
        )
    return document


def _xml(text: str, where: str) -> Mapping[str, Any]:
    """OpenCV's: matrices hold their numbers in <data>."""
    if "<!DOCTYPE" in text:
        raise ValueError("a DOCTYPE is not read")
    root = ElementTree.fromstring(text)
    if root.tag != "opencv_storage":
        what = f"XML of another program (<{root.tag[:40]}>)"
        raise InputError(
            f"camera file {where} is {what}",
            f"export it for OpenCV; supported: {SUPPORTED}",
        )
    out: dict[str, Any] = {}
    for node in root:
        words = (node.findtext("data") or node.text or "").split()
        out[node.tag] = words[0] if len(words) == 1 else words
    return out
