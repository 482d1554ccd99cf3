"""What one step of the analysis leaves behind, and what the whole analysis gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from arfx.core.codec import stored
from arfx.core.facts import FrameFacts
from arfx.core.pose import Pose


@stored
@dataclass(frozen=True)
class Seen:
    """One marker print in one frame. corners_px : (4, 2);  sigma_px : predicted;  blur_px : nan where unknown."""

    key: str
    corners_px: np.ndarray
    sigma_px: float
    blur_px: float
    inverted: bool

    @property
    def side_px(self) -> float:
        return float(np.linalg.norm(self.corners_px - np.roll(self.corners_px, -1, 0), axis=1).mean())


@stored
@dataclass(frozen=True)
class Record:
    """One frame. unlike : CutSignal's two numbers;  rivals : further prints with a key that is in `seen` too."""

    index: int
    time_s: float
    seen: tuple[Seen, ...]
    rivals: tuple[Seen, ...]
    whole: bool
    unlike: tuple[float, float]


@dataclass(frozen=True)
class Analysis:
    """The facts of a clip.

    facts : one per frame;  world_from_marker : by key, of markers that could be placed
    static : "camera", "marker" or "both" (both move), see pose/at_rest.py
    summary : figures for the report, JSON-able;  notices : sentences for the user
    """

    facts: tuple[FrameFacts, ...]
    world_from_marker: dict[str, Pose]
    static: str
    summary: dict[str, Any] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
