"""Textures as pyramids of linear light in one flat array, which surface.py looks up.

Each level is the mean of four texels of the level below, 16 bits a channel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import CLAMP, MIRROR, REPEAT, Texture

MAX_LEVELS = 15
# Columns of a texture's row in the table, before the offsets of its levels.
WIDTH, HEIGHT, LEVELS, WRAP_U, WRAP_V, NEAREST, OFFSETS = range(7)
REPEATS, CLAMPS, MIRRORS = range(3)
_WRAPS = {REPEAT: REPEATS, CLAMP: CLAMPS, MIRROR: MIRRORS}
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
        self._index: dict[tuple[object, ...], int] = {}
        self._pyramids: dict[tuple[int, bool], list[int]] = {}
        self._keep: list[np.ndarray] = []  # ids stay unique only while the arrays live
        self._rows: list[list[int]] = []
        self._levels: list[np.ndarray] = []
        self._size = 0

    def add(self, texture: Texture, srgb: bool) -> int:
        """Number of a texture. srgb : its colour is coded, alpha never is"""
        picture = texture.picture
        key = (id(picture), srgb, *texture.wrap, texture.nearest)
        if key not in self._index:
            self._index[key] = len(self._rows)
            self._keep.append(picture)
            offsets = self._pyramid_offsets(picture, srgb)
            height, width = picture.shape[:2]
            wrap_u, wrap_v = (_WRAPS[way] for way in texture.wrap)
            row = [
                width,
                height,
                len(offsets),
                wrap_u,
                wrap_v,
                int(texture.nearest),
                *offsets,
            ]
            self._rows.append(row + [0] * (MAX_LEVELS - len(offsets)))
        return self._index[key]

    def _pyramid_offsets(self, picture: np.ndarray, srgb: bool) -> list[int]:
        key = id(picture), srgb
        if key not in self._pyramids:
            self._pyramids[key] = []
            for level in pyramid(picture, srgb):
                self._pyramids[key].append(self._size)
                self._levels.append(level.reshape(-1, 4))
                self._size += len(self._levels[-1])
        return self._pyramids[key]

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
