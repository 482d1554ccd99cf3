"""How the picture moves: dense optical flow (DIS) on a small frame, folded into what paint
needs to stay where it lies.

`BackgroundMotion` compares each frame with a key frame: while the picture has moved by less
than HOLD_PX the epoch stays, so that a resting camera gathers no drift. Every stretch of
the clip begins with a key frame. The flow is good to a tenth of a px of the small frame;
`refined` makes that some hundredths, by a step of Gauss and Newton on every node.
Source: docs/methods/watercolor.md#advection. Cost: some 2 of the benchmark's yardsticks (a
blur of 1280 x 720) a frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.markers.search import Sighting
from arfx.core.advection import STEPS_PER_PX
from arfx.core.numerics import divide

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
# Standard deviation of what is counted as around a node, in nodes, beside the nodes' own
# linear shares (.4): of flow; and of detail, where with any less what lies between two nodes
# would change as they pass over the things: cells would grow and shrink.
_FLOW_NODES, _DETAIL_NODES = 0.5, 0.75
_CHANGED = 0.7  # less than this share of agreement: the frame becomes the next key
_LOST = 0.25  # less than this share of agreement: the frame has nothing to do with the last epoch's
_SPREAD_NODES = 1.5
_FINE_PX = 1.0  # what is finer is not compared, px of the small picture
_MISFIT = 6.0  # grey levels at which a pixel counts half
# a pixel's noise, grey levels, over what the flow may be off at a node, px, squared
_PRIOR = 100.0
_NEIGHBOURS = 0.3
_FARTHEST_PX = 2000.0  # of the frame
_MOST_PX = 0.3  # of the small picture
_RIM_PX = 3  # the interpolation and the band need that much around a pixel


@dataclass(frozen=True, eq=False)
class MotionStep:
    """A frame at which a new epoch of advection begins. back (gh, gw, 2) float32 : what its
    nodes must be moved by, px of the frame, to lie where they lay in the last key frame;
    None : nothing is known (first frame, or all is new)
    key : later steps are relative to this frame
    detail (gh, gw) uint8 : how much there is to see around the nodes, 0 = even, 255 = edges
    everywhere"""

    index: int
    back: ndarray | None
    key: bool
    detail: ndarray


def node_positions(width: int, height: int) -> ndarray:
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
    picture: ndarray
    width: int
    height: int
    begins: bool


class BackgroundMotion:
    """Collects MotionSteps of a part of the clip, in order, and the pictures that it is
    compared with those beside it by."""

    tables: ClassVar[Mapping[str, type]] = {
        "steps": MotionStep,
        "key_pictures": KeyPicture,
    }

    def __init__(self) -> None:
        self.steps: list[MotionStep] = []
        self.key_pictures: list[KeyPicture] = []
        # back of the last epoch, 0 where that is the key
        self._last: ndarray | float = 0.0

    def step(self, frame: AnalysisFrame, _: Sequence[Sighting] = ()) -> None:
        index, luma = frame.index, frame.luma
        h, w = luma.shape
        factor = max(w / WIDTH_PX, 1.0)
        small_size = (max(round(w / factor), 1), max(round(h / factor), 1))
        small = cv2.resize(luma, small_size, interpolation=cv2.INTER_AREA)
        back, agreed, far = None, 0.0, True
        if self.key_pictures:
            back, agreed = _back(small, self.key_pictures[-1].picture, w, h)
        if back is not None:
            inside = (slice(BORDER, -BORDER),) * 2
            moved = np.linalg.norm((back - self._last)[inside], axis=-1)
            if float(np.quantile(moved, 0.9)) <= HOLD_PX:
                return
            way = float(np.median(np.linalg.norm(back[inside], axis=-1)))
            far = way > KEY_FRACTION * w or agreed < _CHANGED
        self.steps.append(MotionStep(index, back, far, _detail(small, w, h)))
        self._last = 0.0 if far or back is None else back
        if far:
            begins = not self.key_pictures
            self.key_pictures[1:] = [KeyPicture(index, small, w, h, begins)]


def joined_steps(
    steps: Sequence[MotionStep], pictures: Sequence[KeyPicture]
) -> list[MotionStep]:
    """Of all stretches: the first frame of each, a key frame, is compared with the last key
    frame before it."""
    before, backs = None, {}
    for picture in pictures:
        if picture.begins and before is not None:
            found = _back(picture.picture, before, picture.width, picture.height)
            backs[picture.frame] = found[0]
        before = picture.picture
    return [replace(s, back=backs.get(s.index, s.back)) for s in steps]


def _back(
    small: ndarray, reference: ndarray, width: int, height: int
) -> tuple[ndarray | None, float]:
    """((gh, gw, 2) px of the frame at the nodes, None where the two frames have nothing in
    common; share of the textured places where both directions agree)"""
    h, w = small.shape
    if min(h, w) < 16 or np.array_equal(small, reference):  # DIS needs a patch or two
        return np.zeros(node_positions(width, height).shape, np.float32), 1.0
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)  # type: ignore[attr-defined]
    dis.setFinestScale(0)
    # refinement takes a third of the time; `refined` does more
    dis.setVariationalRefinementIterations(0)
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
    agree &= cv2.absdiff(before, small) < 40
    slope = _slope(small)
    textured = slope > _GRADIENT
    agreed = float(agree[textured].mean()) if textured.sum() > 50 else 1.0
    if agreed < _LOST:
        return None, agreed
    # of what has come into view since, the flow can only guess
    agree &= (to_x > 1) & (to_y > 1) & (to_x < w - 2) & (to_y < h - 2)
    trust = np.where(agree, slope**2 / (slope**2 + _GRADIENT**2), 0).astype(
        np.float32
    )
    scale, hats = np.array([width / w, height / h]), _hats(width, height, w, h)
    places = (node_positions(width, height) + 0.5) / scale - 0.5
    rough = _at_nodes(back, trust, hats, places / [w, h])
    back = refined(rough, small, reference, trust > 0, hats) * scale
    back = np.clip(back, -_FARTHEST_PX, _FARTHEST_PX)
    return (np.round(back * STEPS_PER_PX) / STEPS_PER_PX).astype(np.float32), agreed


def _slope(small: ndarray) -> ndarray:
    """(h, w) grey levels per px."""
    return np.hypot(
        *(cv2.Sobel(small, cv2.CV_32F, x, 1 - x, scale=0.25) for x in (1, 0))
    )


@cache
def _hats(width: int, height: int, w: int, h: int) -> tuple[ndarray, ndarray]:
    """(h, gh) and (w, gw) : share of each node in the linear interpolation at every pixel of
    the small frame."""
    nodes = node_positions(width, height)
    rows, columns = (
        np.maximum(1 - np.abs(pixels[:, None] - places) / GRID_PX, 0).astype(
            np.float32
        )
        for pixels, places in (
            ((np.arange(h) + 0.5) * height / h - 0.5, nodes[:, 0, 1]),
            ((np.arange(w) + 0.5) * width / w - 0.5, nodes[0, :, 0]),
        )
    )
    return rows, columns


def _node_sums(hats: tuple[ndarray, ndarray], *terms: ndarray) -> ndarray:
    """(gh, gw, k) sums of terms (h, w) around each node, by their share."""
    rows, columns = hats
    return np.stack([rows.T @ one @ columns for one in terms], -1).astype(float)


def _around(sums: ndarray, nodes: float) -> ndarray:
    return cv2.GaussianBlur(sums, (0, 0), nodes, borderType=cv2.BORDER_CONSTANT)


def _with_neighbours(sums: ndarray) -> ndarray:
    return sums + _NEIGHBOURS * cv2.GaussianBlur(
        sums, (0, 0), _SPREAD_NODES, borderType=cv2.BORDER_REPLICATE
    )


def _at_nodes(
    back: ndarray,
    trust: ndarray,
    hats: tuple[ndarray, ndarray],
    places: ndarray,
) -> ndarray:
    """Flow (h, w, 2) of the small frame at the nodes: the affine motion of what is trusted, and
    what differs from it spread from where it is trusted. places : of the nodes, in sizes of it"""
    h, w = trust.shape
    y, x = np.mgrid[0:h, 0:w]
    terms = np.stack([np.ones((h, w)), x / w, y / h], -1)
    # a quarter of the pixels is enough for the motion of the whole
    some, weight = (
        terms[::2, ::2].reshape(-1, 3),
        trust[::2, ::2].ravel().astype(float),
    )
    moved, robust, motion = back[::2, ::2].reshape(-1, 2), weight, np.zeros((3, 2))
    # weighted least squares, with what misses it by much counting less; drawn towards no motion
    for _ in range(3):
        normal = (some * robust[:, None]).T @ some + np.diag([1e-3, 1.0, 1.0])
        motion = np.linalg.solve(normal, (some * robust[:, None]).T @ moved)
        robust = weight / (
            1 + (np.linalg.norm(moved - some @ motion, axis=1) / 0.5) ** 2
        )
    rest = (back - terms @ motion) * trust[..., None]
    sums = _around(_node_sums(hats, rest[..., 0], rest[..., 1], trust), _FLOW_NODES)
    sums = _with_neighbours(sums)
    return motion[0] + places @ motion[1:] + sums[..., :2] / (sums[..., 2:] + 1)


def _detail(small: ndarray, width: int, height: int) -> ndarray:
    """(gh, gw) uint8: mean slope of the small frame around each node, as a share of _STEEP;
    slopes of noise count nothing.
    """
    density = np.clip((_slope(small) - _NOISE) / (_STEEP - _NOISE), 0, 1)
    hats = _hats(width, height, *small.shape[::-1])
    sums = _node_sums(hats, density, np.ones_like(density))
    slopes, pixels = np.moveaxis(_around(sums, _DETAIL_NODES), -1, 0)
    return np.round(255 * divide(slopes, pixels)).astype(np.uint8)


def refined(
    back: ndarray,
    small: ndarray,
    reference: ndarray,
    trusted: ndarray,
    hats: tuple[ndarray, ndarray],
) -> ndarray:
    """(gh, gw, 2) float64 px of the small picture: `back`, a step nearer to where the
    reference has what the nodes show: the sums around each node of slopes and what is missing.

    back (gh, gw, 2) : px of the small picture: what is at a place there is at place + back
    in the reference;  small, reference (h, w) uint8;  trusted (h, w)"""
    now, then = (
        cv2.GaussianBlur(a.astype(np.float32), (0, 0), _FINE_PX)
        for a in (small, reference)
    )
    (rows, columns), (h, w) = hats, small.shape
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)
    to_x, to_y = rows @ np.moveaxis(back.astype(np.float32), -1, 0) @ columns.T + (
        x,
        y,
    )
    gy, gx = np.gradient(now)
    # OpenCV reads at 1/32 px: the slopes make up for the rest of the way
    fine_x, fine_y = (np.round(to * 32) / 32 for to in (to_x, to_y))
    e = now - cv2.remap(then, fine_x, fine_y, cv2.INTER_LANCZOS4)
    e -= gx * (to_x - fine_x) + gy * (to_y - fine_y)
    weight = trusted / (1 + (e / _MISFIT) ** 2)
    for at, size in ((x, w), (y, h), (to_x, w), (to_y, h)):
        weight[(at < _RIM_PX) | (at >= size - _RIM_PX)] = 0
    wx, wy, we = gx * weight, gy * weight, e * weight
    sums = _node_sums(
        hats, wx * gx, wx * gy, wy * gy, wx * e, wy * e, wx, wy, we, weight
    )
    means = divide(sums[..., 5:8], sums[..., 8:])  # around each node: taken out
    sums = sums[..., :5] - sums[..., [5, 5, 6, 5, 6]] * means[..., [0, 1, 1, 2, 2]]
    sums = _with_neighbours(sums)
    slopes = sums[..., [0, 1, 1, 2]].reshape(*sums.shape[:2], 2, 2)
    step = np.linalg.solve(slopes + _PRIOR * np.eye(2), sums[..., 3:, None])[..., 0]
    return back + np.clip(step, -_MOST_PX, _MOST_PX)
