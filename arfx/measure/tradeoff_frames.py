"""Frames that stand for a clip: apart from each other in how large, how far, how bright and
how blurred the object is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect

NAMES = ("share of the picture", "distance, m", "light", "motion, px")


@dataclass(frozen=True)
class Sample:
    """index : frame;  facts : what it stands for, by NAMES;  words : the same for people"""

    index: int
    facts: dict[str, float]
    words: str


def describe(
    facts: Sequence[FrameFacts], frame: Rect
) -> tuple[list[FrameFacts], np.ndarray]:
    """The frames that show the object, and (n, 4) what is known of each: NAMES."""
    shown = [f for f in facts if f.visible and f.camera_from_world is not None]
    rows = []
    before: dict[int, np.ndarray] = {}
    for f in facts:
        if f.markers:
            before[f.index] = np.mean([m.corners_px for m in f.markers], axis=(0, 1))
    for f in shown:
        near, far = f.depth_range_m
        light = (
            1.0
            if f.light is None
            else float(
                np.mean(f.light.ambient_rgb) + sum(np.mean(li.rgb) for li in f.light.lights)
            )
        )
        here, last = before.get(f.index), before.get(f.index - 1)
        motion = (
            float(np.linalg.norm(here - last))
            if here is not None and last is not None
            else 0.0
        )
        blur = motion if f.blur_px is None else float(f.blur_px)
        rows.append(
            (f.model_box.clip(frame).area / frame.area, (near + far) / 2, light, blur)
        )
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
    away = ((logs - logs[taken[0]]) ** 2).sum(1)
    while len(taken) < min(count, len(shown)):
        farthest = int(np.argmax(away))
        if away[farthest] <= 0:
            break
        taken.append(farthest)
        away = np.minimum(away, ((logs - logs[farthest]) ** 2).sum(1))
    out = []
    for k, at in enumerate(taken):
        known = dict(zip(NAMES, rows[at].tolist(), strict=True))
        sides = ("small", "large"), ("near", "far"), ("dark", "bright"), ("slow", "fast")
        unusual = [
            pair[int(off > 0)]
            for pair, off in zip(sides, logs[at], strict=True)
            if abs(off) > 1
        ]
        words = "typical" if k == 0 else ", ".join(unusual) or "another view"
        out.append(Sample(shown[at].index, known, words))
    return sorted(out, key=lambda s: s.index)
