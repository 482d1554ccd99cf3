"""A few frames before and after, kept in the job folder for the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.media.frame import Frame

COUNT, WIDEST_PX = 8, 960


def pick(facts: Sequence[FrameFacts], count: int = COUNT) -> list[int]:
    """Frames spread evenly over those that show the object; over all where none does."""
    shown = [f.index for f in facts if f.visible] or [f.index for f in facts]
    at = np.unique(np.linspace(0, len(shown) - 1, min(count, len(shown))).round().astype(int))
    return [shown[i] for i in at]


def save_preview(folder: Path, index: int, before: Frame, after: Frame) -> None:
    import cv2

    for frame, kind in ((before, "in"), (after, "out")):
        rgb = frame.rgb8()
        if rgb.shape[1] > WIDEST_PX:
            size = (WIDEST_PX, max(round(rgb.shape[0] * WIDEST_PX / rgb.shape[1]), 1))
            rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
        # as it is: a PNG would take as long as a frame's rendering, for a file that lives as long as the job folder
        cv2.imwrite(str(folder / f"{index:06d}.{kind}.bmp"), rgb[..., ::-1])


def load_previews(folder: Path) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(frame number, before, after), RGB uint8, in order."""
    import cv2

    out = []
    for path in sorted(folder.glob("*.in.bmp")):
        after = path.with_name(path.name.replace(".in.", ".out."))
        if after.exists():
            pair = [cv2.imread(str(p)) for p in (path, after)]
            if pair[0] is not None and pair[1] is not None:
                out.append((int(path.name.split(".")[0]), pair[0][..., ::-1], pair[1][..., ::-1]))
    return out
