"""The object's size beside the marker's and the distance to the camera: a file in
millimetres read as metres is told by it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.marker import anchor_marker
from arfx.core.model import Model
from arfx.core.scene import Scene
from arfx.errors import ConfigError

LARGE, SMALL = (
    10.0,
    0.01,
)  # of the distance: what is beyond fills the picture, or is a dot
_LOOKED = 9  # frames in which the camera is looked for inside the object
_REMEDY = (
    "--fit 15cm makes its longest side that long; --scale 0.001 takes the file's numbers"
    " for millimetres"
)


def model_size(scene: Scene, facts: Sequence[FrameFacts]) -> dict[str, Any]:
    """Metres. size_m : the object's longest side;  marker : key of the print below it, None
    without markers;  marker_m : its side
    distance_m : from the camera to the marker or place below it, median over the clip, None
    if never seen
    """
    scale = float(np.cbrt(np.linalg.det(scene.world_from_model[:3, :3])))
    place = scene.world_from_anchor.translation_m
    away = [
        float(np.linalg.norm(f.camera_from_world.apply(place)))
        for f in facts
        if f.camera_from_world is not None
    ]
    placed = (
        anchor_marker(scene.markers, scene.world_from_marker)
        if scene.markers
        else None
    )
    return {
        "size_m": float(np.ptp(scene.model.bounds, axis=0).max()) * scale,
        "marker": None if placed is None else placed.key,
        "marker_m": None if placed is None else placed.size_m,
        "distance_m": float(np.median(away)) if away else None,
    }


def size_in_words(size: dict[str, Any]) -> str:
    """The same in a line."""
    marker = ""
    if size["marker"] is not None:
        marker = f" on marker {size['marker']} ({_length(size['marker_m'])})"
    distance = (
        "" if size["distance_m"] is None else f", {_length(size['distance_m'])} away"
    )
    return f"object {_length(size['size_m'])}{marker}{distance}"


def check_size(scene: Scene, facts: Sequence[FrameFacts]) -> list[str]:
    """Notices where size and distance do not fit.

    Raises ConfigError where the camera is inside the object in most frames.
    """
    size = model_size(scene, facts)
    posed = [f for f in facts if f.camera_from_world is not None]
    looked = posed[:: max(len(posed) // _LOOKED, 1)]
    model_from_world = np.linalg.inv(scene.world_from_model)
    inside = [
        _winding(scene.model, _camera_in_model(f, model_from_world)) > 0.5
        for f in looked
    ]
    if 2 * sum(inside) > len(inside):
        raise ConfigError(
            f"the camera is inside the object ({size_in_words(size)})", _REMEDY
        )
    if (
        size["distance_m"] is None
        or SMALL <= size["size_m"] / size["distance_m"] <= LARGE
    ):
        return []
    which = "large" if size["size_m"] > size["distance_m"] else "small"
    return [
        f"the object is {which} for where it stands: {size_in_words(size)}. {_REMEDY}"
    ]


def _camera_in_model(facts: FrameFacts, model_from_world: ndarray) -> ndarray:
    assert facts.camera_from_world is not None
    centre = facts.camera_from_world.inverse().translation_m
    return model_from_world[:3, :3] @ centre + model_from_world[:3, 3]


def _winding(model: Model, point: ndarray) -> float:
    """How often the surface goes around a point: 1 inside a closed one, 0 outside, -1 in a
    room seen from within. Sum of the triangles' solid angles (Van Oosterom and Strackee
    1983, equation 8)."""
    low, high = model.bounds
    if (point < low).any() or (point > high).any():
        return 0.0
    total = 0.0
    for part in model.parts:
        a, b, c = np.moveaxis(part.vertices[part.faces] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        products = (
            np.einsum("ij,ij->i", u, v) * w
            for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb))
        )
        total += float(np.arctan2(volume, la * lb * lc + sum(products)).sum())
    return total / (2 * np.pi)


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 1 else f"{1000 * metres:.3g} mm"
