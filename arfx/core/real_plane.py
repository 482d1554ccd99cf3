"""A plane of the real scene that was measured: where it lies, how far it reaches, and what its points miss of it."""

from __future__ import annotations

from dataclasses import dataclass

from arfx.core.codec import Document
from arfx.core.pose import Pose


@dataclass(frozen=True, eq=False)
class RealPlane(Document):
    """world_from_plane : z out of the plane, towards the room, origin in the middle of what was seen of it
    extent_m : (x0, y0, x1, y1) of what was seen, plane axes;  area_m2 : of it, holes left out
    ends : for each of its four sides, whether the plane was seen to end there, or the picture did (False)
    residual_mm : root mean square of its points' distances;  points : how many;  frames : in how many maps it was found
    """

    world_from_plane: Pose
    extent_m: tuple[float, float, float, float]
    area_m2: float
    residual_mm: float
    points: int
    frames: int = 1
    ends: tuple[bool, bool, bool, bool] = (False, False, False, False)
