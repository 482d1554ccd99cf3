"""Random numbers that belong to a pixel: the same whatever rectangle they are asked for.

A generator that counts (Philox) for each row of the frame. Cost: 10 ns a pixel."""

from __future__ import annotations

import zlib

import numpy as np

from arfx.core.rect import Rect


def noise_key(seed: int, frame: int, stage: str) -> int:
    """Of all that one stage draws in one frame."""
    return zlib.crc32(f"{seed}/{frame}/{stage}".encode())


def noise(rect: Rect, key: int, channel: int = 0) -> np.ndarray:
    """(h, w) float32 in [0, 1), even, independent from pixel to pixel.

    rect : within the frame, whose corner is (0, 0);  key : below 2^32
    """
    rows = [
        np.random.Generator(np.random.Philox(key=key, counter=[0, 0, channel, y])).random(
            rect.x1, np.float32
        )[rect.x0 :]
        for y in range(rect.y0, rect.y1)
    ]
    return np.array(rows).reshape(rect.height, rect.width)
