"""What calibration files of all formats hold, as names and values; recognised by content."""

import contextlib
import io
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from numpy import ndarray

from arfx.core.opener import (
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
    " image_height), NumPy .npz with these names, ROS camera_info YAML, COLMAP cameras.txt,"
    " Kalibr camchain YAML, WPILib or PhotonVision JSON; YAML or JSON with"
    " fx, fy, width, height and maybe cx, cy, distortion"
)
TABLES = tomllib.loads(Path(__file__).with_name("cameras.toml").read_text("utf-8"))
# The middle of the top left pixel is (0.5, 0.5) there and (0, 0) here.
_COLMAP_CENTRE_PX = 0.5
_COLMAP_ROW = re.compile(r"\d+ [A-Z][A-Z_]+ ")
Document = Mapping[str, Any]  # names and values


class CameraFileError(InputError):
    """A camera file that is not read: what is wrong; and, unless a format of SUPPORTED would
    be right, what would be."""


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


def read_document(path: Path) -> Document:
    """Names and values; of COLMAP those of each camera by its number, named as by Kalibr.

    Raises CameraFileError, InputError."""
    data = read_bytes(path, "camera file")
    for other in TABLES["others"]:
        if data.startswith(other["start"].encode("latin-1")):
            raise CameraFileError(other["what"], other["hint"])
    if data.startswith(b"PK"):
        return _numpy(data)
    if path.suffix.lower() == ".bin":
        hint = "colmap model_converter --output_type TXT writes cameras.txt"
        raise CameraFileError("COLMAP's binary model is not read", hint)
    text = as_text(data, path, "camera file")
    rows = [
        words for line in text.splitlines() if (words := line.split("#")[0].split())
    ]
    if rows and all(len(r) > 4 and _COLMAP_ROW.match(" ".join(r)) for r in rows):
        return _colmap(rows)
    return _parse(text)


def numbers(value: Any, what: str) -> ndarray:
    """(n,) float64 of nested lists, or of a {rows, cols, data} matrix; none of None. Keeps
    NaN for Camera to refuse. Raises CameraFileError."""
    if isinstance(value, Mapping):
        value = value.get("data")
    flat = np.ravel(np.array([] if value is None else value, object))
    try:
        return np.array([number(v) for v in flat], float)
    except (TypeError, ValueError, OverflowError):
        raise CameraFileError(
            f"{what} is not a list of numbers", "numbers, row by row"
        ) from None


def number(value: Any) -> float:
    """Numbers may arrive as text: YAML 1.1 does not read "1e-3" as one, and OpenCV writes
    ".Nan" and "-.Inf".
    """
    if isinstance(value, str):
        value = value.strip().lower().replace(".nan", "nan").replace(".inf", "inf")
    return float(value)


def _numpy(data: bytes) -> Document:
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
        what = "it is not a NumPy archive that can be read"
        raise CameraFileError(
            f"{what}: damaged, or unpacks to more than 4 MiB"
        ) from None
    return out


def _colmap(rows: list[list[Any]]) -> dict[str, Any]:
    cameras = {}
    for camera, model, width, height, *given in rows:
        names = TABLES["colmap"].get(model, "")
        values = numbers(given, f"camera {camera}")
        if names and len(values) != len(names.split()):
            what = f"{model} has {len(values)} parameters"
            raise CameraFileError(what, f"{len(names.split())}: {names}")
        focals = 1 if names.startswith("f ") else 2
        centre = values[focals : focals + 2] - _COLMAP_CENTRE_PX
        cameras[camera] = {
            "intrinsics": [*np.resize(values[:focals], 2), *centre],
            "distortion_coeffs": values[focals + 2 :],
            "distortion_model": model,
            "resolution": [width, height],
        }
    return cameras


def _parse(text: str) -> Document:
    try:
        if text.lstrip().startswith("<"):
            return _xml(text)
        if text.lstrip().startswith("{"):
            document = parse_json(text)
        # OpenCV writes "%YAML:1.0", which is not a YAML directive; messages echoed by ROS
        # end in "---"
        else:
            body = re.sub(r"\A\s*%YAML[^\n]*\n", "", text)
            parts = [p for p in yaml.load_all(body, _Loader) if p is not None]
            document = bounded(parts[0] if parts else None)
    # TypeError: a key that is a list; SyntaxError: of XML
    except (ValueError, TypeError, SyntaxError, yaml.YAMLError) as e:
        first = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise CameraFileError(
            f"it is neither valid YAML, XML nor JSON: {first}"
        ) from None
    if not isinstance(document, Mapping):
        raise CameraFileError("it holds no camera calibration")
    return document


def _xml(text: str) -> Document:
    """OpenCV's: matrices hold their numbers in <data>."""
    if "<!DOCTYPE" in text:
        raise ValueError("a DOCTYPE is not read")
    root = ElementTree.fromstring(text)
    if root.tag != "opencv_storage":
        what = f"it is XML of another program (<{root.tag[:40]}>)"
        raise CameraFileError(what, f"export it for OpenCV; supported: {SUPPORTED}")
    out: dict[str, Any] = {}
    for node in root:
        words = (node.findtext("data") or node.text or "").split()
        out[node.tag] = words[0] if len(words) == 1 else words
    return out
