"""What the command line gives a job, options and --set, as the nested tables of a job file."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, get_origin

from pydantic import ValidationError

from arfx.config.sections import JobConfig, Setting, Turn, settings
from arfx.core.opener import parse_toml
from arfx.errors import ConfigError

Given = tuple[
    Sequence[str], Any, str
]  # key path in a job file, value, and the words that gave it

_MOST_PARTS = 8  # of a --set key: settings have two


def overrides(options: Iterable[Given], texts: Sequence[str]) -> dict[str, Any]:
    """All of it as one tree. texts : of --set
    Raises ConfigError naming the words, also for an option and a --set that give one key
    different values."""
    tree: dict[str, Any] = {}
    others: list[Given] = [(*parse_setting(text), f"--set {text}") for text in texts]
    for path, value, words in others:
        _set_value(tree, path, value, words)
    for path, value, words in options:
        _check_conflicts(path, value, words, others)
        _set_value(tree, path, value, words)
    return tree


def section_overrides(given: Mapping[str, Any]) -> Iterator[Given]:
    """The settings of a job's sections that have an option. given : by the option's name;
    None, False and () are not given. Raises ConfigError."""
    for s in settings():
        value = given[s.name] if s.flags else None
        if value is None or value is False or value == ():
            continue
        if s.repeated:
            yield *option_given(s, value), " ".join(f"{s.flags[0]} {v}" for v in value)
        elif value or list[str] not in s.kinds:  # an empty list of effects is not given
            yield (
                *option_given(s, value),
                s.flags[0] if value is True else f"{s.flags[0]} {value}",
            )


def option_given(s: Setting, value: Any) -> tuple[tuple[str, ...], Any]:
    """Key path and value, in a job's tables, of what an option gives. value : a list where
    the option is repeatable Raises ConfigError."""
    if s.repeated:
        return (s.section,), [{s.key: v} for v in value]
    return (s.section, s.key), not s.default if value is True else _read(s, value)


def _read(s: Setting, value: Any) -> Any:
    """Lists as they are written after an option."""
    if not isinstance(value, str):
        return value
    if list[str] in s.kinds:
        names = [n.strip() for n in value.split(",") if n.strip()]
        return "auto" if names == ["auto"] else names
    if get_origin(s.kinds[0]) is not tuple:
        return value
    three = [p.strip() for p in value.split(",")]
    if len(three) != 3:
        raise ConfigError(
            f"{s.flags[0]} {value!r} is not three values", "X,Y,Z with commas"
        )
    for part in three if Turn in s.kinds else ():
        try:
            float(part)
        except ValueError:
            raise ConfigError(
                f"{s.flags[0]}: {part!r} is not a number of degrees"
            ) from None
    return [float(part) for part in three] if Turn in s.kinds else three


def parse_setting(text: str) -> tuple[list[str], Any]:
    """`--set raster.backend=rays` to (["raster", "backend"], "rays"). Values are TOML where
    they parse as it, else text. Raises ConfigError."""
    key, equals, value = text.partition("=")
    parts = [p.strip() for p in key.split(".")]
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


def _set_value(tree: dict[str, Any], path: Sequence[str], value: Any, words: str) -> None:
    """Put a value into nested tables. Raises ConfigError where the way is barred."""
    at = tree
    for part in path[:-1]:
        at = at.setdefault(part, {})
        if not isinstance(at, dict):
            raise ConfigError(
                f"{words}: {part!r} was given a value of its own, it has no keys",
                "give one of them",
            )
    if isinstance(at.get(path[-1]), dict):
        raise ConfigError(
            f"{words}: keys of {path[-1]!r} were given values already", "give one of them"
        )
    at[path[-1]] = value


def _check_conflicts(
    path: Sequence[str], value: Any, words: str, others: Sequence[Given]
) -> None:
    """Refuse a --set that gives another value to the key that an option gives: one of them
    would be lost unsaid.
    """
    for other_path, other, other_words in reversed(
        others
    ):  # of several --set the last one counts
        common = min(len(path), len(other_path))
        if tuple(other_path[:common]) != tuple(path[:common]):
            continue
        if len(other_path) != len(path) or not _equivalent(path, value, other):
            raise ConfigError(
                f"{words} and {other_words} give different values to {'.'.join(path)}",
                "give one of them",
            )
        return


def _equivalent(path: Sequence[str], a: Any, b: Any) -> bool:
    """Whether two ways to write a value of a job's key mean the same: 15cm and 0.15m, [0,
    0, 90] and [0.0, 0.0, 90.0].
    """
    section, *keys = path
    if len(keys) != 1:
        return bool(a == b)
    try:
        read = [
            getattr(
                getattr(JobConfig.model_validate({section: {keys[0]: v}}), section), keys[0]
            )
            for v in (a, b)
        ]
    except (ValidationError, AttributeError):
        return str(a) == str(b)  # errors in them are reported when the whole job is read
    return bool(read[0] == read[1])
