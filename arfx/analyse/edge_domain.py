"""In which values are edges symmetric, light or code? Decided once per clip, from the first sightings.

Blur of the lens is symmetric in linear light. Cameras that sharpen their picture do so in coded values, and the edges
they leave are symmetric there: taken for light, they move by a tenth of a pixel or more, always outwards. The skew of
the edges' gradient tells: until it has been decided, both are computed and both are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from arfx.analyse.corners import linear_table, refine_corners
from arfx.analyse.detect import Candidate, cells_per_side
from arfx.analyse.fold import Fold
from arfx.analyse.records import Seen
from arfx.core.camera import Camera

AUTO, LIGHT, CODE = "auto", "srgb", "gamma:1"
SIGHTINGS = 12  # decide after so many
FRAMES = 120  # or after so many with a marker in them, by what there is: edges too poor to tell are poor later too
# Measured: true linear blur gives skews up to .03 in light; camera-sharpened footage .19 in light and -.03 in code.
_SKEWED = 0.1


class EdgeRefiner(Fold):
    """Refines sightings; `transfer` is "auto" until decided."""

    def __init__(self, transfer: str = AUTO) -> None:
        self.transfer = transfer
        self._table = linear_table(LIGHT if transfer == AUTO else transfer)
        self._skews: list[tuple[float, float]] = []
        self._other: list[tuple[int, tuple[Seen, ...]]] = []  # what frames would be in code
        self._ready = False

    @property
    def table(self) -> np.ndarray:
        """(256,) coded luma to linear light, as decided so far."""
        return self._table

    def refine(self, frame: int, luma: np.ndarray, found: Sequence[Candidate], camera: Camera) -> tuple[Seen, ...]:
        """frame : number of the record, for `corrections`."""
        if not found:
            return ()
        first, skew = _refined(luma, found, self._table, camera)
        if self.transfer == AUTO:
            second, skew_code = _refined(luma, found, linear_table(CODE), camera)
            both = np.stack([skew, skew_code], -1)
            self._skews += [(float(a), float(b)) for a, b in both[np.isfinite(both).all(1)]]
            self._other.append((frame, second))
            if len(self._skews) >= SIGHTINGS or len(self._other) >= FRAMES:
                self._decide()
        return first

    def _decide(self) -> None:
        light, code = np.abs(np.median(np.array(self._skews or [(0.0, 0.0)]), axis=0))
        self.transfer = CODE if light > _SKEWED and code < 0.5 * light else LIGHT
        self._table = linear_table(self.transfer)
        self._ready = self.transfer == CODE
        if not self._ready:
            self._other = []

    def corrections(self) -> list[tuple[int, tuple[Seen, ...]]]:
        """(frame, sightings) to replace, once, after a decision against what was assumed."""
        if not self._ready:
            return []
        out, self._other, self._ready = self._other, [], False
        return out


@cache
def _cells(family: str) -> int:
    return cells_per_side(family)


def _refined(
    luma: np.ndarray, found: Sequence[Candidate], table: np.ndarray, camera: Camera
) -> tuple[tuple[Seen, ...], np.ndarray]:
    quads = np.stack([c.quad_px for c in found])
    r = refine_corners(luma, quads, np.array([_cells(c.family) for c in found]), table, camera)
    seen = tuple(
        Seen(c.key, r.corners_px[i], float(r.sigma_px[i]), float(r.blur_px[i]), bool(r.inverted[i])) for i, c in enumerate(found)
    )
    return seen, r.skew
