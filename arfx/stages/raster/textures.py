"""Textures as 8-bit mip pyramids in one flat array; hits.py looks them up.

Averages are taken in linear light (colour) and stored sRGB coded again, as SRGB8_ALPHA8 does in OpenGL."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import CLAMP, MIRROR, REPEAT, Texture

MAX_LEVELS = 15
WRAPS = {REPEAT: 0, CLAMP: 1, MIRROR: 2}
WRAP_COLUMN = 3 + MAX_LEVELS
_ROWS, _TEXELS = (
    256,
    1 << 20,
)  # that are worked on at a time: of 8192 x 8192 texels every float copy takes a gigabyte
# Decode tables by row: 0 linear, 1 sRGB.
CODE = np.stack([np.arange(256) / 255.0, SRGB.decode(np.arange(256) / 255.0)]).astype(np.float32)
_ENCODE = np.round(SRGB.encode(np.arange(8193) / 8192.0) * 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class TextureStack:
    """texels : (n, 4) uint8, all levels of all textures
    table : (k, 5 + MAX_LEVELS) int64 width, height, levels, offsets, WRAPS along u and v
    srgb : (k,) bool, the first three channels are sRGB coded"""

    texels: np.ndarray
    table: np.ndarray
    srgb: np.ndarray

    @cached_property
    def linear(self) -> np.ndarray:
        """(n, 4) uint16, texels in linear light, 65535 = 1: one load for four channels, no table for each."""
        out = np.empty(self.texels.shape, np.uint16)
        code = np.round(CODE * 65535).astype(np.uint16)
        ends = np.append(self.table[1:, 3], len(self.texels))[: len(self.table)]
        for start, end, srgb in zip(self.table[:, 3], ends, self.srgb, strict=True):
            for a in range(start, end, _TEXELS):
                b = min(a + _TEXELS, end)
                out[a:b] = _decode(self.texels[None, a:b], code, bool(srgb))[0]
        return out


class StackBuilder:
    """Collects textures, each array once."""

    def __init__(self) -> None:
        self._index: dict[tuple[int, bool, tuple[str, str]], int] = {}
        self._keep: list[np.ndarray] = []  # ids stay unique only while the arrays live
        self._rows: list[list[int]] = []
        self._srgb: list[bool] = []
        self._texels: list[np.ndarray] = []
        self._size = 0

    def add(self, texture: Texture | None, srgb: bool) -> int:
        """Number of a texture; -1 for None."""
        if texture is None:
            return -1
        image = texture.picture
        key = (id(image), srgb, texture.wrap)
        if key not in self._index:
            self._index[key] = len(self._rows)
            self._keep.append(image)
            self._srgb.append(srgb)
            levels = pyramid(image, srgb)
            offsets = []
            for level in levels:
                offsets.append(self._size)
                self._texels.append(level.reshape(-1, 4))
                self._size += level.shape[0] * level.shape[1]
            offsets += [0] * (MAX_LEVELS - len(offsets))
            wrap = [WRAPS[way] for way in texture.wrap]
            self._rows.append([image.shape[1], image.shape[0], len(levels), *offsets, *wrap])
        return self._index[key]

    def build(self) -> TextureStack:
        texels = np.full((max(self._size, 1), 4), 255, np.uint8)
        end = self._size
        while self._texels:  # given back one by one
            level = self._texels.pop()
            texels[end - len(level) : end] = level
            end -= len(level)
        table = np.array(self._rows, np.int64).reshape(-1, 5 + MAX_LEVELS)
        return TextureStack(texels, table, np.array(self._srgb, bool))


def pyramid(image: np.ndarray, srgb: bool) -> list[np.ndarray]:
    """Levels (h, w, 4) uint8 down to one texel; missing channels are 255. First three channels coded if `srgb`."""
    h, w, c = image.shape
    full = image
    if c < 4:
        full = np.full((h, w, 4), 255, np.uint8)
        full[..., :c] = image
    levels = [full]
    linear = None
    while max(w, h) > 1 and len(levels) < MAX_LEVELS:
        linear = _half_linear(full, srgb) if linear is None else _half_size(linear)
        h, w = linear.shape[:2]
        coded = np.empty((h, w, 4), np.uint8)
        for a in range(0, h, _ROWS):
            rows, light = coded[a : a + _ROWS], linear[a : a + _ROWS]
            rows[..., 3] = np.round(light[..., 3] * 255)
            rows[..., :3] = (
                np.take(_ENCODE, np.round(light[..., :3] * 8192).astype(np.intp))
                if srgb
                else np.round(light[..., :3] * 255)
            )
        levels.append(coded)
    return levels


def _half_linear(full: np.ndarray, srgb: bool) -> np.ndarray:
    """(h, w, 4) uint8 in linear light at half the size, float32; of even sizes some rows at a time."""
    h, w = full.shape[:2]
    if h % 2 or w % 2:
        return _half_size(_decode(full, CODE, srgb))
    out = np.empty((h // 2, w // 2, 4), np.float32)
    for a in range(0, h, _ROWS):
        out[a // 2 : (a + _ROWS) // 2] = _half_size(_decode(full[a : a + _ROWS], CODE, srgb))
    return out


def _half_size(linear: np.ndarray) -> np.ndarray:
    w, h = max(linear.shape[1] // 2, 1), max(linear.shape[0] // 2, 1)
    return np.asarray(cv2.resize(linear, (w, h), interpolation=cv2.INTER_AREA), np.float32).reshape(
        h, w, 4
    )


def _decode(coded: np.ndarray, table: np.ndarray, srgb: bool) -> np.ndarray:
    """(h, w, 4) uint8 through a table (2, 256) by row of CODE, in the table's type: numpy would make 64-bit indices first."""
    channels = np.stack([table[int(srgb)]] * 3 + [table[0]], -1)
    return np.asarray(cv2.LUT(np.ascontiguousarray(coded), channels[None])).reshape(coded.shape)
