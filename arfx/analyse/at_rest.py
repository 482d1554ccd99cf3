"""Whether a camera stands still over a clip: corners of the first picture, looked for again in later ones.

Cost: about 2 ms each time. Things that move before a camera at rest take some corners with them; most stay.
"""

from __future__ import annotations

import cv2
import numpy as np

from arfx.analyse.fold import Fold

WIDTH_PX = 480  # of the reduced pictures
INTERVAL_S = 0.33
POINTS = 80
STILL_PX = 0.7  # in a reduced picture: sensor noise and compression move corners by a tenth
SHARE = 0.6  # of the corners that have to stay
_LEAST_POINTS = 8
_WINDOW_PX, _NOISE = 15, 5.0  # neighbourhood of a corner, and grey levels of contrast in it that noise alone makes


class RestCheck(Fold):
    """Fed the frames in order. moved_px : the farthest that the middle corner was seen from its place, clip px"""

    def __init__(self) -> None:
        self._first: np.ndarray | None = None
        self._points = np.zeros((0, 2), np.float32)
        self._next_s = -np.inf
        self._rests = True
        self.moved_px = 0.0

    @property
    def rests(self) -> bool:
        return self._rests

    def step(self, time_s: float, luma: np.ndarray) -> None:
        """luma : (h, w) uint8"""
        if time_s < self._next_s and self._first is not None and self._rests:
            return
        self._next_s = time_s + INTERVAL_S
        factor = max(1, round(luma.shape[1] / WIDTH_PX))
        small = cv2.resize(luma, (luma.shape[1] // factor, luma.shape[0] // factor), interpolation=cv2.INTER_AREA)
        if self._first is None:
            value = small.astype(np.float32)
            off = value - cv2.blur(value, (_WINDOW_PX, _WINDOW_PX))
            contrast = cv2.blur(off * off, (_WINDOW_PX, _WINDOW_PX)) > _NOISE**2
            found = cv2.goodFeaturesToTrack(small, POINTS, 0.02, 8, mask=contrast.astype(np.uint8))
            self._first = small
            self._points = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2).astype(np.float32)
            return
        if len(self._points) < _LEAST_POINTS:  # nothing to see: nothing that could tell of a motion
            return
        there, good, _ = cv2.calcOpticalFlowPyrLK(self._first, small, self._points, None)  # type: ignore[call-overload]
        away = np.linalg.norm(there - self._points, axis=1)
        away = np.where(good.ravel() > 0, away, np.inf)  # a corner that is lost may have left the picture
        seen = away[np.isfinite(away)]
        self.moved_px = max(self.moved_px, factor * float(np.median(seen)) if len(seen) else 0.0)
        if (away < STILL_PX).mean() < SHARE:
            self._rests = False
