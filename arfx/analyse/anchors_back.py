"""The same field of sites carried backwards: from the end of a stretch of the clip to its begin.

A pattern carried along by a motion is bent more and more. As the clip is known, a second one begins unbent at the end of each
stretch and is carried back; whoever paints both, the first fading out and the second in, always sees one that is little bent,
and sees the same in a clip that is run backwards (Bousseau et al. 2007). Stretches end where a shot does, and in a long one at
a key frame every PERIOD sets. The fade goes by sets, not by time: nothing fades where nothing moves. Cost: O(nodes) per set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

PERIOD = 90  # sets of sites
_APART_PX = 5003.0  # the pattern of the other end of a stretch comes from that far away
_ROUNDS = 6  # of the search for where a node came to lie
Field = tuple[np.ndarray, np.ndarray]
Sampled = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # (values at nodes, x, y) -> values there


@dataclass(frozen=True, eq=False)
class SetStep:
    """One set of sites. back (gh, gw, 2) px : what its nodes must be moved by to lie where they lay in the key frame before it;
    None : it has none, or lies as that
    key : the next ones are relative to this frame;  begins : a shot"""

    back: np.ndarray | None
    key: bool
    begins: bool


@dataclass(frozen=True, eq=False)
class BothWays:
    """Of one set. forward, backward : (u, v) at its nodes;  share : of the second, 0..1"""

    forward: Field
    backward: Field
    share: float


def both_ways(sets: Sequence[SetStep], gx: np.ndarray, gy: np.ndarray, sampled: Sampled, straightened: Callable) -> list[BothWays]:
    """Of every set. straightened : (u, v) -> (u, v) without folds"""
    out: list[BothWays] = []
    ends = _ends(sets)
    number = -1
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        number += 2 if sets[a].begins else 1  # nothing of the old pattern is seen in a new shot
        # the next stretch of a shot goes on from this one's end: they share that set, and its pattern
        last = b if b < len(sets) and not sets[b].begins else b - 1
        patterns = [(gx + _APART_PX * (number + k), gy) for k in (1, 2)]
        forward = _carried(sets, a, last, patterns[0], gx, gy, sampled, straightened)
        backward = _carried_back(sets, a, last, patterns[1], gx, gy, sampled, straightened)
        out += [BothWays(forward[k], backward[k], k / max(last - a, 1)) for k in range(b - a)]
    return out


def _ends(sets: Sequence[SetStep]) -> list[int]:
    """First set of each stretch, and the number of sets."""
    out: list[int] = []
    for k, s in enumerate(sets):
        if not out or s.begins or (s.key and k - out[-1] >= PERIOD):
            out.append(k)
    return [*out, len(sets)]


def _at_set(key: Field, step: SetStep, gx: np.ndarray, gy: np.ndarray, sampled: Sampled) -> Field:
    """The field at a set's nodes, from that at the nodes of its key frame."""
    if step.back is None:
        return key
    x, y = gx + step.back[..., 0], gy + step.back[..., 1]
    return sampled(key[0], x, y), sampled(key[1], x, y)


def _at_key(own: Field, step: SetStep, gx: np.ndarray, gy: np.ndarray, sampled: Sampled) -> Field:
    """The field at the nodes of a set's key frame, from that at the set's: a node came to lie where place + back = node."""
    if step.back is None:
        return own
    x, y = gx, gy
    for _ in range(_ROUNDS):
        x, y = gx - sampled(step.back[..., 0], x, y), gy - sampled(step.back[..., 1], x, y)
    return sampled(own[0], x, y), sampled(own[1], x, y)


def _carried(
    sets: Sequence[SetStep], a: int, b: int, pattern: Field, gx: np.ndarray, gy: np.ndarray, sampled: Sampled, straightened: Callable
) -> list[Field]:  # fmt: skip
    """Of the sets a ... b, unbent at a."""
    out = [pattern]
    key = pattern if sets[a].key else _at_key(pattern, sets[a], gx, gy, sampled)
    for step in sets[a + 1 : b + 1]:
        out.append(straightened(*_at_set(key, step, gx, gy, sampled)))
        key = out[-1] if step.key else key
    return out


def _carried_back(
    sets: Sequence[SetStep], a: int, b: int, pattern: Field, gx: np.ndarray, gy: np.ndarray, sampled: Sampled, straightened: Callable
) -> list[Field]:  # fmt: skip
    """Of the sets a ... b, unbent at b."""
    out = [pattern]
    key = _at_key(pattern, sets[b], gx, gy, sampled)
    for k in range(b - 1, a - 1, -1):
        step = sets[k]
        if step.key:  # what follows is relative to it: the field at the key frame is its own
            out.append(straightened(*key))
            key = _at_key(out[-1], step, gx, gy, sampled)
        else:
            out.append(straightened(*_at_set(key, step, gx, gy, sampled)))
    return out[::-1]
