"""A plane of the real scene that was measured: where it lies, how far it reaches, and what its points miss of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from arfx.core.pose import Pose


@dataclass(frozen=True, eq=False)
class RealPlane:
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

    def to_json(self) -> dict[str, Any]:
        return {
            "world_from_plane": self.world_from_plane.to_json(), "extent_m": list(self.extent_m), "area_m2": self.area_m2,
            "residual_mm": self.residual_mm, "points": self.points, "frames": self.frames,
            "ends": list(self.ends),
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict[str, Any]) -> RealPlane:
        x0, y0, x1, y1 = d["extent_m"]
        a, b, c, e = d.get("ends", (False,) * 4)
        return RealPlane(
            Pose.from_json(d["world_from_plane"]), (x0, y0, x1, y1), d["area_m2"], d["residual_mm"], d["points"], d["frames"],
            (bool(a), bool(b), bool(c), bool(e)),
        )  # fmt: skip
