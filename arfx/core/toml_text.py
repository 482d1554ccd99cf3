"""TOML as text: written from nested tables, and where a key stands in it."""

import json
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

KeyPath = tuple[str | int, ...]


def to_toml(tree: Mapping[str, Any], prefix: str = "") -> str:
    """TOML text of nested plain data (strings, numbers, booleans, lists of those, tables,
    lists of tables).
    """
    lines, tables = [], []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            tables.append(f"\n[{prefix}{key}]\n{to_toml(value, f'{prefix}{key}.')}")
        elif isinstance(value, list) and any(isinstance(v, Mapping) for v in value):
            tables += [
                f"\n[[{prefix}{key}]]\n{to_toml(v, f'{prefix}{key}.')}" for v in value
            ]
        else:
            lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
    return "\n".join([*lines, *tables])


def line_of(text: str, path: KeyPath) -> int:
    """1-based line of a key path such as ("marker", 1, "spec"); its nearest written parent,
    or 0 if none. Knows tables, arrays of tables and dotted keys, which is what job files
    hold; a key inside an inline table is found at the line of that table."""
    lines = _key_lines(text)
    return next(
        (lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), 0
    )


@lru_cache(maxsize=4)  # a manifest is asked for every row that is wrong
def _key_lines(text: str) -> dict[KeyPath, int]:
    """Key path -> the line where it is written first."""
    prefix: KeyPath = ()
    seen: dict[KeyPath, int] = {}
    found: dict[KeyPath, int] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        m = re.match(
            r"(?P<array>\[?)(?P<table>\[)\s*([^\]]+?)\s*\]|([\w\-.\"']+)\s*=",
            raw.strip(),
        )
        if not m:
            continue
        name = tuple(p.strip(" \"'") for p in (m[3] or m[4]).split("."))
        if m["array"]:
            name = (*_numbered(name[:-1], seen), name[-1])
            seen[name] = seen.get(name, -1) + 1
            prefix = here = (*name, seen[name])
        elif m["table"]:
            prefix = here = _numbered(name, seen)
        else:
            here = (*prefix, *name)
        found.setdefault(here, number)
    return found


def _numbered(name: KeyPath, seen: Mapping[KeyPath, int]) -> KeyPath:
    """The key path of a table: within an array of tables it belongs to the last of them.
    seen : of each array, by its path
    """
    out: KeyPath = ()
    for key in name:
        out = (*out, key)
        if out in seen:
            out = (*out, seen[out])
    return out
