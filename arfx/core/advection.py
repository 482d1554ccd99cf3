"""How the background moved: for each node of a grid, the original position of what it shows now.

The frames of an epoch, in which little moves, share one set of positions. Paint laid out in
these moves with the scene."""

import base64
import zlib
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.codec import Document
from arfx.core.pose import Pose

STEPS_PER_PX = 16  # positions of nodes are whole numbers of them


@dataclass(frozen=True)
class AdvectionField(Document):
    """set : number of the epoch;  pitch : px from node to node;  origin : x, y of the
    first;  shape : rows, columns

    nodes : positions, of `pack_positions`, carried since the shot began
    detail : how much there is to see around each node, of `pack_detail`, "" = not known
    pose : camera_from_world of the frame for which the set was made"""

    set: int
    pitch: int
    origin: tuple[int, int]
    shape: tuple[int, int]
    nodes: str
    detail: str = ""
    pose: Pose | None = None

    def places(self) -> tuple[ndarray, ndarray]:
        """(u, v) (rows, columns) float64 px."""
        steps = np.frombuffer(_unpack(self.nodes), "<i4").reshape(2, *self.shape)
        u, v = np.cumsum(steps.astype(np.int64), axis=2) / STEPS_PER_PX
        return u, v

    def detail_at_nodes(self) -> ndarray:
        """(rows, columns) float64, 0..255."""
        return np.frombuffer(_unpack(self.detail), "<u2").reshape(self.shape) / 16.0


def pack_positions(u: ndarray, v: ndarray) -> str:
    """u, v : (rows, columns) px. Each is the difference to the node before it in its row."""
    whole = np.round(np.stack([u, v]) * STEPS_PER_PX).astype(np.int64)
    return _pack(np.diff(whole, axis=2, prepend=0).astype("<i4"))


def pack_detail(detail: ndarray) -> str:
    """detail : (rows, columns), 0..255"""
    return _pack(np.round(detail * 16).astype("<u2"))


def _pack(a: ndarray) -> str:
    return base64.b64encode(
        zlib.compress(np.ascontiguousarray(a).tobytes(), 6)
    ).decode()


def _unpack(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))
