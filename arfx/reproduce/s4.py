"""Rows of Yao, Tao, Wu 2018: environment map from the one camera and delta voxel cone tracing."""

from __future__ import annotations

from collections.abc import Iterator

from arfx.reproduce.rows import Item
from arfx.reproduce.work import Work


def rows(work: Work) -> Iterator[Item]:
    yield from ()
