"""How far a picture is from its reference, in units that an eye knows, over the pixels that an effect touches."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.measure.flip import flip_where

TOUCHED = 0.5  # grey levels: less than this is not a change


@dataclass(frozen=True)
class Difference:
    """mean, p99 : grey levels, of the largest channel of each pixel;  flip : mean;  worst_px : (x, y) in the picture
    pixels : how many it was taken over"""

    mean: float
    p99: float
    flip: float
    worst_px: tuple[int, int]
    pixels: int


def levels_apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(h, w) grey levels between two (h, w, 3) uint8 pictures: the largest of the channels."""
    return np.asarray(np.abs(a.astype(np.int16) - b.astype(np.int16)).max(-1), np.float32)


def touched(*pairs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(h, w) bool: pixels in which any of the pairs differs."""
    return np.asarray(np.any([levels_apart(a, b) > TOUCHED for a, b in pairs], axis=0))


def difference(reference: np.ndarray, test: np.ndarray, where: np.ndarray) -> Difference:
    """where : (h, w) bool, the pixels that count; with none of them everything is 0."""
    if not where.any():
        return Difference(0.0, 0.0, 0.0, (0, 0), 0)
    apart = levels_apart(reference, test)
    values = apart[where]
    y, x = np.unravel_index(int(np.argmax(np.where(where, apart, -1))), apart.shape)
    flip = float(flip_where(reference, test, where).mean()) if values.any() else 0.0
    return Difference(float(values.mean()), float(np.percentile(values, 99)), flip, (int(x), int(y)), int(where.sum()))


def unrest(first: np.ndarray, second: np.ndarray, plate_first: np.ndarray, plate_second: np.ndarray, where: np.ndarray) -> float:
    """Mean grey levels by which the second picture, taken back along the footage's motion, differs from the first.

    The motion is that of the plates (DIS optical flow, OpenCV). All (h, w, 3) uint8 of one place. A steady effect changes no
    more than its reference does; 0 for an empty `where`.
    """
    if not where.any() or min(where.shape) < 16:
        return 0.0
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    a, b = (cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in (plate_first, plate_second))
    motion = np.asarray(flow.calc(a, b, None))  # type: ignore[call-overload]
    y, x = np.indices(a.shape, np.float32)
    back = cv2.remap(second, x + motion[..., 0], y + motion[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return float(levels_apart(first, back)[where].mean())
