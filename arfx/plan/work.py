"""How much work a step is, in the terms of the price list (core/cost.py)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from arfx.core.facts import FrameFacts
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.stage import Stage


def terms_of(need: Rect, facts: FrameFacts, scene: Scene, new: frozenset[str] = frozenset()) -> dict[str, float]:
    """new : those of "new_directions", "new_lights" that hold for the frame"""
    lamps = float(sum(any(c > 0 for c in li.rgb) for li in scene.light_of(facts).lights))
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


def what_is_new(stages: Iterable[Stage], facts: Iterable[FrameFacts]) -> Iterator[frozenset[str]]:
    """Of each frame, in order: the terms (`Stage.once`) whose work has not been done yet, for its light is a new one."""
    every, met = list(stages), set()
    for f in facts:
        new = set()
        if f.visible:
            for name, key in (item for stage in every for item in stage.once(f).items()):
                if (name, key) not in met:
                    met.add((name, key))
                    new.add(name)
        yield frozenset(new)
