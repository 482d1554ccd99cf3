"""The lens of one frame, in pixels: how large the blur circle of a distance is. Affine in dioptres
(core/lens.py)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.lens import Lens
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.scene import Scene
from arfx.errors import ConfigError
from arfx.stages.dof.params import (
    MARKER,
    OBJECT,
    DofParams,
    fnumber_keys,
    focal_keys,
    focus_keys,
    interpolate,
    interpolate_ratio,
)

_BOUND_SHARE = 0.1  # of the picture's width: bound of the radius


@dataclass(frozen=True, slots=True)
class CircleOfConfusion:
    """radius px = min(px_per_dioptre x |focus - 1/distance|, limit_px), dioptres in 1/m.

    coc_mm_per_px : diameter on the sensor of a circle of 1 px radius"""

    px_per_dioptre: float
    focus: float
    limit_px: float
    coc_mm_per_px: float

    def radius_px(self, dioptre: ndarray | float) -> ndarray:
        """Of any shape, in the type of `dioptre`."""
        distance = np.abs(self.focus - np.asarray(dioptre))
        return np.minimum(self.px_per_dioptre * distance, self.limit_px)

    def largest_px(self, dioptres: tuple[float, float]) -> float:
        """Bound of the radius in a range of dioptres."""
        return float(self.radius_px(np.array(dioptres)).max())


def unknown_lens(params: DofParams, facts: FrameFacts) -> str | None:
    """Why the footage's lens cannot be used, None where it can or none is asked for."""
    if params.lens != "footage":
        return None
    if facts.lens is None:
        return "the lens of the footage was not measured"
    return (
        None
        if facts.lens.known
        else f"the lens cannot be measured from the footage: {facts.lens.reason}"
    )


def circle_of_confusion(
    params: DofParams, facts: FrameFacts, scene: Scene
) -> CircleOfConfusion:
    """Of a frame with a pose. While the object fades in or out the aperture opens or closes with
    it.

    Raises InputError where the focus lies within the focal length."""
    width = scene.camera.width
    limit = _BOUND_SHARE * width
    fade, mm_per_px = min(facts.opacity, 1.0), 2 * params.sensor_width_mm / width
    if params.lens == "footage":
        assert facts.lens is not None
        return CircleOfConfusion(
            facts.lens.px_per_dioptre * fade, facts.lens.focus, limit, mm_per_px
        )
    focus = focus_dioptre(params, facts, scene)
    if params.aperture_px > 0:
        px_per_dioptre = (
            0.5 * params.aperture_px / max(focus, 1e-3)
        )  # focus beyond 1 km: as at 1 km
    else:
        fnumber = interpolate_ratio(fnumber_keys(params.fnumber), facts.time_s)
        lens = Lens(
            focal_mm(params, facts, scene),
            fnumber,
            1e3 / focus if focus > 0 else math.inf,
        )
        px_per_dioptre = (
            0.5e-3 * lens.coc_mm_per_dioptre * width / params.sensor_width_mm
        )
    return CircleOfConfusion(px_per_dioptre * fade, focus, limit, mm_per_px)


def focal_mm(params: DofParams, facts: FrameFacts, scene: Scene) -> float:
    """Focal length at the frame's time."""
    calibrated = scene.camera.fx * params.sensor_width_mm / scene.camera.width
    return interpolate_ratio(
        [(t, f or calibrated) for t, f in focal_keys(params.focal_mm)], facts.time_s
    )


def focus_dioptre(params: DofParams, facts: FrameFacts, scene: Scene) -> float:
    """1 / distance, 1/m, that is sharp at the frame's time."""
    keys = [(t, _dioptre(what, facts, scene)) for t, what in focus_keys(params.focus)]
    return interpolate(keys, facts.time_s)


def _dioptre(what: str | float, facts: FrameFacts, scene: Scene) -> float:
    if not isinstance(what, str):
        return 0.0 if math.isinf(what) else 1.0 / what
    pose = facts.pose
    if what == OBJECT:
        points = scene.model_corners_m
    elif what == MARKER:
        points = scene.world_from_anchor.translation_m[None]
    else:
        marker = scene.world_from_marker[marker_key(what[3:], scene)]
        points = marker.translation_m[None]
    depth = pose.apply(points)[:, 2]
    middle = float(depth.min() + depth.max()) / 2
    return float(divide(1.0, max(middle, EPS_DEPTH_M)))


def marker_key(name: str, scene: Scene) -> str:
    """Key of the scene's marker of that key or number. Raises ConfigError."""
    found = [k for k in scene.world_from_marker if name in (k, k.rpartition(":")[2])]
    if len(found) != 1:
        known = ", ".join(scene.world_from_marker) or "none"
        raise ConfigError(
            f"dof.focus: {'several markers have' if found else 'there is no marker'}"
            f" {name!r}",
            f"known: {known}",
        )
    return found[0]
