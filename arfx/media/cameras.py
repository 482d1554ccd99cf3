"""Camera calibration files: reads what other tools write, writes a file that OpenCV, ROS
and people can read.

Read: OpenCV YAML/XML/JSON, NumPy .npz, ROS camera_info YAML, COLMAP cameras.txt and .bin,
Kalibr camchain YAML, WPILib and
PhotonVision JSON; by hand fx, fy, cx, cy, width, height; each also packed by gzip.
Pixel centres: all of these put them at integers, except COLMAP, whose centres lie at .5
(corrected here). Left out: lens models that OpenCV's polynomials cannot express
(field-of-view, omnidirectional, division)."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arfx.core.camera import BROWN, FISHEYE, Camera
from arfx.core.guard import atomic_write
from arfx.errors import InputError
from arfx.media.camera_documents import (
    COLMAP_LEFT_OUT,
    COLMAP_MODELS,
    SUPPORTED,
    read_document,
)

# Every name that the formats above give to the same thing, lower case, without underscores.
MATRIX_NAMES = ("cameramatrix", "cameraintrinsics", "intrinsicmatrix", "k", "mtx")
FOCAL_NAMES, CENTRE_NAMES = ("fx", "fy"), ("cx", "cy")  # single, in a file by hand
DISTORTION_NAMES = tuple(
    [
        "distortioncoefficients",
        "distcoeffs",
        "distcoefs",
        "distortioncoeffs",
        "distortion",
        "dist",
        "d",
    ]
)
SIZE_NAMES = ("imagesize", "imgsize", "resolution", "size")
WIDTH_NAMES, HEIGHT_NAMES = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
MODEL_NAMES = ("distortionmodel", "cameramodel", "model")
FISHEYE_WORDS = {"fisheye", "equidistant", "kannala_brandt", "kannalabrandt", "kb4"}
BROWN_WORDS = (
    "pinhole plumb_bob radtan rational_polynomial brown brown_conrady opencv none"
    " thin_prism rational radial perspective"
)
_SHAPE = "fx 0 cx / 0 fy cy / 0 0 1, row by row"
_LARGEST_PX = 65536
COLMAP_CENTRE_PX = (
    0.5  # the middle of the top left pixel is (0.5, 0.5) there and (0, 0) here
)


def load_camera(path: str | Path) -> Camera:
    """The camera in a calibration file; the format is detected from the content.
    path : the file; where it holds several cameras, `FILE#NAME` (camchain.yaml#cam1,
    cameras.txt#2) chooses one
    Raises InputError if the file cannot be read, is of no known format, does not state the
    picture size, holds several cameras, has skew, or a lens model that OpenCV's polynomials
    cannot express."""
    file, chosen = Path(path), ""
    if "#" in file.name and not os.path.exists(file):  # noqa: PTH110 - False also where it cannot be known
        name, _, chosen = file.name.rpartition("#")
        file = file.with_name(name)
    where = str(path)
    document = read_document(file, where)
    if isinstance(document, list):
        row = _choose({r[0]: r for r in document}, chosen, where)
        return _from_names(_names_of_colmap(row, where), where)
    camchain = {
        k: v for k, v in document.items() if isinstance(v, Mapping) and "intrinsics" in v
    }
    if camchain:
        document = _choose(camchain, chosen, where)
    if camchain or {"intrinsics", "distortion_coeffs"} <= document.keys():
        document = _names_of_kalibr(document, where)
    return _from_names(document, where)


def _from_names(document: Mapping[str, Any], where: str) -> Camera:
    """OpenCV, ROS, WPILib, PhotonVision: the same things under different names."""
    flat = _flat(document)
    matrix = _numbers(_first(flat, MATRIX_NAMES), where, "the camera matrix")
    if not matrix.size and flat.keys() >= set(FOCAL_NAMES):
        middle = [(side - 1) / 2 for side in _size(flat, where)]
        centre = [flat.get(n, m) for n, m in zip(CENTRE_NAMES, middle, strict=True)]
        focal = [flat[n] for n in FOCAL_NAMES]
        fx, fy, cx, cy = _numbers([*focal, *centre], where, "the list fx, fy, cx, cy")
        matrix = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    if not matrix.size:
        keys = ", ".join(map(str, list(document)[:8])) or "nothing"
        raise InputError(
            f"camera file {where} holds no camera matrix (its keys: {keys})",
            f"supported: {SUPPORTED}",
        )
    if matrix.size != 9:
        raise _error(
            where, f"the camera matrix has {matrix.size} numbers", "9, row by row"
        )
    given = _first(flat, DISTORTION_NAMES)
    distortion = _numbers(given, where, "the distortion coefficients")
    word = str(_first(flat, MODEL_NAMES) or "")
    # OpenCV's calibration sample marks a fisheye calibration with `fisheye_model: 1`
    fisheye = word.lower() in FISHEYE_WORDS or str(flat.get("fisheyemodel", 0)) == "1"
    if not fisheye and word and word.lower() not in BROWN_WORDS.split():
        what = f"lens model {word!r} is not supported"
        raise _error(where, what, "plumb_bob, rational_polynomial, equidistant")
    if fisheye and not distortion[4:].any():
        distortion = distortion[:4]
    if not fisheye and 0 < distortion.size < 4:  # "k1" or "k1, k2": the rest is zero
        distortion = np.append(distortion, np.zeros(4))[:4]
    model = FISHEYE if fisheye else BROWN
    camera = Camera(*_size(flat, where), matrix.reshape(3, 3), distortion, model, where)
    _check(camera)
    return camera


def _names_of_kalibr(entry: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Source: Kalibr wiki, "Yaml formats" and "Supported models"."""
    four = _numbers(entry["intrinsics"], where, "intrinsics")
    if four.size != 4:
        raise _error(where, "pinhole intrinsics are 4 numbers", "fx, fy, cx, cy")
    lens = str(entry.get("distortion_model", "none"))
    projection = str(entry.get("camera_model", "pinhole"))
    return dict(zip((*FOCAL_NAMES, *CENTRE_NAMES), four, strict=True)) | {
        "d": entry.get("distortion_coeffs"),
        "model": lens if projection == "pinhole" else f"{projection}-{lens}",
        "size": entry.get("resolution"),
    }


def _names_of_colmap(row: list[str], where: str) -> dict[str, Any]:
    name = row[1]
    names = COLMAP_MODELS.get(name, "").split()
    values = _numbers(row[4:], where, f"camera {row[0]}")
    if name in COLMAP_LEFT_OUT or not names:
        able = ", ".join(n for n in COLMAP_MODELS if n not in COLMAP_LEFT_OUT)
        raise _error(where, f"COLMAP model {name} has no OpenCV equivalent", able)
    if len(values) != len(names):
        what = f"{name} has {len(values)} parameters"
        raise _error(where, what, f"{len(names)}: {' '.join(names)}")
    p = dict(zip(names, values, strict=True))
    focal = {n: p.get(n, p.get("f")) for n in FOCAL_NAMES}
    centre = {n: p[n] - COLMAP_CENTRE_PX for n in CENTRE_NAMES}
    fisheye = name.endswith("FISHEYE")
    order = ("k1 k2 k3 k4" if fisheye else "k1 k2 p1 p2 k3 k4 k5 k6").split()
    lens = [p.get(n, 0.0) for n in order[: 8 if "k6" in p else 4]]
    model = "fisheye" if fisheye else "opencv"
    return focal | centre | {"d": lens, "model": model, "size": row[2:4]}


def _choose(cameras: Mapping[str, Any], chosen: str, where: str) -> Any:
    if chosen and chosen not in cameras:
        raise _error(where, f"no camera {chosen!r}", "it holds " + ", ".join(cameras))
    if not chosen and len(cameras) > 1:
        first = next(iter(cameras))
        raise InputError(
            f"camera file {where} holds {len(cameras)} cameras: {', '.join(cameras)}",
            f"choose one: {where}#{first}",
        )
    return cameras[chosen or next(iter(cameras))]


def _size(flat: Mapping[str, Any], where: str) -> tuple[int, int]:
    stated = _first(flat, SIZE_NAMES)
    if isinstance(stated, Mapping):
        stated = [stated.get("width"), stated.get("height")]
    if not isinstance(stated, list) or len(stated) != 2:
        stated = [_first(flat, names) for names in (WIDTH_NAMES, HEIGHT_NAMES)]
    if None in stated:
        hint = (
            'add it: "image_width": 1920, "image_height": 1080 (YAML: without the quotation'
            " marks)"
        )
        if where.endswith(".npz"):
            hint = "np.savez(…, image_width=1920, image_height=1080)"
        raise InputError(
            f"camera file {where} does not state the picture size that it was made for",
            hint,
        )
    values = _numbers(stated, where, "the picture size")
    if not np.isfinite(values).all() or (values != np.round(values)).any():
        what = "picture size {} x {}".format(*stated)
        raise _error(where, what, "two whole numbers of pixels")
    return int(values[0]), int(values[1])


def _flat(document: Mapping[str, Any]) -> dict[str, Any]:
    return {str(k).lower().replace("_", ""): v for k, v in document.items()}


def _first(flat: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((flat[n] for n in names if flat.get(n) is not None), None)


def _numbers(value: Any, where: str, what: str) -> np.ndarray:
    """(n,) float64 of nested lists, or of a {rows, cols, data} matrix; none of None. Keeps
    NaN for Camera to refuse."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        flat = [
            _number(v) for v in np.ravel(np.array([] if value is None else value, object))
        ]
    except (TypeError, ValueError, OverflowError):
        what = f"{what} is not a list of numbers"
        raise _error(where, what, "numbers, row by row") from None
    return np.array(flat, float)


def _number(value: Any) -> float:
    """Numbers may arrive as text: YAML 1.1 does not read "1e-3" as one, and OpenCV writes
    ".Nan" and "-.Inf".
    """
    if isinstance(value, str):
        value = value.strip().lower().replace(".nan", "nan").replace(".inf", "inf")
    return float(value)


def save_camera(path: str | Path, camera: Camera, **extras: Any) -> None:
    """Write OpenCV YAML whose names are also those of ROS camera_info; appears by atomic rename.

    cv2.FileStorage reads the matrices (`dt` makes them matrices), ROS tools and any YAML
    parser read the same keys: there is no `!!opencv-matrix` tag for a strict one to fail
    on.
    extras : further keys: numbers, text, lists, mappings (for people and tools; load_camera
    ignores them)

    Raises OSError where the folder cannot be written to; no file under the final name is
    left behind then."""
    path, fisheye = Path(path), camera.model == FISHEYE
    d = camera.distortion if camera.distortion.size else np.zeros(4 if fisheye else 5)
    if not fisheye and d.size == 4:
        d = np.append(d, 0.0)  # ROS's plumb_bob has five
    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": _stored_matrix(camera.matrix),
        "distortion_model": (
            "equidistant"
            if fisheye
            else "plumb_bob"
            if d.size <= 5
            else "rational_polynomial"
        ),
        "distortion_coefficients": _stored_matrix(d[None]),
        "rectification_matrix": _stored_matrix(np.eye(3)),
        "projection_matrix": _stored_matrix(np.hstack([camera.matrix, np.zeros((3, 1))])),
        **({"fisheye_model": 1} if fisheye else {}),
        **extras,
    }
    text = yaml.safe_dump(
        document,
        sort_keys=False,
        default_flow_style=None,
        width=1 << 30,
        allow_unicode=True,
    )
    with atomic_write(path) as part:
        part.write_text(f"%YAML 1.0\n---\n{text}", encoding="utf-8")


def _stored_matrix(m: np.ndarray) -> dict[str, Any]:
    return {"rows": m.shape[0], "cols": m.shape[1], "dt": "d", "data": m.ravel().tolist()}


def _error(where: str, what: str, hint: str) -> InputError:
    return InputError(f"camera file {where}: {what}", hint)


def _check(camera: Camera) -> None:
    """Raises InputError: a matrix of another shape, numbers that no camera has."""
    m, where, side = camera.matrix, camera.source, max(camera.width, camera.height)
    last, off = np.abs(m[2] - (0, 0, 1)) > 1e-6, 1e-6 * max(camera.fx, camera.fy)
    row = " ".join(f"{v:g}" for v in m[2])
    what = f"a picture of {camera.width}x{camera.height}"
    if side > _LARGEST_PX:
        raise _error(where, what, f"at most {_LARGEST_PX} px a side")
    if last.any() and not last[2] and np.abs(m[:2, 2]).max() <= 1e-6:
        what = f"the camera matrix is transposed, its last row is {row}"
        raise _error(where, what, f"as rows: {_SHAPE}")
    if last.any():
        raise _error(where, f"the camera matrix's last row is {row}, not 0 0 1", _SHAPE)
    if abs(m[0, 1]) > off:
        what = f"the camera matrix has skew {m[0, 1]:g}"
        raise _error(where, what, "calibrate without skew")
    if abs(m[1, 0]) > off:
        raise _error(
            where, f"the camera matrix holds {m[1, 0]:g} where 0 belongs", _SHAPE
        )
    for value, (low, high), what, hint, _, _ in _measures(camera):
        if not low <= value <= high:
            raise _error(where, what, hint)


def camera_warnings(camera: Camera) -> list[str]:
    """Notices of what is unusual and may be meant."""
    doubts = {
        doubt: None
        for value, _, _, _, (low, high), doubt in _measures(camera)
        if not low <= value <= high
    }
    return [f"camera calibration {camera.source}: {text}" for text in doubts]


def _measures(camera: Camera) -> Iterator[tuple[Any, ...]]:
    """Of each number its value, between what it may be, else what is wrong and what would be
    right, between what it usually is, and else what to doubt."""
    size, side = (camera.width, camera.height), max(camera.width, camera.height)
    wide = f"{camera.width}x{camera.height}"
    unusual = f"a focal length of {camera.fx:g} px is unusual for {wide}"
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        low, high = 0.02, 2000.0  # 175 degrees of view, a hundredth of a degree
        what = f"{name} is {focal:g} px for a picture of {wide}"
        hint = (
            f"a focal length in pixels, {low * side:g} to {high * side:g} here; often about"
            f" {side}"
        )
        yield focal / side, (low, high), what, hint, (0.15, 100.0), unusual
    both = f"fx {camera.fx:g} and fy {camera.fy:g}"
    what, doubt = (
        f"{both} are far apart",
        f"{both} px differ much: are the pixels that oblong?",
    )
    # anamorphic video reaches 2
    usual = 1 / 1.5, 1.5
    yield (
        camera.fx / camera.fy,
        (0.1, 10.0),
        what,
        "pixels are nearly square",
        usual,
        doubt,
    )
    doubt = (
        f"the principal point {camera.cx:g}, {camera.cy:g} lies outside the picture: is it a"
        " crop?"
    )
    for name, at, length in zip(("cx", "cy"), camera.matrix[:2, 2], size, strict=True):
        what = f"the principal point's {name} is {at:g} px, far outside the picture"
        hint = f"near the middle: {length / 2:g}"
        yield at / length, (-5.0, 6.0), what, hint, (0.0, 1.0), doubt
    again, most = "calibrate again", (0.0, 1e6)
    worst = np.abs(camera.distortion).max(initial=0.0)
    yield worst, most, f"a distortion coefficient is {worst:g}", again, most, ""
    what = "with its distortion almost no pixel has a viewing direction"
    x, y = np.meshgrid(*(np.linspace(0, n - 1, 17) for n in size))
    with np.errstate(all="ignore"):
        seen = np.isfinite(camera.normalised(np.stack([x, y], -1))).all(-1).mean()
    doubt = f"the distortion holds for {seen:.0%} of the picture only"
    # a full circle of a fisheye lens has 0.55
    yield seen, (0.05, 1.0), what, again, (0.5, 1.0), doubt


def calibration_claims(path: str | Path) -> dict[str, Any]:
    """What `arfx calibrate` wrote of itself into a camera file: verdict, reasons,
    condition; {} for files of others.
    """
    try:
        document = read_document(Path(path), str(path))
    except InputError:  # one camera of a file that holds several
        return {}
    flat = _flat(document) if isinstance(document, Mapping) else {}
    out = {
        key: flat[key]
        for key, kind in (("verdict", str), ("reasons", list))
        if isinstance(flat.get(key), kind)
    }
    with contextlib.suppress(TypeError, ValueError):
        if math.isfinite(condition := _number(flat.get("condition"))):
            out["condition"] = condition
    return out


def claim_warnings(camera: Camera, claims: Mapping[str, Any]) -> list[str]:
    """Notices of what a calibration (of this camera) admits of itself."""
    if claims.get("verdict") != "poor":
        return []
    why = "".join(f" ({str(r)[:200]})" for r in claims.get("reasons", ())[:1])
    text = (
        f"its own verdict is poor{why}: sizes and perspective may be off; better calibrate"
        " again"
    )
    return [f"camera calibration {camera.source}: {text}"]
