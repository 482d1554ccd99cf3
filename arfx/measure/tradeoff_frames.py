"""Frames that stand for a clip: apart from each other in how large, how far, how bright and
how blurred the object is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect

NAMES = ("share of the picture", "distance, m", "light", "blur, px")
# what is unusual, by NAMES
SIDES = (
    ("small", "large"),
    ("near", "far"),
    ("dark", "bright"),
    ("sharp", "blurred"),
)


@dataclass(frozen=True)
class Sample:
    """index : frame;  facts : what it stands for, by NAMES;  words : the same for people"""

    index: int
    facts: dict[str, float]
    words: str


def describe(
    facts: Sequence[FrameFacts], frame: Rect
) -> tuple[list[FrameFacts], ndarray]:
    """The frames that show the object, and (n, 4) what is known of each: NAMES."""
    shown = [f for f in facts if f.visible and f.camera_from_world is not None]
    blurs = [f.blur_px for f in shown if f.blur_px is not None]
    usual = float(np.median(blurs or 0.0))  # of frames whose blur is not known
    rows = []
    for f in shown:
        lights = (
            []
            if f.light is None
            else [f.light.ambient_rgb, *(li.rgb for li in f.light.lights)]
        )
        light = float(sum(np.mean(rgb) for rgb in lights)) if lights else 1.0
        share = f.model_box.clip(frame).area / frame.area
        blur = usual if f.blur_px is None else f.blur_px
        rows.append((share, sum(f.depth_range_m) / 2, light, blur))
    return shown, np.array(rows, float).reshape(-1, len(NAMES))


def pick_frames(facts: Sequence[FrameFacts], frame: Rect, count: int) -> list[Sample]:
    """The frame nearest to the middle of all, then again and again the one that is least
    like those taken (k-centre).

    Empty where no frame shows the object. Logarithms, in units of the clip's own spread: 3
    % of change at least."""
    shown, rows = describe(facts, frame)
    if not shown:
        return []
    logs = np.log(np.maximum(rows, 1e-4))
    logs[:, 3] = np.log1p(rows[:, 3])
    logs = (logs - np.median(logs, axis=0)) / np.maximum(logs.std(axis=0), 0.03)
    taken = [int(np.argmin((logs**2).sum(1)))]
    while len(taken) < min(count, len(shown)):
        away = np.min([((logs - logs[k]) ** 2).sum(1) for k in taken], axis=0)
        if away.max() <= 0:
            break
        taken.append(int(np.argmax(away)))
    out = []
    for k in taken:
        pairs = zip(SIDES, logs[k], strict=True)
        unusual = [pair[int(off > 0)] for pair, off in pairs if abs(off) > 1]
        words = "typical" if k == taken[0] else ", ".join(unusual) or "another view"
        known = dict(zip(NAMES, rows[k].tolist(), strict=True))
        out.append(Sample(shown[k].index, known, words))
    return sorted(out, key=lambda s: s.index)
