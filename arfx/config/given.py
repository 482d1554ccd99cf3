"""What the command line gives a job, options and --set, as the nested tables of a job file."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from arfx.config.sections import Setting, settings
from arfx.core.opener import parse_toml
from arfx.errors import ConfigError

Given = tuple[
    Sequence[str], Any, str
]  # key path in a job file, value, and the words that gave it

_MOST_PARTS = 8  # of a --set key: settings have two


def overrides(options: Iterable[Given], texts: Sequence[str]) -> dict[str, Any]:
    """All of it as one tree. texts : of --set, of which a later one wins
    Raises ConfigError naming the words, also for an option and a --set that give one key."""
    tree: dict[str, Any] = {}
    for text in texts:
        _set_value(tree, *parse_setting(text), f"--set {text}", again=True)
    for option in options:
        _set_value(tree, *option)
    return tree


def section_overrides(given: Mapping[str, Any]) -> Iterator[Given]:
    """The settings of a job's sections that have an option. given : by the option's name;
    None, False and () are not given."""
    for s in settings():
        value = given[s.name] if s.flags else None
        if value is None or value is False or value == ():
            continue
        if value == "" and list[str] in s.kinds:  # an empty list of effects
            continue
        flag, values = s.flags[0], value if s.repeated else [value]
        words = " ".join(flag if v is True else f"{flag} {v}" for v in values)
        yield *option_given(s, value), words


def option_given(s: Setting, value: Any) -> tuple[tuple[str, ...], Any]:
    """Key path and value, in a job's tables, of what an option gives. value : a list where
    the option is repeatable"""
    if s.repeated:
        return (s.section,), [{s.key: v} for v in value]
    return (s.section, s.key), not s.default if value is True else value


def parse_setting(text: str) -> tuple[list[str], Any]:
    """`--set raster.backend=rays` to (["raster", "backend"], "rays"). Values are TOML where
    they parse as it, else text. Raises ConfigError."""
    key, equals, value = text.partition("=")
    parts = [p.strip() for p in key.split(".")]
    if not equals or not all(parts) or not 2 <= len(parts) <= _MOST_PARTS:
        raise ConfigError(
            f"--set {_short(text)!r} is not STAGE.KEY=VALUE",
            "for example --set output.crf=20",
        )
    return parts, parse_value(value, f"--set {_short(text)}")


def parse_value(text: str, words: str) -> Any:
    """TOML where it parses as it, else text. words : that gave it. Raises ConfigError."""
    try:
        return parse_toml(f"x = {text.strip()}")["x"]
    except tomllib.TOMLDecodeError:
        return text.strip()
    except ValueError as e:
        raise ConfigError(f"{words}: {e}") from None


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:80]}…"


def _set_value(
    tree: dict[str, Any],
    path: Sequence[str],
    value: Any,
    words: str,
    again: bool = False,
) -> None:
    """Put a value into nested tables. Raises ConfigError where there is one, or a table.

    again : it may take another's place, but no table's
    """
    *tables, last = path
    at: Any = tree
    for table in tables:
        at = at.setdefault(table, {}) if isinstance(at, dict) else at
    if (
        not isinstance(at, dict)
        or isinstance(at.get(last), dict)
        or (last in at and not again)
    ):
        raise ConfigError(
            f"{words}: a --set gives {'.'.join(path)}, or a part of it, already",
            "give one of them",
        )
    at[last] = value
