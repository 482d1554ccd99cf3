"""Textures as pyramids of linear light in one flat array, which surface.py looks up.

Each level is the mean of four texels of the level below, 16 bits a channel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from arfx.core.colour import SRGB

MAX_LEVELS = 15
# Columns of a texture's row in the table, before the offsets of its levels.
WIDTH, HEIGHT, LEVELS, WRAP_U, WRAP_V, NEAREST, OFFSETS = range(7)
REPEAT, CLAMP, MIRROR = range(3)
FULL = 65535
_LINEAR = np.round(np.arange(256) / 255 * FULL).astype(np.uint16)
_FROM_SRGB = np.round(SRGB.decode(np.arange(256) / 255) * FULL).astype(np.uint16)


class TextureStack(NamedTuple):
    """texels : (n, 4) uint16, FULL = 1, all levels of all textures;  table : (k, columns) int64"""

    texels: np.ndarray
    table: np.ndarray


class StackBuilder:
    """Collects pictures; one that is used in several places is stored once."""

    def __init__(self) -> None:
        self._index: dict[tuple[int, bool], int] = {}
        self._keep: list[np.ndarray] = []  # ids stay unique only while the arrays live
        self._rows: list[list[int]] = []
        self._levels: list[np.ndarray] = []
        self._size = 0

    def add(self, picture: np.ndarray, srgb: bool) -> int:
        """Number of a texture.

        picture : (h, w, c) uint8, c = 1 to 4;  srgb : its colour is coded, alpha never is"""
        key = (id(picture), srgb)
        if key not in self._index:
            self._index[key] = len(self._rows)
            self._keep.append(picture)
            levels = pyramid(picture, srgb)
            offsets = []
            for level in levels:
                offsets.append(self._size)
                self._levels.append(level.reshape(-1, 4))
                self._size += len(self._levels[-1])
            offsets += [0] * (MAX_LEVELS - len(offsets))
            height, width = picture.shape[:2]
            self._rows.append([width, height, len(levels), REPEAT, REPEAT, 0, *offsets])
        return self._index[key]

    def build(self) -> TextureStack:
        """All of them; the builder is empty after it."""
        texels = np.full((max(self._size, 1), 4), FULL, np.uint16)
        end = self._size
        while self._levels:  # given back one by one
            level = self._levels.pop()
            texels[end - len(level) : end] = level
            end -= len(level)
        return TextureStack(
            texels, np.array(self._rows, np.int64).reshape(-1, OFFSETS + MAX_LEVELS)
        )


def pyramid(picture: np.ndarray, srgb: bool) -> list[np.ndarray]:
    """Levels (h, w, 4) uint16 in linear light down to one texel; missing channels are full."""
    height, width, channels = picture.shape
    whole = np.full((height, width, 4), 255, np.uint8)
    whole[..., :channels] = picture
    table = np.stack([_FROM_SRGB if srgb else _LINEAR] * 3 + [_LINEAR], -1)
    levels = [cv2.LUT(whole, table[None])]
    while max(width, height) > 1 and len(levels) < MAX_LEVELS:
        width, height = max(width // 2, 1), max(height // 2, 1)
        half = cv2.resize(levels[-1], (width, height), interpolation=cv2.INTER_AREA)
        levels.append(half.reshape(height, width, 4))
    return levels
