"""The level draft paints at half the size: the picture and sites there, and lines back from there.

A pixel of it stands for 2 x 2 of the picture, whose last row and column count twice where they are odd. Cost: O(pixels)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from arfx.core.rect import Rect
from arfx.stages.watercolor.sites import STEPS, Sites


def half_rect(rect: Rect) -> Rect:
    """Its pixels, counted from its own corner."""
    return Rect.of((rect.width + 1) // 2, (rect.height + 1) // 2)


def halve_sites(sites: Sites, rect: Rect) -> Sites:
    """In 1/STEPS of the pixels of `half_rect`."""
    x, y = (
        np.rint((a - STEPS * first - STEPS // 2) / 2).astype(np.float32)  # a pixel lies in the middle of 2 x 2
        for a, first in ((sites.x, rect.x0), (sites.y, rect.y0))
    )
    return replace(sites, x=x, y=y, weight=np.rint(sites.weight / 4).astype(np.float32))


def double_lines(line: np.ndarray, height: int, width: int) -> np.ndarray:
    """(height, width) of lines on a grid that is twice as coarse."""
    if not line.size:
        return line
    h, w = line.shape
    return np.ascontiguousarray(cv2.resize(line, (2 * w, 2 * h), interpolation=cv2.INTER_LINEAR)[:height, :width])
