"""Health of a job: what a stage says of its own estimates, and what it may ask for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layers
from arfx.core.scene import Scene


@dataclass(frozen=True)
class Check:
    """An estimate beside its limit. action : what was done about it where it is not ok"""

    name: str
    value: Any
    limit: Any
    ok: bool
    action: str

    def to_json(self) -> dict[str, Any]:
        verdict, action = ("ok", "none") if self.ok else ("warn", self.action)
        return {"check": self.name, "value": self.value, "limit": self.limit, "verdict": verdict, "action": action}


@dataclass(frozen=True)
class JobView:
    """A job whose frames are rendered.

    levels : those at which each stage ran;  picture : renders one frame of a scene by the stages named, at these levels, over a
    plate of ones; None where nothing of the model is in view
    """

    facts: Sequence[FrameFacts]
    scene: Scene
    levels: Mapping[str, frozenset[str]]
    picture: Callable[[Scene, FrameFacts, Mapping[str, str]], Layers | None]
