"""Textures as pyramids of linear light in one flat array, which surface.py looks up.

Each level is the mean of four texels of the level below, 16 bits a channel."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

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

    texels: ndarray
    table: ndarray


def texture_stack(uses: Sequence[tuple[Texture, bool]]) -> TextureStack:
    """A row of the table for each; a picture that is used in several places is stored once.

    uses : textures, and whether their colour is coded (sRGB); alpha never is"""
    pictures = {
        (id(texture.picture), srgb): texture.picture for texture, srgb in uses
    }
    sizes = {key: level_sizes(picture) for key, picture in pictures.items()}
    areas = {key: [w * h for w, h in levels] for key, levels in sizes.items()}
    ends = np.cumsum([sum(texels) for texels in areas.values()], dtype=np.int64)
    starts = dict(zip(pictures, [0, *ends], strict=False))
    texels = np.full((max(sum(ends[-1:]), 1), 4), FULL, np.uint16)
    for (key, picture), end in zip(pictures.items(), ends, strict=True):
        write_pyramid(picture, key[1], texels[starts[key] : end])
    table = np.zeros((len(uses), OFFSETS + MAX_LEVELS), np.int64)
    for row, (texture, srgb) in zip(table, uses, strict=True):
        key = id(texture.picture), srgb
        levels, wraps = sizes[key], (_WRAPS[way] for way in texture.wrap)
        row[:OFFSETS] = *levels[0], len(levels), *wraps, texture.nearest
        row[OFFSETS : OFFSETS + len(levels)] = np.cumsum(
            [starts[key], *areas[key][:-1]]
        )
    return TextureStack(texels, table)


def level_sizes(picture: ndarray) -> list[tuple[int, int]]:
    """(width, height) of its pyramid's levels, down to one texel."""
    height, width = picture.shape[:2]
    count = min(max(width, height).bit_length(), MAX_LEVELS)
    return [(max(width >> k, 1), max(height >> k, 1)) for k in range(count)]


def write_pyramid(picture: ndarray, srgb: bool, texels: ndarray) -> list[ndarray]:
    """Levels (h, w, 4) uint16 in linear light, which lie in `texels` (n, 4), one after the other;
    missing channels are full."""
    height, width, channels = picture.shape
    whole = np.full((height, width, 4), 255, np.uint8)
    whole[..., :channels] = picture
    table = np.stack([_FROM_SRGB if srgb else _LINEAR] * 3 + [_LINEAR], -1)
    levels: list[ndarray] = []
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
