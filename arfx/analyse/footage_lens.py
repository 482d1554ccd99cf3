"""The lens that a clip was filmed with, from the blur of its markers' sides against their distance (core/lens_fit.py).

Sides that move across themselves count less, and not at all if they move far: motion blurs them too. A focus that is
pulled is refused: both halves of the clip have to tell the same lens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from arfx.analyse.edge_blur import FRACTIONS, EdgeBlur
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.lens_fit import LensFit, lens_from_blur
from arfx.core.marker import MarkerSpec
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose

KEY = "footage_lens"  # in FrameFacts.extra: the fields of LensFit
MOST_MOTION_PX = 3.0  # across a side from frame to frame
_SIGMA_PX, _SIGMA_SHARE = 0.06, 0.04  # of a measured blur: noise, and what is not a disc


def footage_lens(
    facts: Sequence[FrameFacts], edges: EdgeBlur, markers: Sequence[MarkerSpec], world_from_marker: Mapping[str, Pose]
) -> LensFit:
    frame, dioptre, blur, moved = _samples(facts, edges, markers, world_from_marker)
    # a shutter that is open for up to all of the time adds up to moved^2 / 12 to the variance
    sigma = _SIGMA_PX + _SIGMA_SHARE * blur + divide(moved**2, 24 * blur)
    fit = lens_from_blur(dioptre, blur, sigma)
    if not fit.known:
        return fit
    middle = np.median(frame)
    halves = [lens_from_blur(dioptre[half], blur[half], sigma[half]) for half in (frame < middle, frame >= middle)]
    if all(h.known for h in halves):
        a, b = halves
        apart = abs(a.focus - b.focus)
        if apart > 1.5 * float(np.hypot(a.focus_ci95, b.focus_ci95)) + 0.05 * fit.focus:
            words = f"the focus moves: {a.focus:.3g} and {b.focus:.3g} dioptres in the two halves of the clip"
            return replace(fit, known=False, reason=words)
    return fit


def with_lens(facts: Sequence[FrameFacts], fit: LensFit) -> tuple[FrameFacts, ...]:
    told = to_json(fit)
    return tuple(f.with_(extra={**f.extra, KEY: told}) for f in facts)


def to_json(fit: LensFit) -> dict[str, Any]:
    """JSON has no infinity: intervals that are not known become null."""
    return {k: v if not isinstance(v, float) or np.isfinite(v) else None for k, v in asdict(fit).items()}


def _samples(
    facts: Sequence[FrameFacts], edges: EdgeBlur, markers: Sequence[MarkerSpec], world_from_marker: Mapping[str, Pose]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(n,) frame number, dioptre, blur px and motion px of every side that tells."""
    corners_m = {m.key: m.corners_m for m in markers}
    before: dict[str, tuple[int, np.ndarray]] = {}
    rows = []
    for frame, key, blur, corners in edges.readings:
        last, before[key] = before.get(key), (frame, corners)
        fact = facts[frame]
        if fact.status != MEASURED or fact.camera_from_world is None or key not in world_from_marker:
            continue
        moved = corners - last[1] if last is not None and last[0] == frame - 1 else None
        z = (fact.camera_from_world @ world_from_marker[key]).apply(corners_m[key])[:, 2]
        for side in range(4):
            a, b = side, (side + 1) % 4
            if not np.isfinite(blur[side]) or min(z[a], z[b]) <= 0:
                continue
            along = normalise(corners[b] - corners[a])
            normal = np.array([-along[1], along[0]])
            across = 0.0 if moved is None else float(np.abs(moved[[a, b]] @ normal).max())
            if across <= MOST_MOTION_PX:
                rows.append((frame, float(np.mean(1 / (z[a] + (z[b] - z[a]) * FRACTIONS))), blur[side], across))
    made = np.array(rows, float).reshape(-1, 4)
    return made[:, 0], made[:, 1], made[:, 2], made[:, 3]
