"""What is where: camera, markers, the virtual object and the default light.

Fixed for a whole clip.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy import ndarray

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.light import Light
from arfx.core.marker import Marker
from arfx.core.model import Model
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.real_depth import RealPlane
from arfx.core.scene_mesh import SceneMesh, flatten
from arfx.errors import InputError

# Columns are the file's axes in marker axes (x right, y up the print, z out of it): a y-up
# file's y goes out of the print.
_UPRIGHT = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x": np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
}
# A model this large beside a hand-held marker is a file in millimetres read as metres.
MAX_EXTENT_M = 100.0


@dataclass(frozen=True)
class Placement:
    """How the model stands on its marker. Scale or fit, then rotate, then offset."""

    scale: float = 1.0
    fit_m: float | None = None
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def world_from_model(self, model: Model, up: str | None = None) -> ndarray:
        """(4, 4) from the model file's coordinates to metres in marker axes; the middle of
        the base is the origin. Raises InputError for a model without extent."""
        axes = _UPRIGHT[up or model.up]
        box = model.corners @ axes.T
        low, high = box.min(0), box.max(0)
        extent = float((high - low).max())
        if not 1e-150 < extent < np.inf:
            raise InputError(f"model {model.source} has no extent")
        scale = self.scale if self.fit_m is None else self.fit_m / extent
        base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        linear = rotation_from_euler_deg(*self.rotate_deg) * scale
        m = np.eye(4)
        m[:3, :3] = linear @ axes
        m[:3, 3] = np.asarray(self.offset_m, float) - linear @ base
        return m


@dataclass(frozen=True, eq=False)
class Scene:
    """world = frame of the marker map (the first marker's own axes unless a map says otherwise).

    world_from_model : (4, 4), rigid times a uniform scale
    world_from_marker : pose of each marker by key
    world_from_anchor : the marker that the model stands on; its plane z = 0 is the real
    surface below it
    surface_m : extent (x0, y0, x1, y1) of that surface, anchor axes; None = unknown, taken
    for unlimited
    real_planes : of the real scene, measured; those seen most first
    environment_maps : of facts' `seen_environment`, by name: (6, n, n, 4) float16, radiance
    as a share of `Light.mean_radiance`,
        times the fourth: how well it is known, 0..1"""

    camera: Camera
    model: Model
    world_from_model: ndarray
    markers: tuple[Marker, ...] = ()
    world_from_marker: Mapping[str, Pose] = field(default_factory=dict)
    world_from_anchor: Pose = field(default_factory=Pose.identity)
    light: Light = field(default_factory=Light)
    seed: int = 0
    surface_m: tuple[float, float, float, float] | None = None
    real_planes: tuple[RealPlane, ...] = ()
    environment_maps: Mapping[str, ndarray] = field(default_factory=dict)

    def light_of(self, facts: FrameFacts) -> Light:
        """Of a frame: its own, else the scene's."""
        return self.light if facts.light is None else facts.light

    @cached_property
    def placed_by(self) -> bytes:
        """Equal where the model stands on its anchor in the same way."""
        return np.concatenate(
            [self.world_from_model, self.world_from_anchor.matrix]
        ).tobytes()

    @cached_property
    def mesh(self) -> SceneMesh:
        """The model's triangles. Raises InputError where it is larger than MAX_EXTENT_M."""
        self.check_extent()
        return flatten(self.model, self.world_from_model)

    @cached_property
    def model_points_m(self) -> ndarray:
        """(n, 3) all vertices in world coordinates, metres."""
        return (
            self.model.vertices @ self.world_from_model[:3, :3].T
            + self.world_from_model[:3, 3]
        )

    def check_extent(self) -> None:
        """Raises InputError where the model is larger than MAX_EXTENT_M."""
        extent = float(np.ptp(self.model_corners_m, axis=0).max())
        if not extent <= MAX_EXTENT_M:
            size = f"{extent:.6g} m large in the scene, more than {MAX_EXTENT_M:g} m"
            hint = (
                "is the file in millimetres? --fit 15cm sets the size, --scale 0.001 the"
                " unit"
            )
            raise InputError(f"model {self.model.source} is {size}", hint)

    @cached_property
    def model_corners_m(self) -> ndarray:
        """(8, 3) corners of the model's bounding box, world, metres."""
        linear, shift_m = self.world_from_model[:3, :3], self.world_from_model[:3, 3]
        return self.model.corners @ linear.T + shift_m
