"""How many parts and faces a model may have: held before anything is made of it."""

from __future__ import annotations

import re
from pathlib import Path

from arfx.errors import InputError

# Of all instances together: 1.5 GB while the edges are looked for.
MAX_FACES = 5_000_000
# Mesh instances: each is a part with a transform of its own, a hundred parts take a second.
MAX_PARTS = 10_000
_FACES_OF = {
    "ply": rb"\belement\s+face\s+(\d+)",
    "off": rb"OFF\s+(?:#[^\n]*\s+)*\d+\s+(\d+)",
}


def check_faces(count: int, path: Path) -> None:
    """Raises InputError."""
    if count > MAX_FACES:
        raise InputError(
            f"model {path} has {count} faces", f"at most {MAX_FACES}: simplify it first"
        )


def check_parts(count: int, path: Path) -> None:
    """Raises InputError."""
    if count > MAX_PARTS:
        raise InputError(
            f"model {path} has {count} parts or materials",
            f"at most {MAX_PARTS}: join them first",
        )


def stated_faces(data: bytes, kind: str) -> int:
    """As the file's beginning says; counted where it says nothing."""
    if kind == "stl":
        declared = int.from_bytes(data[80:84], "little")
        return declared if len(data) >= 84 + 50 * declared else data.count(b"endfacet")
    found = re.search(_FACES_OF[kind], data[:65536]) if kind in _FACES_OF else None
    return int(found[1][:18]) if found else 0
