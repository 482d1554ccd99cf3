"""Results that are used again in later frames: the most recent of each kind, by key."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from threading import Lock
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from arfx.core.model import Model

if TYPE_CHECKING:
    from arfx.core.scene import Scene


class Memo:
    """`make` is pure: two threads that call it for one key get equal results.

    made : how many calls there were
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._kinds: dict[str, dict[Hashable, Any]] = defaultdict(dict)
        self.made = 0

    def get(
        self, key: Hashable, make: Callable[[], Any], kind: str = "", most: int = 8
    ) -> Any:
        """most : results kept of this kind; the least recently used is dropped first"""
        with self._lock:
            things = self._kinds[kind]
            if key in things:
                things[key] = things.pop(key)
                return things[key]
        thing = make()
        with self._lock:
            self.made += 1
            things[key] = thing
            while len(things) > most:
                del things[next(iter(things))]
        return thing

    def clear(self) -> None:
        with self._lock:
            self._kinds.clear()


_OF_OWNER: WeakKeyDictionary[Model | Scene, Memo] = WeakKeyDictionary()


def memo_of(owner: Model | Scene) -> Memo:
    """What is made of a model alone and of how it stands: found again by planner, renderer
    and later jobs of this process, which have scenes of their own. Of a scene: what its
    stages share. It is gone with its owner, to which it must not refer."""
    return _OF_OWNER.setdefault(owner, Memo())


@dataclass(frozen=True, eq=False)
class Memos:
    """What a stage keeps from frame to frame, at one level, in one process.
    of_light : made for a light, found again while the light stays;  of_frame : made of a
    frame's pixels: empty before timing
    """

    of_light: Memo = field(default_factory=Memo)
    of_frame: Memo = field(default_factory=Memo)
