"""Camera calibration files: reads what other tools write, writes a file that OpenCV, ROS and people can read.

Read: OpenCV YAML/JSON, ROS camera_info YAML, COLMAP cameras.txt, Kalibr camchain YAML, WPILib and PhotonVision JSON.
Pixel centres: all of these put them at integers, except COLMAP, whose centres lie at .5 (corrected here).
Left out: XML, and lens models that OpenCV's polynomials cannot express (field-of-view, omnidirectional, division).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arfx.core.camera import BROWN, FISHEYE, Camera
from arfx.core.guard import aside
from arfx.core.opener import DEEPEST, bounded, parse_json, read_text
from arfx.errors import InputError
from arfx.media.camera_checks import check_camera, check_matrix, wrong

SUPPORTED = (
    "OpenCV YAML or JSON (camera_matrix, distortion_coefficients, image_width, image_height), ROS camera_info YAML, "
    "COLMAP cameras.txt, Kalibr camchain YAML, WPILib or PhotonVision JSON"
)
# Every name that the formats above give to the same thing, lower case, without underscores.
MATRIX_NAMES = ("cameramatrix", "cameraintrinsics", "intrinsicmatrix", "k", "mtx")
DISTORTION_NAMES = ("distortioncoefficients", "distcoeffs", "distortioncoeffs", "distortion", "dist", "d")
SIZE_NAMES = ("imagesize", "imgsize", "resolution", "size")
WIDTH_NAMES, HEIGHT_NAMES = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
MODEL_NAMES = ("distortionmodel", "cameramodel", "model")
FISHEYE_WORDS = {"fisheye", "equidistant", "kannala_brandt", "kannalabrandt", "kb4"}
BROWN_WORDS = {
    "", "pinhole", "plumb_bob", "radtan", "rational_polynomial", "brown", "brown_conrady", "opencv", "none",
    "thin_prism", "rational", "radial", "perspective",
}  # fmt: skip
# COLMAP model -> (names of its parameters, our model). Source: COLMAP documentation, "Camera Models".
COLMAP_MODELS: dict[str, tuple[str, str]] = {
    "SIMPLE_PINHOLE": ("f cx cy", BROWN),
    "PINHOLE": ("fx fy cx cy", BROWN),
    "SIMPLE_RADIAL": ("f cx cy k1", BROWN),
    "RADIAL": ("f cx cy k1 k2", BROWN),
    "OPENCV": ("fx fy cx cy k1 k2 p1 p2", BROWN),
    "FULL_OPENCV": ("fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6", BROWN),
    "SIMPLE_RADIAL_FISHEYE": ("f cx cy k1", FISHEYE),
    "RADIAL_FISHEYE": ("f cx cy k1 k2", FISHEYE),
    "OPENCV_FISHEYE": ("fx fy cx cy k1 k2 k3 k4", FISHEYE),
}
COLMAP_CENTRE_PX = 0.5  # the middle of the top left pixel is (0.5, 0.5) there and (0, 0) here


class _Loader(yaml.SafeLoader):
    """Plain YAML, with OpenCV's `!!opencv-matrix` read as the mapping that it is.

    No aliases, of which a few lines unfold to gigabytes, and no deep nesting, on which the library recurses.
    """

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not read: write the value out")
        if self.depth > DEEPEST:
            raise yaml.YAMLError(f"nested deeper than {DEEPEST}")
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", lambda loader, node: loader.construct_mapping(node, deep=True))


def load_camera(path: str | Path) -> Camera:
    """The camera in a calibration file; the format is told from the content.

    path : the file; where it holds several cameras, `FILE#NAME` (camchain.yaml#cam1, cameras.txt#2) chooses one

    Raises InputError if the file cannot be read, is of no known format, does not state the picture size, holds several
    cameras, has skew, or a lens model that OpenCV's polynomials cannot express.
    """
    file, chosen = Path(path), ""
    if "#" in file.name and not os.path.exists(file):  # noqa: PTH110 - False where it cannot be told, too
        name, _, chosen = file.name.rpartition("#")
        file = file.with_name(name)
    where = str(path)
    text = read_text(file, "camera file")
    if (rows := _colmap_rows(text)) is not None:
        return _from_colmap(rows, chosen, where)
    document = _parse(text, where)
    camchain = {k: v for k, v in document.items() if isinstance(v, Mapping) and "intrinsics" in v}
    if camchain:
        return _from_kalibr(_choose(camchain, chosen, where), where)
    if "intrinsics" in document and "distortion_coeffs" in document:
        return _from_kalibr(document, where)
    return _from_names(document, where)


def _parse(text: str, where: str) -> Mapping[str, Any]:
    try:
        if text.lstrip().startswith("{"):
            document = parse_json(text)
        else:  # OpenCV writes "%YAML:1.0", which is not a YAML directive; messages echoed by ROS end in "---"
            body = re.sub(r"\A\s*%YAML[^\n]*\n", "", text)
            parts = [p for p in yaml.load_all(body, _Loader) if p is not None]
            document = bounded(parts[0] if parts else None)
    except (ValueError, TypeError, yaml.YAMLError) as e:  # TypeError: a key that is a list
        first = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise InputError(f"camera file {where} is neither valid YAML nor JSON: {first}", f"supported: {SUPPORTED}") from None
    if not isinstance(document, Mapping):
        raise InputError(f"camera file {where} holds no camera calibration", f"supported: {SUPPORTED}")
    return document


def _from_names(document: Mapping[str, Any], where: str) -> Camera:
    """OpenCV, ROS, WPILib, PhotonVision: the same things under different names."""
    flat = {str(k).lower().replace("_", ""): v for k, v in document.items()}
    matrix = _numbers(_first(flat, MATRIX_NAMES), where, "the camera matrix")
    if matrix is None:
        keys = ", ".join(map(str, list(document)[:8])) or "nothing"
        raise InputError(f"camera file {where} holds no camera matrix (its keys: {keys})", f"supported: {SUPPORTED}")
    if matrix.size != 9:
        raise wrong(where, f"the camera matrix has {matrix.size} numbers", "9, row by row")
    found = _numbers(_first(flat, DISTORTION_NAMES), where, "the distortion coefficients")
    distortion = np.zeros(0) if found is None else found
    word = str(_first(flat, MODEL_NAMES) or "").lower()
    # OpenCV's calibration sample marks a fisheye calibration with `fisheye_model: 1`
    fisheye = word in FISHEYE_WORDS or str(flat.get("fisheyemodel", 0)) == "1"
    if not fisheye and word not in BROWN_WORDS:
        raise wrong(where, f"lens model {word!r} is not supported", "plumb_bob, rational_polynomial, equidistant")
    return _camera(matrix.reshape(3, 3), distortion, _size(flat, where), FISHEYE if fisheye else BROWN, where)


def _from_kalibr(entry: Mapping[str, Any], where: str) -> Camera:
    """Source: Kalibr wiki, "Yaml formats" and "Supported models"."""
    projection, lens = str(entry.get("camera_model", "pinhole")), str(entry.get("distortion_model", "none"))
    models = {"radtan": BROWN, "none": BROWN, "equidistant": FISHEYE}
    if projection != "pinhole" or lens not in models:
        raise wrong(where, f"Kalibr model {projection}-{lens} is not supported", "pinhole with radtan, equidistant or none")
    k = _numbers(entry["intrinsics"], where, "intrinsics")
    d = _numbers(entry.get("distortion_coeffs", []), where, "distortion_coeffs")
    if k is None or k.size != 4:
        raise wrong(where, "pinhole intrinsics are 4 numbers", "fx, fy, cx, cy")
    flat = {"resolution": entry.get("resolution")}
    return _camera(_matrix(*k), np.zeros(0) if d is None else d, _size(flat, where), models[lens], where)


def _colmap_rows(text: str) -> list[list[str]] | None:
    """The rows of a cameras.txt, or None if the text is something else."""
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not rows or any(len(r) < 5 or not r[0].isdigit() or not re.fullmatch(r"[A-Z][A-Z_]+", r[1]) for r in rows):
        return None
    return rows


def _from_colmap(rows: list[list[str]], chosen: str, where: str) -> Camera:
    row = _choose({r[0]: r for r in rows}, chosen, where)
    if row[1] not in COLMAP_MODELS:
        raise wrong(where, f"COLMAP model {row[1]} has no OpenCV equivalent", ", ".join(COLMAP_MODELS))
    names, model = COLMAP_MODELS[row[1]][0].split(), COLMAP_MODELS[row[1]][1]
    values = _numbers(row[2:], where, f"camera {row[0]}")
    if values is None or values.size != 2 + len(names):
        raise wrong(where, f"{row[1]} has {len(row) - 4} parameters", f"{len(names)}: {' '.join(names)}")
    p = dict(zip(names, values[2:], strict=True))
    matrix = _matrix(p.get("fx", p.get("f")), p.get("fy", p.get("f")), p["cx"] - COLMAP_CENTRE_PX, p["cy"] - COLMAP_CENTRE_PX)
    order = ("k1", "k2", "k3", "k4") if model == FISHEYE else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    last = 8 if "k6" in p else 4
    distortion = np.array([p.get(n, 0.0) for n in order[:last]])
    return _camera(matrix, distortion, _size({"size": row[2:4]}, where), model, where)


def _camera(matrix: np.ndarray, distortion: np.ndarray, size: tuple[int, int], model: str, where: str) -> Camera:
    if model == BROWN and 0 < distortion.size < 4:  # "k1" or "k1, k2": the rest is zero
        distortion = np.concatenate([distortion, np.zeros(4 - distortion.size)])
    if model == FISHEYE and distortion.size > 4 and not np.any(distortion[4:]):
        distortion = distortion[:4]
    check_matrix(matrix, where)
    camera = Camera(*size, matrix, distortion, model, where)
    check_camera(camera)
    return camera


def _choose(cameras: Mapping[str, Any], chosen: str, where: str) -> Any:
    if chosen and chosen not in cameras:
        raise wrong(where, f"no camera {chosen!r}", "it holds " + ", ".join(cameras))
    if not chosen and len(cameras) > 1:
        first = next(iter(cameras))
        raise InputError(
            f"camera file {where} holds {len(cameras)} cameras: {', '.join(cameras)}", f"choose one: {where}#{first}"
        )
    return cameras[chosen or next(iter(cameras))]


def _size(flat: Mapping[str, Any], where: str) -> tuple[int, int]:
    stated = _first(flat, SIZE_NAMES)
    width, height = _first(flat, WIDTH_NAMES), _first(flat, HEIGHT_NAMES)
    if isinstance(stated, Mapping):
        width, height = stated.get("width"), stated.get("height")
    elif isinstance(stated, Sequence) and not isinstance(stated, str) and len(stated) == 2:
        width, height = stated
    if width is None or height is None:
        raise InputError(
            f"camera file {where} does not state the picture size that it was made for",
            'add it: "image_width": 1920, "image_height": 1080 (YAML: without the quotation marks)',
        )
    values = _numbers([width, height], where, "the picture size")
    if values is None or not np.isfinite(values).all() or np.any(values != np.round(values)):
        raise wrong(where, f"picture size {width} x {height}", "two whole numbers of pixels")
    return int(values[0]), int(values[1])


def _first(flat: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((flat[n] for n in names if flat.get(n) is not None), None)


def _numbers(value: Any, where: str, what: str) -> np.ndarray | None:
    """(n,) float64 of nested lists, or of a {rows, cols, data} matrix; None for None. Keeps NaN for Camera to refuse."""
    if isinstance(value, Mapping):
        value = value.get("data")
    if value is None:
        return None
    try:
        flat = [_number(v) for v in np.asarray(value, object).ravel()]
    except (TypeError, ValueError, OverflowError):
        raise wrong(where, f"{what} is not a list of numbers", "numbers, row by row") from None
    return np.array(flat, float)


def _number(value: Any) -> float:
    """Numbers may arrive as text: YAML 1.1 does not read "1e-3" as one, and OpenCV writes ".Nan" and "-.Inf"."""
    if isinstance(value, str):
        value = value.strip().lower().replace(".nan", "nan").replace(".inf", "inf")
    return float(value)


def _matrix(fx: Any, fy: Any, cx: Any, cy: Any) -> np.ndarray:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], float)


def save_camera(path: str | Path, camera: Camera, **extras: Any) -> None:
    """Write OpenCV YAML whose names are also those of ROS camera_info; appears by atomic rename.

    cv2.FileStorage reads the matrices (`dt` makes them matrices), ROS tools and any YAML parser read the same keys: there is
    no `!!opencv-matrix` tag for a strict one to fail on.
    extras : further keys: numbers, text, lists, mappings (for people and tools; load_camera ignores them)

    Raises OSError where the folder cannot be written to; no file under the final name is left behind then.
    """
    path, fisheye = Path(path), camera.model == FISHEYE
    d = camera.distortion if camera.distortion.size else np.zeros(4 if fisheye else 5)
    if not fisheye and d.size == 4:
        d = np.append(d, 0.0)  # ROS's plumb_bob has five
    document = {
        "image_width": camera.width, "image_height": camera.height, "camera_name": "camera",
        "camera_matrix": _stored_matrix(camera.matrix),
        "distortion_model": "equidistant" if fisheye else "plumb_bob" if d.size <= 5 else "rational_polynomial",
        "distortion_coefficients": _stored_matrix(d[None]),
        "rectification_matrix": _stored_matrix(np.eye(3)),
        "projection_matrix": _stored_matrix(np.hstack([camera.matrix, np.zeros((3, 1))])),
        **({"fisheye_model": 1} if fisheye else {}),
        **extras,
    }  # fmt: skip
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=1 << 30, allow_unicode=True)
    with aside(path) as part:
        part.write_text(f"%YAML 1.0\n---\n{text}", encoding="utf-8")


def _stored_matrix(m: np.ndarray) -> dict[str, Any]:
    return {"rows": m.shape[0], "cols": m.shape[1], "dt": "d", "data": m.ravel().tolist()}
