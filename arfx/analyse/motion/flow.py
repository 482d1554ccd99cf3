"""How the picture moves: dense optical flow (DIS) on a small frame, folded into what paint
needs to stay where it lies.

`BackgroundMotion` compares each frame with a key frame: while the picture has moved by less
than HOLD_PX the epoch stays, so that a resting camera gathers no drift. Every stretch of
the clip begins with a key frame. Nodes are good to some hundredths of a px of the small
frame: what all of it says of an affine motion, and around each how it differs.
Source: docs/methods/watercolor.md#advection. Cost: some 2 of the benchmark's yardsticks (a
blur of 1280 x 720) a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from arfx.core.advection import STEPS_PER_PX

GRID_PX = 32  # pitch of the nodes (stages.watercolor.sites.GRID_PX)
BORDER = 3  # nodes outside the picture on each side
WIDTH_PX = 256  # of the small frame
# An epoch is kept while no more than a tenth of the nodes has moved by this much. Half a
# cell (the figure) would let a slow pan go by in visible leaps.
HOLD_PX = 0.35
_AGREE_PX, _AGREE_FRACTION = (
    0.6,
    0.05,
)  # forward and backward flow agree to this, on the small frame
_GRADIENT = 6.0  # grey levels per px at which a place is trusted half
KEY_FRACTION = 0.06  # of the picture's width
_NOISE, _STEEP = (
    2.0,
    20.0,
)  # grey levels per px of the small frame: no detail, and as much as counts
# Standard deviation of what counts as around a node, in nodes. Any less, and what lies
# between two nodes would change as they pass over the things: cells would grow and shrink.
_DETAIL_NODES = 0.85
_CHANGED = 0.7  # less than this share of agreement: the frame becomes the next key
_LOST = 0.25  # less than this share of agreement: the frame has nothing to do with the last epoch's
_SPREAD_NODES = 1.5


@dataclass(frozen=True, eq=False)
class MotionStep:
    """A frame at which a new epoch of advection begins. back (gh, gw, 2) float32 : what its
    nodes must be moved by, px of the frame, to lie where they lay in the last key frame;
    None : nothing is known (first frame, or all is new)
    key : later steps are relative to this frame
    detail (gh, gw) uint8 : how much there is to see around the nodes, 0 = even, 255 = edges
    everywhere"""

    index: int
    back: np.ndarray | None
    key: bool
    detail: np.ndarray


def node_positions(width: int, height: int) -> np.ndarray:
    """(gh, gw, 2) x, y px of the nodes: every GRID_PX, and BORDER of them outside on each
    side.
    """
    x, y = (
        (np.arange(-(-size // GRID_PX) + 1 + 2 * BORDER) - BORDER) * float(GRID_PX)
        for size in (width, height)
    )
    return np.stack(np.meshgrid(x, y), -1)


class KeyPicture(NamedTuple):
    """The first frame of a stretch, or its last key frame. picture : (h, w) uint8, reduced;
    width, height : of the frame;  begins : it is the first one"""

    frame: int
    picture: np.ndarray
    width: int
    height: int
    begins: bool


class BackgroundMotion:
    """Collects MotionSteps of a stretch, in order, and the pictures that it is compared with
    those beside it by."""

    def __init__(self) -> None:
        self.steps: list[MotionStep] = []
        self.pictures: list[KeyPicture] = []
        # back of the last epoch, 0 where that is the key
        self._last: np.ndarray | float = 0.0

    def step(self, index: int, luma: np.ndarray) -> None:
        """Take the next frame. luma : (h, w) uint8"""
        h, w = luma.shape
        factor = max(w / WIDTH_PX, 1.0)
        small_size = (max(round(w / factor), 1), max(round(h / factor), 1))
        small = np.ascontiguousarray(
            cv2.resize(luma, small_size, interpolation=cv2.INTER_AREA)
        )
        key = self.pictures[-1].picture if self.pictures else None
        found = None if key is None else _back(small, key, w, h)
        back, far = None, True
        if found is not None:
            back, agreed = found
            inside = (slice(BORDER, -BORDER),) * 2
            moved = np.linalg.norm((back - self._last)[inside], axis=-1)
            if float(np.quantile(moved, 0.9)) <= HOLD_PX:
                return
            way = float(np.median(np.linalg.norm(back[inside], axis=-1)))
            far = way > KEY_FRACTION * w or agreed < _CHANGED
        self.steps.append(MotionStep(index, back, far, _detail(small, w, h)))
        self._last = 0.0 if far or back is None else back
        if far:
            self.pictures[1:] = [KeyPicture(index, small, w, h, not self.pictures)]


def joined_steps(
    steps: Sequence[MotionStep], pictures: Sequence[KeyPicture]
) -> list[MotionStep]:
    """Of all stretches: the first frame of each, a key frame, is compared with the last key
    frame before it."""
    before, backs = None, {}
    for picture in pictures:
        if picture.begins and before is not None:
            found = _back(picture.picture, before, picture.width, picture.height)
            backs[picture.frame] = None if found is None else found[0]
        before = picture.picture
    return [replace(s, back=backs.get(s.index, s.back)) for s in steps]


def _back(
    small: np.ndarray, reference: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, float] | None:
    """((gh, gw, 2) px of the frame at the nodes, share of the textured places where both
    directions agree), or None where the two frames have nothing in common."""
    h, w = small.shape
    if min(h, w) < 16 or np.array_equal(small, reference):  # DIS needs a patch or two
        return np.zeros(node_positions(width, height).shape, np.float32), 1.0
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)  # type: ignore[attr-defined]
    dis.setFinestScale(0)
    dis.setVariationalRefinementIterations(0)  # it takes as long as all else, and blurs
    back = dis.calc(small, reference, None)
    there = dis.calc(reference, small, None)
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    to_x, to_y = x + back[..., 0], y + back[..., 1]
    again, before = (
        cv2.remap(a, to_x, to_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for a in (there, reference)
    )
    apart = np.linalg.norm(back + again, axis=-1)
    agree = apart < _AGREE_PX + _AGREE_FRACTION * np.linalg.norm(back, axis=-1)
    agree &= np.abs(before.astype(np.float32) - small) < 40
    slope = _slope(small)
    textured = slope > _GRADIENT
    agreed = float(agree[textured].mean()) if textured.sum() > 50 else 1.0
    if agreed < _LOST:
        return None
    # of what has come into view since, the flow can only guess
    agree &= (to_x > 1) & (to_y > 1) & (to_x < w - 2) & (to_y < h - 2)
    trust = np.where(agree, slope**2 / (slope**2 + _GRADIENT**2), 0).astype(np.float32)
    nodes = _at_nodes(back, trust, width, height)
    return np.round(nodes * STEPS_PER_PX) / STEPS_PER_PX, agreed


def _slope(small: np.ndarray) -> np.ndarray:
    """(h, w) grey levels per px."""
    return np.hypot(*(cv2.Sobel(small, cv2.CV_32F, x, 1 - x, scale=0.25) for x in (1, 0)))


def _places(width: int, height: int, w: int, h: int) -> tuple[np.ndarray, Any]:
    """Of the nodes in the small frame (h, w): x, y (gh, gw, 2), and the index of the pixels
    next to them.
    """
    places = (node_positions(width, height) + 0.5) / [width / w, height / h] - 0.5
    x, y = (
        np.clip(np.round(p).astype(int), 0, size - 1)
        for p, size in ((places[0, :, 0], w), (places[:, 0, 1], h))
    )
    return places, np.ix_(y, x)


def _at_nodes(back: np.ndarray, trust: np.ndarray, width: int, height: int) -> np.ndarray:
    """Flow of the small frame at the nodes, px of the frame: the affine motion of what is
    trusted, and what differs from it spread from where it is trusted."""
    h, w = trust.shape
    places, at = _places(width, height, w, h)
    y, x = np.mgrid[0:h, 0:w]
    terms = np.stack([np.ones((h, w)), x / w, y / h], -1)
    few = (
        slice(None, None, 2),
    ) * 2  # a quarter of the pixels is enough for the motion of the whole
    some, weight = terms[few].reshape(-1, 3), trust[few].ravel().astype(float)
    moved, robust, motion = back[few].reshape(-1, 2).astype(float), weight, np.zeros((3, 2))
    for _ in range(
        3
    ):  # weighted least squares, with what misses it by much counting less; drawn towards no motion
        normal = (some * robust[:, None]).T @ some + np.diag([1e-3, 1.0, 1.0])
        motion = np.linalg.solve(normal, (some * robust[:, None]).T @ moved)
        robust = weight / (1 + (np.linalg.norm(moved - some @ motion, axis=1) / 0.5) ** 2)
    # onto the nodes: the mean of what lies around each, by trust; then outwards from node to node
    rest = np.dstack([back - terms @ motion, np.ones((h, w))]) * trust[..., None]
    reach = max(GRID_PX * w / width / 2, 0.5)
    sums = cv2.GaussianBlur(rest, (0, 0), reach, borderType=cv2.BORDER_CONSTANT)[at]
    sums += 0.3 * cv2.GaussianBlur(
        sums, (0, 0), _SPREAD_NODES, borderType=cv2.BORDER_REPLICATE
    )
    whole = motion[0] + places / [w, h] @ motion[1:]
    out = (whole + sums[..., :2] / (sums[..., 2:] + 0.01)) * [width / w, height / h]
    return np.clip(out.astype(np.float32), -2000, 2000)


def _detail(small: np.ndarray, width: int, height: int) -> np.ndarray:
    """(gh, gw) uint8: mean slope of the small frame around each node, as a share of _STEEP;
    slopes of noise count nothing.
    """
    density = np.clip((_slope(small) - _NOISE) / (_STEEP - _NOISE), 0, 1)
    h, w = small.shape
    reach = max(_DETAIL_NODES * GRID_PX * w / width, 0.5)
    around = cv2.GaussianBlur(density, (0, 0), reach, borderType=cv2.BORDER_REPLICATE)
    return np.round(255 * around[_places(width, height, w, h)[1]]).astype(np.uint8)
