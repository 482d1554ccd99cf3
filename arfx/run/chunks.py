"""How a clip is cut into chunks. The borders depend on the job alone, never on who renders them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SHORTEST, LONGEST, WANTED = 30, 120, 8


@dataclass(frozen=True, slots=True)
class Chunk:
    """Frames first … last, inclusive; key : digest of everything that its pixels depend on."""

    first: int
    last: int
    key: str

    def path(self, folder: Path, suffix: str) -> Path:
        return folder / f"{self.first:06d}-{self.last:06d}.{self.key}{suffix}"

    @property
    def frames(self) -> int:
        return self.last - self.first + 1


def borders(frames: int) -> list[tuple[int, int]]:
    """(first, last) of each chunk: about WANTED of them, between SHORTEST and LONGEST frames each."""
    length = min(max(-(-frames // WANTED), SHORTEST), LONGEST)
    return [(a, min(a + length, frames) - 1) for a in range(0, frames, length)]
