"""FLIP: how visible a difference is to someone who flips between two pictures, 0 (none) to 1.

Source: Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020 (LDR form); library flip-evaluator.
Cost: about 1.5 us of one core per pixel, so `flip_where` looks at the wanted pixels and their surroundings only.
"""

from __future__ import annotations

import numpy as np

from arfx.core.rect import Rect
from arfx.errors import InputError

PIXELS_PER_DEGREE = 67.02  # a 0.7 m wide display of 3840 pixels seen from 0.7 m, the published standard
# Widest of the filters at that distance: contrast sensitivity of blue-yellow, 3 sqrt(b / 2 pi^2) ppd = 9.05 px, rounded up.
REACH_PX = 10


def flip_map(reference: np.ndarray, test: np.ndarray, pixels_per_degree: float = PIXELS_PER_DEGREE) -> np.ndarray:
    """FLIP of every pixel.

    reference, test : (h, w, 3) sRGB, uint8 or float in 0..1 (clipped to it)

    Returns (h, w) float32 in 0..1. Raises InputError for pictures of unlike shape, none, or with values that are not finite.
    """
    from flip_evaluator import nbflip

    if reference.shape != test.shape or reference.ndim != 3 or reference.shape[2] != 3 or 0 in reference.shape:
        raise InputError(f"FLIP compares two (h, w, 3) pictures of one size, not {reference.shape} and {test.shape}")
    settings = {"ppd": float(pixels_per_degree)}
    error = nbflip.evaluate(_srgb(reference), _srgb(test), False, True, False, False, settings)[0]
    return np.ascontiguousarray(error[..., 0], np.float32)


def flip_where(reference: np.ndarray, test: np.ndarray, where: np.ndarray) -> np.ndarray:
    """FLIP of the pixels in a mask: the same numbers as from the whole picture, for the price of the mask's box.

    where : (h, w) bool

    Returns (n,) float32, the mask's pixels row by row; empty for an empty mask.
    """
    if not where.any():
        return np.zeros(0, np.float32)
    ys, xs = np.nonzero(where.any(1))[0], np.nonzero(where.any(0))[0]
    box = Rect(int(xs[0]), int(ys[0]), int(xs[-1]) + 1, int(ys[-1]) + 1)
    seen = box.pad(REACH_PX).clip(Rect(0, 0, where.shape[1], where.shape[0]))
    error: np.ndarray = flip_map(reference[seen.slices], test[seen.slices])[where[seen.slices]]
    return error


def _srgb(picture: np.ndarray) -> np.ndarray:
    values = picture.astype(np.float32) / np.float32(255) if picture.dtype == np.uint8 else picture.astype(np.float32)
    if not np.isfinite(values).all():
        raise InputError("FLIP was given a picture with values that are not finite")
    return np.ascontiguousarray(np.clip(values, 0, 1))
