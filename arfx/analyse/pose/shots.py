"""Where a new shot begins: frames that are unlike those before them, while no marker moves on.

Source: docs/methods/pose.md#presence."""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.markers.detect import Record

THUMBNAIL = (32, 18)
# 1 - correlation of thumbnails; hand-held clips stay below .1, unrelated pictures lie
# around 1
DISSIMILAR = 0.45
_STANDS_OUT = 3.0
# of a cut's dissimilarity: on one side of it at least, frames follow each other with less
_CALM = 0.6


def thumbnail(luma: ndarray) -> ndarray:
    """(18, 32) uint8 of luma (h, w) uint8."""
    step = max(
        1,
        min(luma.shape[0] // (4 * THUMBNAIL[1]), luma.shape[1] // (4 * THUMBNAIL[0])),
    )
    thin = np.ascontiguousarray(luma[::step, ::step])
    return cv2.resize(thin, THUMBNAIL, interpolation=cv2.INTER_AREA)


def unlikeness(thumbnails: Sequence[ndarray], apart: int) -> list[float]:
    """Of each frame's thumbnail the dissimilarity to that of the frame so many before it, 0
    where there is none."""
    pairs = zip(thumbnails[apart:], thumbnails, strict=False)
    found = [0.0] * apart + [dissimilarity(a, b) for a, b in pairs]
    return found[: len(thumbnails)]


def dissimilarity(a: ndarray, b: ndarray) -> float:
    """1 - correlation of two pictures of one size, 0 (same up to brightness and contrast) to
    2; flat pictures are compared by their level alone.
    """
    least, most = sorted((float(a.std()), float(b.std())))
    if least < 2.0:  # less contrast than noise: no structure to compare
        same = most < 2.0 and abs(a.mean() - b.mean()) < 20
        return 0.0 if same else float(most > 8.0)
    return 1.0 - float(((a - a.mean()) * (b - b.mean())).mean() / (least * most))


def find_cuts(
    before: Sequence[float], before_last: Sequence[float], followed: Sequence[bool]
) -> list[int]:
    """Frames that begin a new shot.

    before, before_last : `unlikeness` to the frame before, and to the one before that
    followed : a marker moved on smoothly from the frame before
    """
    cuts = []
    n = len(before)
    for k in range(1, n):
        if before[k] < DISSIMILAR or followed[k]:
            continue
        # the next frame is like the last one, a flash or one broken frame; or back from
        # such a frame
        if any(before_last[i] < DISSIMILAR / 2 for i in (k, k + 1) if 2 <= i < n):
            continue
        near, beside = (
            [
                before[i]
                for i in range(max(1, k - reach), min(n, k + reach + 1))
                if i != k
            ]
            for reach in (4, 1)
        )
        if near and before[k] < _STANDS_OUT * float(np.median(near)):
            continue
        if beside and min(beside) > _CALM * before[k]:
            continue  # the midst of a quick move
        cuts.append(k)
    return cuts


def shot_numbers(records: Sequence[Record]) -> ndarray:
    """(n,) number of the shot that each frame belongs to."""
    followed = [False]
    for a, b in pairwise(records):
        known = {s.key: s for s in a.detections}
        # no corner moved by more than a quarter of the side: one marker, one shot
        followed.append(
            any(
                ((s.corners_px - old.corners_px) ** 2).sum(1).max()
                < (0.25 * old.side_px) ** 2
                for s in b.detections
                if (old := known.get(s.key)) is not None
            )
        )
    thumbnails = [r.thumbnail for r in records]
    cuts = find_cuts(unlikeness(thumbnails, 1), unlikeness(thumbnails, 2), followed)
    return np.cumsum(np.isin(np.arange(len(records)), cuts))
