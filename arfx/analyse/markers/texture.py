"""Texture of pictures, compared whatever the light: local contrast made even, and points that
are followed from one picture to another and back."""

import cv2
import numpy as np
from numpy import ndarray

_NOISE = 3.0  # grey levels of contrast that are noise


def local_contrast(image: ndarray, window_px: int) -> tuple[ndarray, ndarray]:
    """(h, w) float32 difference to the mean of the neighbourhood, and the standard deviation
    of image (h, w) uint8 in it.

    window_px : side of the neighbourhood"""
    value, window = image.astype(np.float32), (window_px, window_px)
    mean = cv2.blur(value, window)
    variance = cv2.blur(value * value, window) - mean * mean
    return value - mean, np.sqrt(np.maximum(variance, 0))


def even_contrast(image: ndarray, window_px: int = 25) -> ndarray:
    """(h, w) uint8 about 128: contrast against the neighbourhood, over how much of it there is.
    Arguments as of local_contrast."""
    off, spread = local_contrast(image, window_px)
    even = 128.5 + 45 * off / np.hypot(spread, _NOISE)
    return np.clip(even, 0, 255).astype(np.uint8)


def follow(
    first: ndarray,
    second: ndarray,
    points: ndarray,
    halvings: int,
    window_px: int = 15,
    rounds: int = 20,
    least_px: float = 0.005,
) -> tuple[ndarray, ndarray]:
    """Points of one picture in another, by Lucas and Kanade: ((n, 2) px, (n,) px by which the
    way back misses where they came from; inf where they are lost).

    first, second : (h, w) uint8;  points : (n, 2) or (n, 1, 2) px
    halvings : of the pictures, for those that moved far
    rounds, least_px : a point is moved so often at most, while it moves by more"""
    options = {
        "winSize": (window_px, window_px),
        "maxLevel": halvings,
        "criteria": (3, rounds, least_px),
    }
    start = points.astype(np.float32)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **options)  # type: ignore[call-overload]
    back, seen_back, _ = cv2.calcOpticalFlowPyrLK(
        second, first, there, None, **options
    )  # type: ignore[call-overload]
    away = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    return there, np.where((seen > 0).ravel() & (seen_back > 0).ravel(), away, np.inf)
