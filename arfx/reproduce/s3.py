"""Rows of Jia, Tang 2013: Voronoi watercolour."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from arfx.papers.s3_watercolor import eq3_rgb
from arfx.reproduce.rows import Item, shown
from arfx.reproduce.work import Work


def rows(work: Work) -> Iterator[Item]:
    step = np.zeros((4, 4, 3), np.float32)
    step[:, 2:] = 1
    edge = float(np.max(eq3_rgb(step)))
    yield shown("s3", "equation (3), black beside white", "(|∇R| + |∇G| + |∇B|) / 3", edge, None, abs(edge - 1) < 1e-6, "")
