"""What is not known of a picture, from what is known around it."""

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.numerics import EPS_WEIGHT


def fill_unknown(values: ndarray, known: ndarray) -> ndarray:
    """Values where they are known, elsewhere the mean of known ones, as near as there are any.

    values : (h, w, c) float32, 1 to 4 channels;  known : (h, w) bool

    Returns (h, w, c) float32; 0 where nothing is known at all.
    Source: push-pull interpolation (Gortler et al. 1996) on halved pictures."""
    mask, size = known.view(np.uint8), known.shape[::-1]
    alone = cv2.copyTo(values, mask, np.zeros_like(values))
    sums, weight = _halved(alone), _halved(known.astype(np.float32))
    around = cv2.resize(_filled(sums, weight), size, interpolation=cv2.INTER_LINEAR)
    return cv2.copyTo(values, mask, around).reshape(values.shape)


def _filled(sums: ndarray, weight: ndarray) -> ndarray:
    """Means of cells, and where less than a quarter of a cell is known, of those around.

    sums : (h, w, c) means of values, 0 where unknown;  weight : (h, w) how much of a cell is
        known"""
    channels = 1 if sums.ndim == 2 else sums.shape[2]
    weights = cv2.merge([weight] * channels)
    means = sums / np.maximum(weights, EPS_WEIGHT)
    if max(weight.shape) <= 1 or weight.min() >= 0.25:
        return means
    size = weight.shape[::-1]
    coarse = _filled(_halved(sums), _halved(weight))
    around = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    return around + (means - around) * np.minimum(4 * weights, np.float32(1))


def _halved(a: ndarray) -> ndarray:
    size = (a.shape[1] + 1) // 2, (a.shape[0] + 1) // 2
    return cv2.resize(a, size, interpolation=cv2.INTER_AREA)
