"""Textures as pyramids of linear light in one flat array, which surface.py looks up.

Each level is the mean of four texels of the level below, 16 bits a channel, with a border of one
texel all around: of the opposite side where the texture repeats, else of the same."""

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
    stored: dict[tuple[int, tuple[str, str], bool], tuple[Texture, ndarray]] = {}
    table = np.zeros((len(uses), OFFSETS + MAX_LEVELS), np.int64)
    end = 0
    for row, (texture, srgb) in zip(table, uses, strict=True):
        key = id(texture.picture), texture.wrap, srgb
        sizes = level_sizes(texture.picture)
        if key not in stored:
            areas = [(w + 2) * (h + 2) for w, h in sizes]
            stored[key] = texture, end + np.cumsum([0, *areas])
        starts = stored[key][1]
        end = max(end, starts[-1])
        wraps = (_WRAPS[way] for way in texture.wrap)
        row[:OFFSETS] = *sizes[0], len(sizes), *wraps, texture.nearest
        row[OFFSETS : OFFSETS + len(sizes)] = starts[:-1]
    texels = np.empty((end, 4), np.uint16)
    for (*_, srgb), (texture, starts) in stored.items():
        write_pyramid(texture, srgb, texels[starts[0] : starts[-1]])
    return TextureStack(texels, table)


def level_sizes(picture: ndarray) -> list[tuple[int, int]]:
    """(width, height) of its pyramid's levels, down to one texel."""
    height, width = picture.shape[:2]
    count = min(max(width, height).bit_length(), MAX_LEVELS)
    return [(max(width >> k, 1), max(height >> k, 1)) for k in range(count)]


def write_pyramid(texture: Texture, srgb: bool, texels: ndarray) -> list[ndarray]:
    """Levels (h, w, 4) uint16 in linear light, which lie in `texels` (n, 4), one after the other,
    each with a border; missing channels are full."""
    height, width, channels = texture.picture.shape
    whole = np.full((height, width, 4), 255, np.uint8)
    whole[..., :channels] = texture.picture
    table = np.stack([_FROM_SRGB if srgb else _LINEAR] * 3 + [_LINEAR], -1)
    levels: list[ndarray] = []
    start = 0
    for w, h in level_sizes(texture.picture):
        end = start + (w + 2) * (h + 2)
        bordered = texels[start:end].reshape(h + 2, w + 2, 4)
        level = bordered[1:-1, 1:-1]
        if levels:
            cv2.resize(levels[-1], (w, h), dst=level, interpolation=cv2.INTER_AREA)
        else:
            cv2.LUT(whole, table[None], dst=level)
        for lines, wrap in zip(
            (bordered.swapaxes(0, 1), bordered), texture.wrap, strict=True
        ):
            lines[[0, -1]] = lines[[-2, 1] if wrap == REPEAT else [1, -2]]
        levels.append(level)
        start = end
    return levels
