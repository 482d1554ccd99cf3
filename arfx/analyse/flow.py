"""How the picture moves: dense optical flow on a small frame, folded into what paint needs to stay where it lies.

`BackgroundMotion` compares each frame with a key frame. While the picture has moved by less than HOLD_PX since the last set
of sites was made the set stays, so that a resting camera gathers no drift and nothing is labelled anew; else a new set begins,
and where each of its nodes lay in the key frame is kept. A frame becomes the next key when the picture has moved by
KEY_SHARE of its width, or has changed: errors add up from key to key only. `anchors.with_anchors` chains the keys.
Flow: DIS (Kroeger et al. 2016, OpenCV), forward and backward; where both disagree, or there is nothing to see, an affine
motion of the whole and its neighbours stand in. The flow is good to a tenth of a px of the small frame; one step of
`flow_refine` makes that some hundredths, or borders of cells would tremble. Cost: some 2 of the benchmark's yardsticks
(a blur of 1280 x 720) a frame, most of it flow. Source: SYSTEMS.md S3, "anchor sites".
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.analyse.flow_refine import refined
from arfx.analyse.fold import Fold
from arfx.core.codec import stored

GRID_PX = 32  # pitch of the nodes (stages.watercolor.sites.GRID_PX)
STEPS = 16  # to a px: places of nodes are whole numbers of them
BORDER = 3  # nodes outside the picture on each side
WIDTH_PX = 256  # of the small frame
# A set of sites is kept while no more than a tenth of the nodes has moved by this much. Half a cell (the figure)
# would let a slow pan go by in visible leaps.
HOLD_PX = 0.35
_AGREE_PX, _AGREE_SHARE = 0.6, 0.05  # forward and backward flow agree to this, on the small frame
_GRADIENT = 6.0  # grey levels per px at which a place is trusted half
KEY_SHARE = 0.06  # of the picture's width
_NOISE, _STEEP = 2.0, 20.0  # grey levels per px of the small frame: no detail, and as much as counts
# Standard deviation of what counts as around a node, in nodes. Any less, and what lies between two nodes would change as they
# pass over the things: cells would grow and shrink.
_DETAIL_NODES = 0.85
_CHANGED = 0.7  # less than this share of agreement: the frame becomes the next key
_LOST = 0.25  # less than this share of agreement: the frame has nothing to do with the last set's
_SPREAD_NODES = 1.5


@stored
@dataclass(frozen=True, eq=False)
class MotionStep:
    """A frame at which a new set of sites begins. back (gh, gw, 2) float32 : what its nodes must be moved by, px of the
    frame, to lie where they lay in the last key frame; None : nothing is known (first frame, or all is new)
    key : later steps are relative to this frame
    detail (gh, gw) uint8 : how much there is to see around the nodes, 0 = even, 255 = edges everywhere"""

    index: int
    back: np.ndarray | None
    key: bool
    detail: np.ndarray


def node_places(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) (gh, gw) float64 px of the nodes: every GRID_PX, and BORDER of them outside on each side."""
    x = (np.arange(-(-width // GRID_PX) + 1 + 2 * BORDER) - BORDER) * float(GRID_PX)
    y = (np.arange(-(-height // GRID_PX) + 1 + 2 * BORDER) - BORDER) * float(GRID_PX)
    gx, gy = np.meshgrid(x, y)
    return gx, gy


class BackgroundMotion(Fold):
    """Collects MotionSteps, in order."""

    given = frozenset({"hold_px"})

    def __init__(self, hold_px: float = HOLD_PX) -> None:
        self.hold_px = hold_px
        self.steps: list[MotionStep] = []
        self._reference: np.ndarray | None = None
        self._last: np.ndarray | None = None  # back of the last set, None where that is the key frame
        self._size = (0, 0)  # width, height of the frames

    def step(self, index: int, time_s: float, luma: np.ndarray) -> None:
        """Take the next frame. luma : (h, w) uint8."""
        h, w = luma.shape
        small = _shrunk(luma)
        found = None
        if self._reference is not None and self._size == (w, h):
            found = self._back(small, w, h)
        self._size = (w, h)
        if found is None:
            self._reference, self._last = small, None
            self.steps.append(MotionStep(index, None, True, _detail(small, w, h)))
            return
        back, agreed = found
        back = np.round(back * STEPS) / STEPS
        inside = (slice(BORDER, -BORDER),) * 2
        moved = np.linalg.norm((back if self._last is None else back - self._last)[inside], axis=-1)
        if float(np.quantile(moved, 0.9)) <= self.hold_px:
            return
        far = float(np.median(np.linalg.norm(back[inside], axis=-1))) > KEY_SHARE * w or agreed < _CHANGED
        self.steps.append(MotionStep(index, back, far, _detail(small, w, h)))
        self._last = None if far else back
        if far:
            self._reference = small

    def _back(self, small: np.ndarray, width: int, height: int) -> tuple[np.ndarray, float] | None:
        """((gh, gw, 2) px of the frame at the nodes, share of the textured places where both directions agree), or None
        where the two frames have nothing in common."""
        assert self._reference is not None
        if np.array_equal(small, self._reference):
            return np.zeros((*node_places(width, height)[0].shape, 2), np.float32), 1.0
        h, w = small.shape
        if min(h, w) < 16:  # DIS needs a patch or two
            return np.zeros((*node_places(width, height)[0].shape, 2), np.float32), 1.0
        dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)  # type: ignore[attr-defined]
        dis.setFinestScale(0)
        back = dis.calc(small, self._reference, None)
        there = dis.calc(self._reference, small, None)
        x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
        again = cv2.remap(there, x + back[..., 0], y + back[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        apart = np.linalg.norm(back + again, axis=-1)
        agree = apart < _AGREE_PX + _AGREE_SHARE * np.linalg.norm(back, axis=-1)
        before = cv2.remap(self._reference, x + back[..., 0], y + back[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        agree &= np.abs(before.astype(np.float32) - small) < 40
        slope = np.hypot(cv2.Sobel(small, cv2.CV_32F, 1, 0, scale=0.25), cv2.Sobel(small, cv2.CV_32F, 0, 1, scale=0.25))
        textured = slope > _GRADIENT
        agreed = float(agree[textured].mean()) if textured.sum() > 50 else 1.0
        if agreed < _LOST:
            return None
        # of what has come into view since, the flow can only guess
        to_x, to_y = x + back[..., 0], y + back[..., 1]
        agree &= (to_x > 1) & (to_y > 1) & (to_x < w - 2) & (to_y < h - 2)
        trust = np.where(agree, slope**2 / (slope**2 + _GRADIENT**2), 0).astype(np.float32)
        return _refined_at_nodes(_at_nodes(back, trust, width, height), small, self._reference, trust, width, height), agreed


def _shrunk(luma: np.ndarray) -> np.ndarray:
    h, w = luma.shape
    factor = max(w / WIDTH_PX, 1.0)
    size = (max(round(w / factor), 1), max(round(h / factor), 1))
    return np.ascontiguousarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA))


def _at_nodes(back: np.ndarray, trust: np.ndarray, width: int, height: int) -> np.ndarray:
    """Flow of the small frame at the nodes, px of the frame: the affine motion of what is trusted, and what differs from it
    spread from where it is trusted."""
    h, w = trust.shape
    gx, gy = node_places(width, height)
    sx, sy = width / w, height / h
    y, x = np.mgrid[0:h, 0:w].astype(np.float64)
    terms = np.stack([np.ones((h, w)), x / w, y / h], -1)
    few = (slice(None, None, 2),) * 2  # a fourth of the pixels tells the motion of the whole well enough
    motion = _affine(terms[few].reshape(-1, 3), trust[few].ravel().astype(float), back[few].reshape(-1, 2).astype(float))
    residual = back - terms @ motion
    # onto the nodes: the mean of what lies around each, by trust; then outwards from node to node
    u, v = ((gx + 0.5) / sx - 0.5), ((gy + 0.5) / sy - 0.5)
    column = np.clip(np.round(u[0]).astype(int), 0, w - 1)
    row = np.clip(np.round(v[:, 0]).astype(int), 0, h - 1)
    reach = max(GRID_PX / sx / 2, 0.5)
    blur = lambda a: cv2.GaussianBlur(a, (0, 0), reach, borderType=cv2.BORDER_CONSTANT)  # noqa: E731
    much = blur(trust.astype(np.float64))[np.ix_(row, column)]
    moved = np.stack([blur(residual[..., c] * trust)[np.ix_(row, column)] for c in range(2)], -1)
    spread = lambda a: cv2.GaussianBlur(a, (0, 0), _SPREAD_NODES, borderType=cv2.BORDER_REPLICATE)  # noqa: E731
    moved = moved + 0.3 * spread(moved)
    much = much + 0.3 * spread(much)
    rest = moved / (much + 0.01)[..., None]
    whole = np.stack([np.ones(u.shape), (u / w), (v / h)], -1) @ motion
    out: np.ndarray = ((whole + rest) * [sx, sy]).astype(np.float32)
    return np.clip(out, -2000, 2000)


def _refined_at_nodes(
    back: np.ndarray, small: np.ndarray, reference: np.ndarray, trust: np.ndarray, width: int, height: int
) -> np.ndarray:
    """(gh, gw, 2) float32 px of the frame. back : of `_at_nodes`, the flow's"""
    h, w = small.shape
    scale = np.array([width / w, height / h])
    first = (0.5 - BORDER * GRID_PX) / scale - 0.5
    out: np.ndarray = (refined(back / scale, small, reference, trust, first, GRID_PX / scale) * scale).astype(np.float32)
    return out


def _detail(small: np.ndarray, width: int, height: int) -> np.ndarray:
    """(gh, gw) uint8: mean slope of the small frame around each node, as a share of _STEEP; slopes of noise count nothing."""
    slope = np.hypot(cv2.Sobel(small, cv2.CV_32F, 1, 0, scale=0.25), cv2.Sobel(small, cv2.CV_32F, 0, 1, scale=0.25))
    much = np.clip((slope - _NOISE) / (_STEEP - _NOISE), 0, 1)
    h, w = small.shape
    reach = max(_DETAIL_NODES * GRID_PX * w / width, 0.5)
    around = cv2.GaussianBlur(much, (0, 0), reach, borderType=cv2.BORDER_REPLICATE)
    gx, gy = node_places(width, height)
    column = np.clip(np.round((gx[0] + 0.5) * w / width - 0.5).astype(int), 0, w - 1)
    row = np.clip(np.round((gy[:, 0] + 0.5) * h / height - 0.5).astype(int), 0, h - 1)
    out: np.ndarray = np.round(255 * around[np.ix_(row, column)]).astype(np.uint8)
    return out


def _affine(terms: np.ndarray, weight: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """(3, 2) weighted least squares, thrice, with what misses it by much counting less. Drawn towards no motion."""
    motion = np.zeros((3, 2))
    robust = weight
    for _ in range(3):
        a = (terms * robust[:, None]).T @ terms + np.diag([1e-3, 1.0, 1.0])
        motion = np.linalg.solve(a, (terms * robust[:, None]).T @ flow)
        missed = np.linalg.norm(flow - terms @ motion, axis=1)
        robust = weight / (1 + (missed / 0.5) ** 2)
    return motion
