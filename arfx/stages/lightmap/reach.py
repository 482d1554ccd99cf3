"""How much of the plane's light the object can take, and the pixels in which that may show."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.light.beams import FrameLight
from arfx.stages.light.region import UNEVEN, shadow_region
from arfx.stages.viewing import seen_rect


def plane_rect(points_m: np.ndarray, facts: FrameFacts, scene: Scene) -> Rect:
    """Pixels that hold points (n, 2) of the anchor's plane; the whole frame where some are
    not before the camera.
    """
    points = np.column_stack([points_m, np.zeros(len(points_m))])
    return seen_rect(
        scene.camera, facts.pose.apply(scene.world_from_anchor.apply(points)), 1.0
    )


def darkest(light: FrameLight, scene: Scene) -> float:
    """The largest share of the plane's light, 0..1, that the object can take: every
    directional light, and of the ambient one what it hides where it hides most."""
    hidden = min(shadow_region(scene).hidden * unevenness(light), 1.0)
    return float((light.ambient_fraction * hidden + light.direct_fractions.sum(0)).max())


def unevenness(light: FrameLight) -> float:
    """How many times as bright as its mean over the plane's hemisphere the soft light is at
    most, as far as pictures hold it.
    """
    return min(
        (1 + float(np.linalg.norm(light.shape))) / (1 + 2 / 3 * light.shape[2]), UNEVEN
    )
