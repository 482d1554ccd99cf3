"""What markers of all families are in a clip in which the configured ones are not seen: for
the message that says so.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from arfx.analyse.markers.detect import SCANNED_FAMILIES, MarkerDetector
from arfx.analyse.markers.legible import legible

# Numbers of the frames that are searched: all of a photo, few of a long clip.
SCANS = (0, 1, 2, *(6 << k for k in range(9)))
MIN_SIDE_PX = 14.0  # smaller squares of weak dictionaries are found in any texture


def scan(luma: np.ndarray) -> set[str]:
    """Keys of the plain markers of all families in a picture (h, w) uint8."""
    seen = MarkerDetector(SCANNED_FAMILIES, MIN_SIDE_PX, inverted=False).search(luma)
    return {c.key for c in seen if legible(luma, c)[1]}


def likeliest(counts: Mapping[str, int]) -> list[str]:
    """Keys seen, and how often: most often seen first; among equals the families that are
    hardest to misread first.
    """
    return sorted(
        counts,
        key=lambda k: (-counts[k], SCANNED_FAMILIES.index(k.rsplit(":", 1)[0]), k),
    )
