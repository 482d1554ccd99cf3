"""Whether a calibration can be a camera's: what is surely wrong is refused, what is odd is told."""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera
from arfx.errors import InputError

_SHAPE = "fx 0 cx / 0 fy cy / 0 0 1, row by row"
_LARGEST_PX = 65536
_FOCAL = (0.02, 2000.0)  # focal length as a share of the longer side: 175 degrees of view, a hundredth of a degree
_USUAL_FOCAL = (0.15, 100.0)
_ASPECT, _USUAL_ASPECT = 10.0, 1.5  # of the pixels: anamorphic video reaches 2
_CENTRE = 5.0  # picture sides by which a crop of a picture may lie off its principal point
_COEFFICIENT = 1e6
_SEEN, _LEAST_SEEN = 0.5, 0.05  # share of the picture with a viewing direction: a full circle of a fisheye lens has 0.55


def wrong(where: str, what: str, hint: str) -> InputError:
    return InputError(f"camera file {where}: {what}", hint)


def check_matrix(m: np.ndarray, where: str) -> None:
    """m : (3, 3). Raises InputError where its zeros and ones are not in their places; values are not looked at."""
    if not np.isfinite(m).all():
        return  # Camera says so
    size = max(abs(m[0, 0]), abs(m[1, 1]), 1e-300)
    last = m[2]
    if abs(last[2] - 1) > 1e-6 or np.abs(last[:2]).max() > 1e-6:
        if np.abs(m[:2, 2]).max() <= 1e-6 and abs(last[2] - 1) <= 1e-6:
            raise wrong(where, f"the camera matrix is transposed, its last row is {_row(last)}", f"as rows: {_SHAPE}")
        raise wrong(where, f"the camera matrix's last row is {_row(last)}, not 0 0 1", _SHAPE)
    if abs(m[0, 1]) > 1e-6 * size:
        raise wrong(where, f"the camera matrix has skew {m[0, 1]:g}", "calibrate without skew")
    if abs(m[1, 0]) > 1e-6 * size:
        raise wrong(where, f"the camera matrix holds {m[1, 0]:g} where 0 belongs", _SHAPE)


def check_camera(camera: Camera) -> None:
    """Raises InputError: numbers that no camera has."""
    where, side = camera.source, max(camera.width, camera.height)
    if side > _LARGEST_PX:
        raise wrong(where, f"a picture of {camera.width}x{camera.height}", f"at most {_LARGEST_PX} px a side")
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        if not _FOCAL[0] * side <= focal <= _FOCAL[1] * side:
            raise wrong(
                where,
                f"{name} is {focal:g} px for a picture of {camera.width}x{camera.height}",
                f"a focal length in pixels, {_FOCAL[0] * side:g} to {_FOCAL[1] * side:g} here; often about {side}",
            )
    if not 1 / _ASPECT <= camera.fx / camera.fy <= _ASPECT:
        raise wrong(where, f"fx {camera.fx:g} and fy {camera.fy:g} are far apart", "pixels are nearly square")
    for name, at, length in (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)):
        if not -_CENTRE * length <= at <= (1 + _CENTRE) * length:
            raise wrong(
                where,
                f"the principal point's {name} is {at:g} px, far outside the picture",
                f"near the middle: {length / 2:g}",
            )
    if camera.distortion.size and np.abs(camera.distortion).max() > _COEFFICIENT:
        raise wrong(where, f"a distortion coefficient is {np.abs(camera.distortion).max():g}", "calibrate again")
    if _seen(camera) < _LEAST_SEEN:
        raise wrong(where, "with its distortion almost no pixel has a viewing direction", "calibrate again")


def camera_doubts(camera: Camera) -> list[str]:
    """Notices of what is unusual and may be meant."""
    out, side = [], max(camera.width, camera.height)
    if not 1 / _USUAL_ASPECT <= camera.fx / camera.fy <= _USUAL_ASPECT:
        out.append(f"fx {camera.fx:g} and fy {camera.fy:g} px differ much: are the pixels that oblong?")
    if not all(_USUAL_FOCAL[0] * side <= f <= _USUAL_FOCAL[1] * side for f in (camera.fx, camera.fy)):
        out.append(f"a focal length of {camera.fx:g} px is unusual for {camera.width}x{camera.height}")
    if not (0 <= camera.cx <= camera.width and 0 <= camera.cy <= camera.height):
        out.append(f"the principal point {camera.cx:g}, {camera.cy:g} lies outside the picture: is it a crop?")
    if (seen := _seen(camera)) < _SEEN:
        out.append(f"the distortion holds for {seen:.0%} of the picture only")
    return [f"camera calibration {camera.source}: {text}" for text in out]


def _seen(camera: Camera) -> float:
    """Share of the picture's pixels that have a viewing direction."""
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 17), np.linspace(0, camera.height - 1, 17))
    with np.errstate(all="ignore"):
        return float(np.isfinite(camera.normalised(np.stack([x, y], -1))).all(-1).mean())


def _row(values: np.ndarray) -> str:
    return " ".join(f"{v:g}" for v in values)
