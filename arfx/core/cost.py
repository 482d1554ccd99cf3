"""Predicted cost of a step."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Cost:
    """seconds on one core of this machine; bytes read and written; None = not known, never a made-up number."""

    seconds: float | None
    bytes: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        s = None if self.seconds is None or other.seconds is None else self.seconds + other.seconds
        return Cost(s, self.bytes + other.bytes)
