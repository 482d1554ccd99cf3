"""Random numbers that belong to a pixel: the same whatever rectangle they are asked for.

A 32-bit integer hash (the finaliser of MurmurHash3, A. Appleby) of key, channel and
position. Cost: 5 ns a pixel."""

import zlib

import numpy as np
from numpy import ndarray

from arfx.core.rect import Rect


def noise_key(seed: int, frame: int, stage: str) -> int:
    """Of all that one stage draws in one frame."""
    return zlib.crc32(f"{seed}/{frame}/{stage}".encode())


def noise(rect: Rect, key: int, channel: int = 0) -> ndarray:
    """(h, w) float32 in [0, 1), even, independent from pixel to pixel. key : below 2^32"""
    start = _hash(
        np.array([(key + 0x9E3779B9 * (channel + 1)) & 0xFFFFFFFF], np.uint32)
    )
    rows = _hash(
        start ^ np.arange(rect.y0, rect.y1, dtype=np.int64).astype(np.uint32)
    )
    columns = np.arange(rect.x0, rect.x1, dtype=np.int64).astype(np.uint32)
    bits = _hash(rows[:, None] ^ _hash(columns + np.uint32(0x85EBCA6B))[None])
    return (bits >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


def _hash(h: ndarray) -> ndarray:
    """Every bit of the result depends on every bit given; wraps around."""
    h = h ^ (h >> np.uint32(16))
    h = h * np.uint32(0x85EBCA6B)
    h ^= h >> np.uint32(13)
    h *= np.uint32(0xC2B2AE35)
    h ^= h >> np.uint32(16)
    return h
