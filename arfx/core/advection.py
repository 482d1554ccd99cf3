"""How the background moved, as the facts carry it: for each node of a grid the place from which what it shows was carried there.

A set of places holds for frames as long as little moves. Paint that is laid out in these places moves with the things.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass

import numpy as np

from arfx.core.codec import Document
from arfx.core.pose import Pose

STEPS = 16  # to a px: places of nodes are whole numbers of them


@dataclass(frozen=True)
class AdvectionField(Document):
    """set : number of the set of places;  pitch : px from node to node;  origin : x, y of the first;  shape : rows, columns

    nodes : places, of `packed_places`, carried since the shot began
    forward, backward : the same of two patterns that begin unbent at the ends of a stretch of the clip, "" = none
    share : of the second of them in this frame
    detail : how much there is to see around each node, of `packed_detail`, "" = not known
    pose : camera_from_world of the frame for which the set was made
    """

    set: int
    pitch: int
    origin: tuple[int, int]
    shape: tuple[int, int]
    nodes: str
    detail: str = ""
    pose: Pose | None = None
    forward: str = ""
    backward: str = ""
    share: float = 0.0

    def places(self, way: str = "nodes") -> tuple[np.ndarray, np.ndarray]:
        """(u, v) (rows, columns) float64 px. way : nodes, forward or backward"""
        steps = np.frombuffer(_unpacked(getattr(self, way)), "<i4").reshape(2, *self.shape)
        u, v = np.cumsum(steps.astype(np.int64), axis=2) / STEPS
        return u, v

    def detail_at_nodes(self) -> np.ndarray:
        """(rows, columns) float64, 0..255."""
        return np.frombuffer(_unpacked(self.detail), "<u2").reshape(self.shape) / 16.0


def packed_places(u: np.ndarray, v: np.ndarray) -> str:
    """u, v : (rows, columns) px. Each is the difference to the node before it in its row."""
    whole = np.round(np.stack([u, v]) * STEPS).astype(np.int64)
    return _packed(np.diff(whole, axis=2, prepend=0).astype("<i4"))


def packed_detail(detail: np.ndarray) -> str:
    """detail : (rows, columns), 0..255"""
    return _packed(np.round(detail * 16).astype("<u2"))


def _packed(a: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(a).tobytes(), 6)).decode()


def _unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))
