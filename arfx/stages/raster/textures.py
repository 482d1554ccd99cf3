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
        self._pictures: list[
            tuple[np.ndarray, bool]
        ] = []  # ids stay unique while they live
        self._rows: list[list[int]] = []
        self._size = 0

    def add(self, texture: Texture, srgb: bool) -> int:
        """Number of a texture. srgb : its colour is coded, alpha never is"""
        picture = texture.picture
        key = (id(picture), srgb, *texture.wrap, texture.nearest)
        if key not in self._index:
            self._index[key] = len(self._rows)
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
            self._pictures.append((picture, srgb))
            self._pyramids[key] = []
            for width, height in level_sizes(picture):
                self._pyramids[key].append(self._size)
                self._size += width * height
        return self._pyramids[key]

    def build(self) -> TextureStack:
        """All of them."""
        texels = np.full((max(self._size, 1), 4), FULL, np.uint16)
        for picture, srgb in self._pictures:
            write_pyramid(picture, srgb, texels[self._pyramids[id(picture), srgb][0] :])
        return TextureStack(
            texels, np.array(self._rows, np.int64).reshape(-1, OFFSETS + MAX_LEVELS)
        )


def level_sizes(picture: np.ndarray) -> list[tuple[int, int]]:
    """(width, height) of its pyramid's levels, down to one texel."""
    height, width = picture.shape[:2]
    sizes = [(width, height)]
    while max(sizes[-1]) > 1 and len(sizes) < MAX_LEVELS:
        width, height = max(width // 2, 1), max(height // 2, 1)
        sizes.append((width, height))
    return sizes


def write_pyramid(picture: np.ndarray, srgb: bool, texels: np.ndarray) -> list[np.ndarray]:
    """Levels (h, w, 4) uint16 in linear light, which lie in `texels` (n, 4), one after the other;
    missing channels are full."""
    height, width, channels = picture.shape
    whole = np.full((height, width, 4), 255, np.uint8)
    whole[..., :channels] = picture
    table = np.stack([_FROM_SRGB if srgb else _LINEAR] * 3 + [_LINEAR], -1)
    levels: list[np.ndarray] = []
    start = 0
    for size in level_sizes(picture):
        end = start + size[0] * size[1]
        level = texels[start:end].reshape(size[1], size[0], 4)
        if levels:
            cv2.resize(levels[-1], size, dst=level, interpolation=cv2.INTER_AREA)
        else:
            cv2.LUT(whole, table[None], dst=level)
        levels.append(level)
        start = end
    return levels
