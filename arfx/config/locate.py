"""Where in a TOML text a key stands, so that errors can point at it."""

from __future__ import annotations

import re
from collections.abc import Sequence

KeyPath = tuple[str | int, ...]


def line_of(text: str, path: KeyPath) -> int:
    """1-based line of a key path such as ("marker", 1, "spec"); its nearest written parent, or 0 if none.

    Knows tables, arrays of tables and dotted keys, which is what job files hold; a key inside an inline
    table is found at the line of that table.
    """
    prefix: list[str | int] = []
    seen: dict[KeyPath, int] = {}
    best_depth, best_line = 0, 0
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if m := re.match(r"\[\[\s*([^\]]+?)\s*\]\]", line):
            name = _parts(m[1])
            seen[name] = seen.get(name, -1) + 1
            prefix = [*name, seen[name]]
            here: KeyPath = tuple(prefix)
        elif m := re.match(r"\[\s*([^\]]+?)\s*\]", line):
            prefix = [*_parts(m[1])]
            here = tuple(prefix)
        elif m := re.match(r"([\w\-.\"']+)\s*=", line):
            here = (*prefix, *_parts(m[1]))
        else:
            continue
        if here == path[: len(here)] and len(here) > best_depth:
            best_depth, best_line = len(here), number
    return best_line


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(p.strip(" \"'") for p in dotted.split("."))


def pointed(message: str, file: str, text: str, path: KeyPath, hint: str = "") -> str:
    """The message with file:line, the line itself and carets under its key."""
    number = line_of(text, path)
    if not number:
        return f"{message}\n  --> {file}" + (f"\nhelp: {hint}" if hint else "")
    source = text.splitlines()[number - 1]
    start, length = _key_span(source, path)
    gutter = " " * len(str(number))
    shown = [
        message,
        f"{gutter} --> {file}:{number}",
        f"{gutter} |",
        f"{number} | {source}",
        f"{gutter} | {' ' * start}{'^' * length}",
    ]
    if hint:
        shown.append(f"help: {hint}")
    return "\n".join(shown)


def _key_span(source: str, path: Sequence[str | int]) -> tuple[int, int]:
    for key in reversed(path):
        if isinstance(key, str) and (m := re.search(rf"(?<![\w-]){re.escape(key)}(?![\w-])", source)):
            return m.start(), m.end() - m.start()
    stripped = source.strip()
    return len(source) - len(source.lstrip()), max(len(stripped), 1)
