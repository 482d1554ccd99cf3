"""Camera calibration files: reads what other tools write, writes a file that OpenCV, ROS
and people can read.

Read: OpenCV YAML/XML/JSON, NumPy .npz, ROS camera_info YAML, COLMAP cameras.txt and .bin,
Kalibr camchain YAML, WPILib and
PhotonVision JSON; by hand fx, fy, cx, cy, width, height; each also packed by gzip.
Pixel centres: all of these put them at integers, except COLMAP, whose centres lie at .5
(corrected here). Left out: lens models that OpenCV's polynomials cannot express
(field-of-view, omnidirectional, division)."""

import contextlib
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy import ndarray

from arfx.core.camera import BROWN, FISHEYE, Camera
from arfx.core.guard import atomic_write
from arfx.errors import InputError
from arfx.media.camera_documents import (
    SUPPORTED,
    TABLES,
    CameraFileError,
    Document,
    number,
    numbers,
    read_document,
)

_NAMES, _LENSES = TABLES["names"], TABLES["lenses"]
_SHAPE = "fx 0 cx / 0 fy cy / 0 0 1, row by row"


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
    try:
        document = read_document(file)
        cameras = {
            str(name): entry
            for name, entry in document.items()
            if isinstance(entry, Mapping) and "intrinsics" in entry
        }
        if cameras and chosen not in ("", *cameras):
            what = f"no camera {chosen!r}"
            raise CameraFileError(what, f"it holds {', '.join(cameras)}")
        if not chosen and len(cameras) > 1:
            what = f"it holds {len(cameras)} cameras: {', '.join(cameras)}"
            raise CameraFileError(what, f"choose one: {path}#{next(iter(cameras))}")
        document = cameras.get(chosen or next(iter(cameras), ""), document)
        camera = _from_names(document, str(path))
        _check(camera)
    except CameraFileError as e:
        raise InputError(
            f"camera file {path}: {e.message}", e.hint or f"supported: {SUPPORTED}"
        ) from None
    return camera


def _from_names(document: Document, where: str) -> Camera:
    """The same things under different names. Raises CameraFileError, InputError."""
    flat = _flat(document)
    words = [_first(flat, _NAMES["model"])]
    if "intrinsics" in flat:  # Kalibr names projection and distortion
        words.append(flat.get("cameramodel"))
    models = {str(word).lower() for word in words if word}
    if unknown := models.difference(*_LENSES.values()):
        what = f"lens model {' '.join(unknown)!r} is not supported"
        raise CameraFileError(what, "plumb_bob, rational_polynomial, equidistant")
    # OpenCV's calibration sample marks a fisheye calibration with `fisheye_model: 1`
    fisheye = (
        models.intersection(_LENSES["fisheye"])
        or str(flat.get("fisheyemodel", 0)) == "1"
    )
    matrix = numbers(_first(flat, _NAMES["matrix"]), "the camera matrix")
    single = flat.get("intrinsics")
    if {"fx", "fy"} <= flat.keys():
        cx, cy = ((side - 1) / 2 for side in _size(flat))
        single = [flat["fx"], flat["fy"], flat.get("cx", cx), flat.get("cy", cy)]
    if not matrix.size and single is not None:
        four = numbers(single, "the list fx, fy, cx, cy")
        if four.size != 4:
            raise CameraFileError(
                "pinhole intrinsics are 4 numbers", "fx, fy, cx, cy"
            )
        matrix = np.append(four, [0, 1])[[0, 4, 2, 4, 1, 3, 4, 4, 5]]
    if not matrix.size:
        keys = ", ".join(map(str, list(document)[:8])) or "nothing"
        raise CameraFileError(f"it holds no camera matrix (its keys: {keys})")
    if matrix.size != 9:
        raise CameraFileError(
            f"the camera matrix has {matrix.size} numbers", "9, row by row"
        )
    lens = numbers(_first(flat, _NAMES["distortion"]), "the distortion coefficients")
    if fisheye and not lens[4:].any():
        lens = lens[:4]
    if 0 < lens.size < 4:  # "k1" or "k1, k2": the rest is zero
        lens = np.append(lens, np.zeros(4))[:4]
    return Camera(
        *_size(flat), matrix.reshape(3, 3), lens, FISHEYE if fisheye else BROWN, where
    )


