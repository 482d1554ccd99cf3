"""Camera calibration files: reads what other tools write, writes a file that OpenCV, ROS
and people can read.

Read: OpenCV YAML/XML/JSON, NumPy .npz, ROS camera_info YAML, COLMAP cameras.txt and .bin,
Kalibr camchain YAML, WPILib and
PhotonVision JSON; each also packed by gzip.
Pixel centres: all of these put them at integers, except COLMAP, whose centres lie at .5
(corrected here). Left out: lens models that OpenCV's polynomials cannot express
(field-of-view, omnidirectional, division)."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arfx.core.camera import BROWN, FISHEYE, Camera
from arfx.core.guard import atomic_write
from arfx.errors import InputError
from arfx.media.camera_documents import SUPPORTED, read_document

# Every name that the formats above give to the same thing, lower case, without underscores.
MATRIX_NAMES = ("cameramatrix", "cameraintrinsics", "intrinsicmatrix", "k", "mtx")
DISTORTION_NAMES = (
    "distortioncoefficients",
    "distcoeffs",
    "distcoefs",
    "distortioncoeffs",
    "distortion",
    "dist",
    "d",
)
SIZE_NAMES = ("imagesize", "imgsize", "resolution", "size")
WIDTH_NAMES, HEIGHT_NAMES = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
MODEL_NAMES = ("distortionmodel", "cameramodel", "model")
FISHEYE_WORDS = {"fisheye", "equidistant", "kannala_brandt", "kannalabrandt", "kb4"}
BROWN_WORDS = {
    "",
    "pinhole",
    "plumb_bob",
    "radtan",
    "rational_polynomial",
    "brown",
    "brown_conrady",
    "opencv",
    "none",
    "thin_prism",
    "rational",
    "radial",
    "perspective",
}
# COLMAP model -> (names of its parameters, our model). Source: COLMAP documentation,
# "Camera Models".
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
# Limits of calibrations: what is surely wrong is refused, what is unusual is reported.
_SHAPE = "fx 0 cx / 0 fy cy / 0 0 1, row by row"
_LARGEST_PX = 65536
_FOCAL = (
    0.02,
    2000.0,
)  # focal length as a fraction of the longer side: 175 degrees of view, a hundredth of a degree
_USUAL_FOCAL = (0.15, 100.0)
_ASPECT, _USUAL_ASPECT = 10.0, 1.5  # of the pixels: anamorphic video reaches 2
_CENTRE = 5.0  # picture sides by which a crop of a picture may lie off its principal point
_COEFFICIENT = 1e6
# share of the picture with a viewing direction: a full circle of a fisheye lens has 0.55
_USUAL_VISIBLE, _MIN_VISIBLE = 0.5, 0.05
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
        return _from_colmap(document, chosen, where)
    camchain = {
        k: v for k, v in document.items() if isinstance(v, Mapping) and "intrinsics" in v
    }
    if camchain:
        return _from_kalibr(_choose(camchain, chosen, where), where)
    if "intrinsics" in document and "distortion_coeffs" in document:
        return _from_kalibr(document, where)
    return _from_names(document, where)


def _from_names(document: Mapping[str, Any], where: str) -> Camera:
    """OpenCV, ROS, WPILib, PhotonVision: the same things under different names."""
    flat = _flat(document)
    matrix = _numbers(_first(flat, MATRIX_NAMES), where, "the camera matrix")
    if matrix is None:
        keys = ", ".join(map(str, list(document)[:8])) or "nothing"
        raise InputError(
            f"camera file {where} holds no camera matrix (its keys: {keys})",
            f"supported: {SUPPORTED}",
        )
    if matrix.size != 9:
        raise _error(where, f"the camera matrix has {matrix.size} numbers", "9, row by row")
    found = _numbers(_first(flat, DISTORTION_NAMES), where, "the distortion coefficients")
    distortion = np.zeros(0) if found is None else found
    word = str(_first(flat, MODEL_NAMES) or "").lower()
    # OpenCV's calibration sample marks a fisheye calibration with `fisheye_model: 1`
    fisheye = word in FISHEYE_WORDS or str(flat.get("fisheyemodel", 0)) == "1"
    if not fisheye and word not in BROWN_WORDS:
        raise _error(
            where,
            f"lens model {word!r} is not supported",
            "plumb_bob, rational_polynomial, equidistant",
        )
    return _camera(
        matrix.reshape(3, 3),
        distortion,
        _size(flat, where),
        FISHEYE if fisheye else BROWN,
        where,
    )


def _from_kalibr(entry: Mapping[str, Any], where: str) -> Camera:
    """Source: Kalibr wiki, "Yaml formats" and "Supported models"."""
    projection, lens = (
        str(entry.get("camera_model", "pinhole")),
        str(entry.get("distortion_model", "none")),
    )
    models = {"radtan": BROWN, "none": BROWN, "equidistant": FISHEYE}
    if projection != "pinhole" or lens not in models:
        raise _error(
            where,
            f"Kalibr model {projection}-{lens} is not supported",
            "pinhole with radtan, equidistant or none",
        )
    k = _numbers(entry["intrinsics"], where, "intrinsics")
    d = _numbers(entry.get("distortion_coeffs", []), where, "distortion_coeffs")
    if k is None or k.size != 4:
        raise _error(where, "pinhole intrinsics are 4 numbers", "fx, fy, cx, cy")
    flat = {"resolution": entry.get("resolution")}
    return _camera(
        _matrix(*k),
        np.zeros(0) if d is None else d,
        _size(flat, where),
        models[lens],
        where,
    )


def _from_colmap(rows: list[list[str]], chosen: str, where: str) -> Camera:
    row = _choose({r[0]: r for r in rows}, chosen, where)
    if row[1] not in COLMAP_MODELS:
        raise _error(
            where,
            f"COLMAP model {row[1]} has no OpenCV equivalent",
            ", ".join(COLMAP_MODELS),
        )
    names, model = COLMAP_MODELS[row[1]][0].split(), COLMAP_MODELS[row[1]][1]
    values = _numbers(row[2:], where, f"camera {row[0]}")
    if values is None or values.size != 2 + len(names):
        raise _error(
            where,
            f"{row[1]} has {len(row) - 4} parameters",
            f"{len(names)}: {' '.join(names)}",
        )
    p = dict(zip(names, values[2:], strict=True))
    matrix = _matrix(
        p.get("fx", p.get("f")),
        p.get("fy", p.get("f")),
        p["cx"] - COLMAP_CENTRE_PX,
        p["cy"] - COLMAP_CENTRE_PX,
    )
    order = (
        ("k1", "k2", "k3", "k4")
        if model == FISHEYE
        else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    )
    last = 8 if "k6" in p else 4
    distortion = np.array([p.get(n, 0.0) for n in order[:last]])
    return _camera(matrix, distortion, _size({"size": row[2:4]}, where), model, where)


def _camera(
    matrix: np.ndarray,
    distortion: np.ndarray,
    size: tuple[int, int],
    model: str,
    where: str,
) -> Camera:
    if model == BROWN and 0 < distortion.size < 4:  # "k1" or "k1, k2": the rest is zero
        distortion = np.concatenate([distortion, np.zeros(4 - distortion.size)])
    if model == FISHEYE and distortion.size > 4 and not np.any(distortion[4:]):
        distortion = distortion[:4]
    _check_matrix(matrix, where)
    camera = Camera(*size, matrix, distortion, model, where)
    _check_camera(camera)
    return camera


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
    width, height = _first(flat, WIDTH_NAMES), _first(flat, HEIGHT_NAMES)
    if isinstance(stated, Mapping):
        width, height = stated.get("width"), stated.get("height")
    elif isinstance(stated, Sequence) and not isinstance(stated, str) and len(stated) == 2:
        width, height = stated
    if width is None or height is None:
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
    values = _numbers([width, height], where, "the picture size")
    if (
        values is None
        or not np.isfinite(values).all()
        or np.any(values != np.round(values))
    ):
        raise _error(
            where, f"picture size {width} x {height}", "two whole numbers of pixels"
        )
    return int(values[0]), int(values[1])


def _flat(document: Mapping[str, Any]) -> dict[str, Any]:
    return {str(k).lower().replace("_", ""): v for k, v in document.items()}


def _first(flat: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((flat[n] for n in names if flat.get(n) is not None), None)


def _numbers(value: Any, where: str, what: str) -> np.ndarray | None:
    """(n,) float64 of nested lists, or of a {rows, cols, data} matrix; None for None. Keeps
    NaN for Camera to refuse.
    """
    if isinstance(value, Mapping):
        value = value.get("data")
    if value is None:
        return None
    try:
        flat = [_number(v) for v in np.asarray(value, object).ravel()]
    except (TypeError, ValueError, OverflowError):
        raise _error(
            where, f"{what} is not a list of numbers", "numbers, row by row"
        ) from None
    return np.array(flat, float)


def _number(value: Any) -> float:
    """Numbers may arrive as text: YAML 1.1 does not read "1e-3" as one, and OpenCV writes
    ".Nan" and "-.Inf".
    """
    if isinstance(value, str):
        value = value.strip().lower().replace(".nan", "nan").replace(".inf", "inf")
    return float(value)


def _matrix(fx: Any, fy: Any, cx: Any, cy: Any) -> np.ndarray:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], float)


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


def _check_matrix(m: np.ndarray, where: str) -> None:
    """m : (3, 3). Raises InputError where its zeros and ones are misplaced; other values
    are not checked.
    """
    if not np.isfinite(m).all():
        return  # Camera says so
    size = max(abs(m[0, 0]), abs(m[1, 1]), 1e-300)
    last = m[2]
    if abs(last[2] - 1) > 1e-6 or np.abs(last[:2]).max() > 1e-6:
        if np.abs(m[:2, 2]).max() <= 1e-6 and abs(last[2] - 1) <= 1e-6:
            raise _error(
                where,
                f"the camera matrix is transposed, its last row is {_row(last)}",
                f"as rows: {_SHAPE}",
            )
        raise _error(
            where, f"the camera matrix's last row is {_row(last)}, not 0 0 1", _SHAPE
        )
    if abs(m[0, 1]) > 1e-6 * size:
        raise _error(
            where, f"the camera matrix has skew {m[0, 1]:g}", "calibrate without skew"
        )
    if abs(m[1, 0]) > 1e-6 * size:
        raise _error(where, f"the camera matrix holds {m[1, 0]:g} where 0 belongs", _SHAPE)


def _check_camera(camera: Camera) -> None:
    """Raises InputError: numbers that no camera has."""
    where, side = camera.source, max(camera.width, camera.height)
    if side > _LARGEST_PX:
        raise _error(
            where,
            f"a picture of {camera.width}x{camera.height}",
            f"at most {_LARGEST_PX} px a side",
        )
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        if not _FOCAL[0] * side <= focal <= _FOCAL[1] * side:
            hint = (
                f"a focal length in pixels, {_FOCAL[0] * side:g} to {_FOCAL[1] * side:g}"
                f" here; often about {side}"
            )
            raise _error(
                where,
                f"{name} is {focal:g} px for a picture of {camera.width}x{camera.height}",
                hint,
            )
    if not 1 / _ASPECT <= camera.fx / camera.fy <= _ASPECT:
        raise _error(
            where,
            f"fx {camera.fx:g} and fy {camera.fy:g} are far apart",
            "pixels are nearly square",
        )
    for name, at, length in (
        ("cx", camera.cx, camera.width),
        ("cy", camera.cy, camera.height),
    ):
        if not -_CENTRE * length <= at <= (1 + _CENTRE) * length:
            what = f"the principal point's {name} is {at:g} px, far outside the picture"
            raise _error(where, what, f"near the middle: {length / 2:g}")
    if camera.distortion.size and np.abs(camera.distortion).max() > _COEFFICIENT:
        raise _error(
            where,
            f"a distortion coefficient is {np.abs(camera.distortion).max():g}",
            "calibrate again",
        )
    if _visible_fraction(camera) < _MIN_VISIBLE:
        raise _error(
            where,
            "with its distortion almost no pixel has a viewing direction",
            "calibrate again",
        )


def camera_warnings(camera: Camera) -> list[str]:
    """Notices of what is unusual and may be meant."""
    out, side = [], max(camera.width, camera.height)
    if not 1 / _USUAL_ASPECT <= camera.fx / camera.fy <= _USUAL_ASPECT:
        out.append(
            f"fx {camera.fx:g} and fy {camera.fy:g} px differ much: are the pixels that"
            " oblong?"
        )
    if not all(
        _USUAL_FOCAL[0] * side <= f <= _USUAL_FOCAL[1] * side
        for f in (camera.fx, camera.fy)
    ):
        out.append(
            f"a focal length of {camera.fx:g} px is unusual for"
            f" {camera.width}x{camera.height}"
        )
    if not (0 <= camera.cx <= camera.width and 0 <= camera.cy <= camera.height):
        out.append(
            f"the principal point {camera.cx:g}, {camera.cy:g} lies outside the picture: is"
            " it a crop?"
        )
    if (seen := _visible_fraction(camera)) < _USUAL_VISIBLE:
        out.append(f"the distortion holds for {seen:.0%} of the picture only")
    return [f"camera calibration {camera.source}: {text}" for text in out]


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


def _visible_fraction(camera: Camera) -> float:
    """Share of the picture's pixels that have a viewing direction."""
    x, y = np.meshgrid(
        np.linspace(0, camera.width - 1, 17), np.linspace(0, camera.height - 1, 17)
    )
    with np.errstate(all="ignore"):
        return float(np.isfinite(camera.normalised(np.stack([x, y], -1))).all(-1).mean())


def _row(values: np.ndarray) -> str:
    return " ".join(f"{v:g}" for v in values)
