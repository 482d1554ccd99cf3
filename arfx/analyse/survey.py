"""What is in a clip in which no configured marker is found: a sparse look with every family."""

from __future__ import annotations

from collections import Counter

import numpy as np

from arfx.analyse.detect import SURVEY_FAMILIES, MarkerDetector
from arfx.analyse.fold import Fold

_FIRST, _GROWTH = 3, 2  # looks at processed frames 3, 6, 12, 24 ...: few even in a long clip


class Survey(Fold):
    """Counts markers of all families in a few frames."""

    def __init__(self) -> None:
        self.looked = 0
        self.next_frame = _FIRST
        self.counts: Counter[str] = Counter()

    def step(self, frame: int, luma: np.ndarray) -> None:
        if frame != self.next_frame:
            return
        self.next_frame *= _GROWTH
        self.look(luma)

    def look(self, luma: np.ndarray) -> None:
        self.looked += 1
        # 14 px: smaller squares of weak dictionaries are found in any texture
        found = MarkerDetector(SURVEY_FAMILIES, min_side_px=14.0, inverted=False).search(luma)
        self.counts.update({c.key for c in found})

    def text(self) -> str:
        """ "4X4_1000:7 (2 of 3 sampled frames), ..." likeliest first, or an empty string."""
        return ", ".join(f"{k} ({self.counts[k]} of {self.looked} sampled frames)" for k in self.likeliest()[:6])

    def likeliest(self) -> list[str]:
        """Keys seen: most often first; among equals the families that are hardest to misread first."""

        def rank(key: str) -> tuple[int, int, str]:
            return -self.counts[key], SURVEY_FAMILIES.index(key.rsplit(":", 1)[0]), key

        return sorted(self.counts, key=rank)