def _size(flat: Document) -> tuple[int, int]:
    stated = _first(flat, _NAMES["size"])
    if isinstance(stated, Mapping):
        stated = [stated.get("width"), stated.get("height")]
    if not isinstance(stated, list) or len(stated) != 2:
        stated = [_first(flat, names) for names in _NAMES["sides"]]
    if None in stated:
        hint = (
            'add "image_width": 1920, "image_height": 1080; in YAML without quotation'
            " marks, np.savez(…, image_width=1920, image_height=1080)"
        )
        raise CameraFileError(
            "it does not state the picture size that it was made for", hint
        )
    sides = numbers(stated, "the picture size")
    if [side.is_integer() for side in sides] != [True, True]:
        what = "picture size {} x {}".format(*stated)
        raise CameraFileError(what, "two whole numbers of pixels")
    return int(sides[0]), int(sides[1])


def _flat(document: Document) -> dict[str, Any]:
    return {str(k).lower().replace("_", ""): v for k, v in document.items()}


def _first(flat: Document, names: Sequence[str]) -> Any:
    return next((flat[n] for n in names if flat.get(n) is not None), None)


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
    d, lens = camera.distortion, "equidistant" if fisheye else "rational_polynomial"
    if not fisheye and d.size <= 5:  # ROS's plumb_bob has five
        d, lens = np.append(d, np.zeros(5))[:5], "plumb_bob"
    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": _stored_matrix(camera.matrix),
        "distortion_model": lens,
        "distortion_coefficients": _stored_matrix(d[None]),
        "rectification_matrix": _stored_matrix(np.eye(3)),
        "projection_matrix": _stored_matrix(
            np.hstack([camera.matrix, np.zeros((3, 1))])
        ),
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


def _stored_matrix(m: ndarray) -> dict[str, Any]:
    return {
        "rows": m.shape[0],
        "cols": m.shape[1],
        "dt": "d",
        "data": m.ravel().tolist(),
    }


def _check(camera: Camera) -> None:
    """Raises CameraFileError: a matrix of another shape, numbers that no camera has."""
    m = camera.matrix
    form = np.array([[m[0, 0], 0, m[0, 2]], [0, m[1, 1], m[1, 2]], [0, 0, 1]])
    off = np.abs(m - form) > 1e-6 * np.array([[camera.fx], [camera.fy], [1]])
    for name, row, wrong in zip(("first", "second", "last"), m, off, strict=True):
        if wrong.any():
            numbers = " ".join(f"{v:g}" for v in row)
            hint = f"{_SHAPE}, not the transposed, and without skew"
            raise CameraFileError(
                f"the camera matrix's {name} row is {numbers}", hint
            )
    for what, hint in _outside(camera, "may", "what", "hint"):
        raise CameraFileError(what, hint)


def camera_warnings(camera: Camera, claims: Document) -> list[str]:
    """Notices of what is unusual and may be meant, and of what a calibration admits of itself.

    claims : as of `calibration_claims`"""
    doubts = dict.fromkeys(text for (text,) in _outside(camera, "usual", "doubt"))
    if claims.get("verdict") == "poor":
        why = "".join(f" ({str(r)[:200]})" for r in claims.get("reasons", ())[:1])
        text = f"its own verdict is poor{why}: sizes and perspective may be off"
        doubts[f"{text}; better calibrate again"] = None
    return [f"camera calibration {camera.source}: {text}" for text in doubts]


def _outside(camera: Camera, bounds: str, *texts: str) -> list[list[str]]:
    """Texts of those rules of the table whose bounds ("may" or "usual") a camera is outside of."""
    size = np.array([camera.width, camera.height])
    grid = np.meshgrid(*(np.linspace(0, n - 1, 17) for n in size))
    with np.errstate(all="ignore"):
        seen = np.isfinite(camera.normalised(np.stack(grid, -1))).all(-1).mean()
    fx, fy, side = camera.fx, camera.fy, size.max()
    cx, cy = camera.matrix[:2, 2] / size
    shares = (side, fx / side, fy / side, fx / fy, cx, cy, seen)
    return [
        [rule[text].format(c=camera, side=side, seen=seen) for text in texts]
        for rule, share in zip(TABLES["rules"], shares, strict=True)
        if not rule[bounds][0] <= share <= rule[bounds][1]
    ]


def calibration_claims(path: str | Path) -> dict[str, Any]:
    """What `arfx calibrate` wrote of itself into a camera file: verdict, reasons,
    condition; {} for files of others.
    """
    try:
        flat = _flat(read_document(Path(path)))
    except InputError:  # one camera of a file that holds several
        return {}
    out = {
        key: flat[key]
        for key, kind in {"verdict": str, "reasons": list}.items()
        if isinstance(flat.get(key), kind)
    }
    with contextlib.suppress(TypeError, ValueError):
        if math.isfinite(condition := number(flat.get("condition"))):
            out["condition"] = condition
    return out
