"""From a video: sharp frames, and of the views in them the varied ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import cv2
import numpy as np

from arfx.calibrate.corners import View

BLUR_SHARE = 0.7  # views with less than this share of the median corner sharpness are left out: blur moves corners


def picture_sharpness(gray: np.ndarray) -> float:
    """Variance of the Laplacian of the picture at about 640 px width; only comparable between frames of one clip."""
    factor = max(1, round(gray.shape[1] / 640))
    small = (
        gray[::factor, ::factor]
        if factor == 1
        else cv2.resize(gray, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    )
    return float(cv2.Laplacian(small, cv2.CV_32F).var())


def sharpest_of_each(frames: Iterable[tuple[str, np.ndarray]], group: int) -> Iterator[tuple[str, np.ndarray]]:
    """Of every `group` frames (name, gray) in a row the sharpest, so that 1 in `group` is searched for the board."""
    best: tuple[str, np.ndarray] | None = None
    best_score, count = -1.0, 0
    for name, gray in frames:
        score = picture_sharpness(gray) if group > 1 else 0.0
        if score > best_score:
            best, best_score = (name, gray), score
        count += 1
        if count == group and best is not None:
            yield best
            best, best_score, count = None, -1.0, 0
    if best is not None:
        yield best


def varied(views: Sequence[View], keep: int) -> list[View]:
    """At most `keep` sharp views that differ most in place, size and tilt, in their order (farthest point selection)."""
    if len(views) <= keep:
        return list(views)
    usual = float(np.median([v.sharpness for v in views]))
    sharp = [v for v in views if v.sharpness >= BLUR_SHARE * usual]
    if len(sharp) <= keep:
        return sharp
    features = np.array([_features(v) for v in sharp])
    chosen = [int(np.argmax([v.sharpness * len(v.ids) for v in sharp]))]
    nearest = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < keep:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return [sharp[i] for i in sorted(chosen)]


def _features(view: View) -> np.ndarray:
    """Place (2), size, and foreshortening (2) of a board, each about 1 over its range.

    Foreshortening: the perspective terms of the homography times the board's size; 0 facing the camera.
    """
    xy = view.board_m[:, :2] - view.board_m[:, :2].mean(0)
    extent = float(np.ptp(xy, axis=0).max())
    h, _ = cv2.findHomography(xy / extent, view.pixels)
    lean = h[2, :2] if h is not None else np.zeros(2)
    width = view.size[0]
    middle = view.pixels.mean(0) / width
    # turned to the picture's axes, so that a board lying on its side with the same tilt is the same view
    turn = float(np.arctan2(h[1, 0], h[0, 0])) if h is not None else 0.0
    c, s = np.cos(turn), np.sin(turn)
    return np.array([*middle, float(np.ptp(view.pixels, axis=0).max()) / width, *(3 * np.array([[c, -s], [s, c]]) @ lean)])
