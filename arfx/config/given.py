"""What the command line gives a job, options and --set, as the nested tables of a job file."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from arfx.config.sections import Setting, settings
from arfx.core.opener import parse_toml
from arfx.errors import ConfigError

KeyPath = tuple[str, ...]
Given = tuple[KeyPath, Any, str]  # and value, and the words that gave it

_MOST_PARTS = 8  # of a --set key: settings have two


def overrides(options: Iterable[Given], texts: Sequence[str]) -> dict[str, Any]:
    """All of it as one tree. texts : of --set
    Raises ConfigError naming the words, also for an option and a --set that give one key."""
    tree: dict[str, Any] = {}
    said: dict[KeyPath, str] = {}
    for text in texts:
        path, value = parse_setting(text)
        said[path] = f"--set {text}"
        _set_value(tree, path, value, said[path])
    for path, value, words in options:
        for other, text in said.items():
            if all(map(str.__eq__, path, other)):  # one holds the other
                raise ConfigError(
                    f"{words} and {text} both give {'.'.join(path)}",
                    "give one of them",
                )
        _set_value(tree, path, value, words)
    return tree


def section_overrides(given: Mapping[str, Any]) -> Iterator[Given]:
    """The settings of a job's sections that have an option. given : by the option's name;
    None, False and () are not given."""
    for s in settings():
        value = given[s.name]
        if value is None or value is False or value == ():
            continue
        if value == "" and list[str] in s.kinds:  # an empty list of effects
            continue
        flag, values = s.flags[0], value if s.repeated else [value]
        words = " ".join(flag if v is True else f"{flag} {v}" for v in values)
        yield *option_given(s, value), words


def option_given(s: Setting, value: Any) -> tuple[KeyPath, Any]:
    """Key path and value, in a job's tables, of what an option gives. value : a list where
    the option is repeatable"""
    if s.repeated:
        return (s.section,), [{s.key: v} for v in value]
    return (s.section, s.key), not s.default if value is True else value


def parse_setting(text: str) -> tuple[KeyPath, Any]:
    """`--set raster.backend=rays` to (("raster", "backend"), "rays"). Values are TOML where
    they parse as it, else text. Raises ConfigError."""
    key, equals, value = text.partition("=")
    parts = tuple(p.strip() for p in key.split("."))
    if not equals or len(parts) < 2 or not all(parts):
        raise ConfigError(
            f"--set {_short(text)!r} is not STAGE.KEY=VALUE",
            "for example --set output.crf=20",
        )
    if len(parts) > _MOST_PARTS:
        raise ConfigError(
            f"--set {_short(text)!r}: a key of {len(parts)} parts", "STAGE.KEY=VALUE"
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


def _set_value(tree: dict[str, Any], path: KeyPath, value: Any, words: str) -> None:
    """Put a value into nested tables. Raises ConfigError where the way is barred."""
    at: Any = tree
    for part in path[:-1]:
        at = at.setdefault(part, {})
        if not isinstance(at, dict):
            raise ConfigError(
                f"{words}: {part!r} was given a value of its own, it has no keys",
                "give one of them",
            )
    if isinstance(at.get(path[-1]), dict):
        raise ConfigError(
            f"{words}: keys of {path[-1]!r} were given values already",
            "give one of them",
        )
    at[path[-1]] = value
