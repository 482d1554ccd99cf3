"""What markers of all families are in a clip in which the configured ones are not seen: for
the message that says so.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from arfx.analyse.fold import Stateful
from arfx.analyse.markers.detect import SCANNED_FAMILIES, MarkerDetector
from arfx.analyse.markers.legible import legible

LOOKS = (
    0,
    1,
    2,
    *(6 << k for k in range(9)),
)  # the numbers of the frames searched: all of a photo, few of a long clip
MIN_SIDE_PX = 14.0  # smaller squares of weak dictionaries are found in any texture


class DictionaryScan(Stateful):
    """Counts plain markers of all families in a few frames."""

    def __init__(self) -> None:
        self.looked = 0
        self.counts: Counter[str] = Counter()

    def step(self, frame: int, luma: np.ndarray) -> None:
        if frame not in LOOKS:
            return
        self.looked += 1
        seen = MarkerDetector(SCANNED_FAMILIES, MIN_SIDE_PX, inverted=False).search(luma)
        self.counts.update({c.key for c in seen if legible(luma, c)[1]})

    def join(self, later: DictionaryScan) -> None:
        self.looked += later.looked
        self.counts.update(later.counts)

    def text(self) -> str:
        """ "4X4_1000:7 (2 of 3 sampled frames), ..." likeliest first, or an empty string."""
        return ", ".join(
            f"{k} ({self.counts[k]} of {self.looked} sampled frames)"
            for k in self.likeliest()[:6]
        )

    def likeliest(self) -> list[str]:
        """Keys seen: most often seen first; among equals the families that are hardest to
        misread first.
        """
        return sorted(
            self.counts,
            key=lambda k: (-self.counts[k], SCANNED_FAMILIES.index(k.rsplit(":", 1)[0]), k),
        )
