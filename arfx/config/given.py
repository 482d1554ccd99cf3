"""What the command line gives a job, options and --set, as the nested tables of a job file."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from operator import getitem
from typing import Any

from pydantic import ValidationError

from arfx.config.sections import JobConfig, Setting, settings
from arfx.core.opener import parse_toml
from arfx.errors import ConfigError

Given = tuple[
    tuple[str, ...], Any, str
]  # key path in a job file, value, and the words that gave it


def overrides(options: Iterable[Given], texts: Sequence[str]) -> dict[str, Any]:
    """All of it as one tree. texts : of --set
    Raises ConfigError naming the words, also for an option and a --set that give one key
    different values."""
    tree: dict[str, Any] = {}
    said: dict[tuple[str, ...], str] = {}
    for text in texts:
        (section, key), value = parse_setting(text)
        tree.setdefault(section, {})[key] = value
        said[section, key] = f"--set {text}"
    for path, value, words in options:
        others = [text for key, text in said.items() if key[: len(path)] == path]
        if others and _meaning(path, value) != _meaning(
            path, reduce(getitem, path, tree)
        ):
            raise ConfigError(
                f"{words} and {others[-1]} give different values to {'.'.join(path)}",
                "give one of them",
            )
        table = tree if len(path) == 1 else tree.setdefault(path[0], {})
        table[path[-1]] = value
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


def parse_setting(text: str) -> tuple[tuple[str, str], Any]:
    """`--set raster.backend=rays` to (("raster", "backend"), "rays"). Values are TOML where
    they parse as it, else text. Raises ConfigError."""
    key, equals, value = text.partition("=")
    section, *rest = [part.strip() for part in key.split(".")]
    if not (equals and section and len(rest) == 1 and rest[0]):
        raise ConfigError(
            f"--set {_short(text)!r} is not STAGE.KEY=VALUE",
            "for example --set output.crf=20",
        )
    return (section, rest[0]), parse_value(value, f"--set {_short(text)}")


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


def _meaning(path: tuple[str, ...], value: Any) -> Any:
    """Equal for two ways to write a value of a job's key: 15cm and 0.15m."""
    tree = value
    for key in reversed(path):
        tree = {key: tree}
    try:
        return JobConfig.model_validate(tree)
    except ValidationError:
        return str(value)  # errors in it are reported when the whole job is read
