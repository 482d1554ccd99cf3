"""Facts as a file: JSON lines. The first holds what is true for the whole clip, then one line per frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arfx.analyse.records import Analysis
from arfx.core.facts import FrameFacts
from arfx.core.guard import aside
from arfx.core.pose import Pose, find_rotvecs
from arfx.errors import InputError

FORMAT = "arfx-facts"
VERSION = 2


def write_facts(path: Path | str, facts: Sequence[FrameFacts], analysis: Analysis | None = None) -> None:
    """Write atomically. analysis : gives the header's map, static, summary and notices; its own facts are not used."""
    path = Path(path)
    header: dict[str, Any] = {"format": FORMAT, "version": VERSION, "frames": len(facts)}
    if analysis is not None:
        header |= {
            "world_from_marker": {k: p.to_json() for k, p in analysis.world_from_marker.items()},
            "static": analysis.static, "summary": analysis.summary, "notices": list(analysis.notices),
        }  # fmt: skip
    find_rotvecs(p for f in facts for p in f.poses)
    with aside(path) as part, part.open("w", encoding="utf-8") as f:
        for line in (header, *(x.to_json() for x in facts)):
            f.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")


def read_facts(path: Path | str) -> tuple[FrameFacts, ...]:
    """All frames of a facts file. Raises InputError for a file of another kind or one that is cut short."""
    return _read(Path(path))[1]


def read_analysis(path: Path | str) -> Analysis:
    """The whole Analysis that write_facts was given. Raises InputError."""
    header, facts = _read(Path(path))
    if "static" not in header:
        raise InputError(f"{path}: the header holds no analysis", "written without one; read_facts reads its frames")
    poses = {k: Pose.from_json(v) for k, v in header["world_from_marker"].items()}
    return Analysis(facts, poses, header["static"], header["summary"], tuple(header["notices"]))


def _read(path: Path) -> tuple[dict[str, Any], tuple[FrameFacts, ...]]:
    line = 0
    try:
        rows = path.read_text(encoding="utf-8").splitlines()
        header = json.loads(rows[0]) if rows else {}
        if not isinstance(header, dict) or header.get("format") != FORMAT or header.get("version") != VERSION:
            raise InputError(f"{path} is no facts file of version {VERSION}", "analyse the clip again")
        facts = []
        for line, row in enumerate(rows[1:], 2):  # noqa: B007 - named in the message below
            facts.append(FrameFacts.from_json(json.loads(row)))
    except (json.JSONDecodeError, KeyError, IndexError, TypeError, UnicodeDecodeError) as e:
        raise InputError(f"{path}:{line}: not a frame's facts ({e})", "analyse the clip again") from e
    if len(facts) != header["frames"]:
        raise InputError(f"{path} holds {len(facts)} frames of {header['frames']}", "it was cut short: analyse the clip again")
    return header, tuple(facts)
