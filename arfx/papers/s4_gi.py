"""Environment from the one camera and delta voxel cone tracing, as printed: Yao, Tao, Wu 2018.

1. The real scene is a plane. 2. It is voxelised with and without the object; coarser voxels are the mean of their children; what
the two differ in, V_delta, changes the real picture. 3. The environment is folded out of the picture. 4. Cones gather the light
of voxels and environment.

Deviations. There are no reflective shadow maps and no virtual point lights: voxels hold the light that cones bring them. V_delta
exists as texels of the planes alone, real pixels do not trace it. With the printed labels its sign is turned round: it is
subtracted here. The light is the frame's, not configured. The rest of step 4 is the corrected stage's: its cones, their
weights and steps. The plane's albedo, which a difference needs, is not stated: `plane_albedo`.
Its errors: docs/methods/gi.md#errata."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numba
import numpy as np

from arfx.analyse.fold import Analysis
from arfx.analyse.light.fold import Environment
from arfx.analyse.light.surroundings import SIZE, foldable
from arfx.core.layers import Layer
from arfx.core.rect import Rect
from arfx.core.stage import View
from arfx.errors import require_within
from arfx.stages.gi import Gi, GiParams
from arfx.stages.gi.field import Field
from arfx.stages.gi.stage import LEVELS


@dataclass(frozen=True)
class PrintedGiParams(GiParams):
    """plane_albedo : of the real plane, 0..1"""

    formula: str = field(default="paper", init=False)
    plane_albedo: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("gi", self, plane_albedo=(0, 1))


@numba.njit(cache=True, nogil=True)
def step2_mean(below, children, out):  # pragma: no cover - compiled
    """A voxel is the mean of its eight children. Through a wall one voxel thick 1 - 2^-L of the light leaks at level L."""
    directed = below.shape[1] == 6
    for p in range(children.shape[0]):
        for d in range(6):
            for s in range(8):
                c = children[p, s]
                if c >= 0:
                    for k in range(4):
                        out[p, d, k] += np.float32(0.125) * below[c, d if directed else 0, k]


def step2_delta(field: Field) -> np.ndarray:
    """V_delta = V_rho - V_mu, real alone less real and virtual, on the planes: the light that the object adds, with the sign
    turned round. A lone plane sends itself no light, so a black object leaves it as it is."""
    return -field.gain


def step3_environment(image: np.ndarray, size: int = SIZE) -> np.ndarray:
    """(6, size, size, 3) radiance as `surroundings.fold`: the picture in thirds, its middle the front and, mirrored, the back,
    the parts beside the middle the sides. There is a seam where those meet the back."""
    picture = foldable(image)
    h, w = picture.shape[:2]
    ys, xs = (np.linspace(0, n, 4).round().astype(int) for n in (h, w))
    part = lambda row, column: picture[ys[row] : ys[row + 1], xs[column] : xs[column + 1]]  # noqa: E731
    shrink = lambda p: cv2.resize(np.ascontiguousarray(p), (size, size), interpolation=cv2.INTER_AREA)  # noqa: E731
    # a side's first line is the one that touches the front
    right, left = shrink(part(1, 2)), shrink(part(1, 0))[:, ::-1]
    down, up = shrink(part(2, 1)), shrink(part(0, 1))[::-1]
    front = shrink(part(1, 1))
    return np.stack([right, left, down, up, front, front])


class PrintedEnvironment(Environment):
    folded = staticmethod(step3_environment)

    def seen(self, clip: Analysis) -> Analysis:
        return clip


class PrintedGi(Gi):
    levels = ("standard",)
    settings = {"standard": replace(LEVELS["standard"], plane_rays=0, downsample=step2_mean, sent_alone=True)}
    Params = PrintedGiParams

    def on_planes(
        self, field: Field, virtual: np.ndarray, shadow: np.ndarray, view: View,
        add_change: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        changed = add_change(virtual, step2_delta(field), -self.params.strength * self.params.plane_albedo)
        return virtual + (1 - view[Layer.COVERAGE][..., None]) * (changed - virtual), shadow

    def in_mirrors(
        self, change: np.ndarray, light: np.ndarray, virtual: np.ndarray, shadow: np.ndarray, view: View, within: Rect
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        out, at = virtual.copy(), within.slices_in(view.rect)
        out[at] += (1 - view[Layer.COVERAGE][at][..., None]) * change
        return out, shadow
