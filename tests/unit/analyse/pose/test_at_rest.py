"""A camera at rest is told from one that moves, whatever moves before it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.pose.at_rest import RestCheck, rests

GROUND = cv2.resize(
    np.random.default_rng(0).integers(40, 210, (70, 100)).astype(np.uint8),
    (800, 560),
    interpolation=cv2.INTER_CUBIC,
)


def told(frames: list[np.ndarray]) -> tuple[bool, float]:
    check, rng = RestCheck(len(frames)), np.random.default_rng(1)
    for k, f in enumerate(frames):
        noisy = np.clip(f + rng.normal(0, 2, f.shape), 0, 255).astype(np.uint8)
        check.step(AnalysisFrame(k, 0.4 * k, noisy))
    return rests(check.rows)


def test_noise_and_what_moves_are_no_motion_of_the_camera() -> None:
    view = GROUND[40:520, 60:700]
    moving = []
    for k in range(4):
        f = view.copy()
        f[100:300, 60 * k : 60 * k + 150] = 128
        moving.append(f)
    assert told([view] * 4)[0] and told(moving)[0]
    assert told([np.full((480, 640), 90, np.uint8)] * 3)[0]  # nothing to see


@pytest.mark.parametrize("step_px", [2, 7])
def test_a_slow_pan_is_found(step_px: int) -> None:
    still, moved_px = told(
        [GROUND[40:520, 60 + step_px * k : 700 + step_px * k] for k in range(6)]
    )
    assert not still and moved_px > 1
