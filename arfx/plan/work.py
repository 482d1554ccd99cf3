"""How much work a step is, in the terms of the price list (core/cost.py)."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.gi.frame_light import KEY as ENVIRONMENT
from arfx.stages.gi.frame_light import rounded

_BEAM_STEP = np.radians(0.02)  # lights nearer to each other than this cast the shadow that was made for the first
NO_LAMP = ()  # without lamps no shadow is made


def terms_of(need: Rect, facts: FrameFacts, scene: Scene, new: frozenset[str] = frozenset()) -> dict[str, float]:
    """new : those of "new_directions", "new_lights" that hold for the frame"""
    light = scene.light if facts.light is None else facts.light
    lamps = float(sum(any(c > 0 for c in li.rgb) for li in light.lights))
    object_mpx = facts.model_box.clip(need).area / 1e6 if facts.visible else 0.0
    return {
        "frames": 1.0,
        "mpx": need.area / 1e6,
        "object_mpx": object_mpx,
        "lamps": lamps,
        "lamp_mpx": lamps * object_mpx,
        "mfaces": scene.model.face_count / 1e6,
        **{name: 1.0 for name in sorted(new)},
    }


def what_is_new(facts: Iterable[FrameFacts]) -> Iterator[frozenset[str]]:
    """Of each frame, in order: is its light one whose shadows, or whose whole field, have not been made yet?"""
    met: Mapping[str, set[Hashable]] = {"new_directions": set(), "new_lights": set()}
    for f in facts:
        new = set()
        if f.visible:
            for name, key in _light_keys(f).items():
                if key != NO_LAMP and key not in met[name]:
                    met[name].add(key)
                    new.add(name)
        yield frozenset(new)


def _light_keys(facts: FrameFacts) -> dict[str, Hashable]:
    if facts.light is None:
        return {"new_directions": None, "new_lights": None}
    lights = [li for li in facts.light.lights if any(c > 0 for c in li.rgb)]
    directions = tuple((*np.round(li.unit / _BEAM_STEP).astype(int).tolist(), round(li.angular_size_deg, 1)) for li in lights)
    surroundings = str(facts.extra.get(ENVIRONMENT))
    return {"new_directions": directions or NO_LAMP, "new_lights": (repr(rounded(facts.light)), surroundings)}
