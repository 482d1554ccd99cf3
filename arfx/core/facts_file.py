"""Facts as a file: JSON lines. The first says what the file is, then one line per frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from arfx.core.facts import FrameFacts
from arfx.core.guard import aside
from arfx.core.pose import find_rotvecs
from arfx.errors import InputError

FORMAT = "arfx-facts"
VERSION = 3


def write_facts(path: Path | str, facts: Sequence[FrameFacts]) -> None:
    """Write atomically."""
    path = Path(path)
    header = {"format": FORMAT, "version": VERSION, "frames": len(facts)}
    find_rotvecs(p for f in facts for p in f.poses)
    with aside(path) as part, part.open("w", encoding="utf-8") as f:
        for line in (header, *(x.to_json() for x in facts)):
            f.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")


def read_facts(path: Path | str) -> tuple[FrameFacts, ...]:
    """All frames of a facts file. Raises InputError for a file of another kind or one that is cut short."""
    path = Path(path)
    line = 0
    try:
        rows = path.read_text(encoding="utf-8").splitlines()
        header = json.loads(rows[0]) if rows else {}
        if not isinstance(header, dict) or header.get("format") != FORMAT or header.get("version") != VERSION:
            raise InputError(f"{path} is no facts file of version {VERSION}", "analyse the clip again")
        facts = []
        for line, row in enumerate(rows[1:], 2):  # noqa: B007 - named in the message below
            facts.append(FrameFacts.from_json(json.loads(row)))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as e:
        raise InputError(f"{path}:{line}: not a frame's facts ({e})", "analyse the clip again") from e
    if len(facts) != header["frames"]:
        raise InputError(f"{path} holds {len(facts)} frames of {header['frames']}", "it was cut short: analyse the clip again")
    return tuple(facts)
