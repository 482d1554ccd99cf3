"""TOML and command-line settings to a typed job. Every error names file, line and what would be right, all at once.

`load` receives the table of stages as an argument, so that config imports no stage.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from arfx.config.locate import KeyPath, pointed
from arfx.config.sections import JobConfig
from arfx.core.opener import parse_toml, read_text
from arfx.errors import ConfigError

_PATHS: tuple[KeyPath, ...] = (
    ("input", "clip"),
    ("input", "camera"),
    ("input", "marker_map"),
    ("input", "depth"),
    ("input", "poses"),
    ("model", "file"),
    ("light", "environment"),
    ("output", "path"),
    ("pipeline", "tradeoff"),
)


_LARGEST = 1e9  # of any setting of a stage: far beyond each one's own range
_MOST_PARTS = 8  # of a --set key: settings have two


def load(file: Path | None, overrides: Mapping[str, Any], parameters: Mapping[str, type]) -> JobConfig:
    """Read a job.

    file : job file or None;  overrides : nested mapping from the command line, which wins
    parameters : section name -> frozen dataclass, for every stage and for "analyse"

    Raises ConfigError holding every problem found; InputError if the file cannot be read.
    """
    text, document = _read(file)
    base = file.parent if file else Path()
    for section, key in _PATHS:
        table = document.get(str(section))
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(base / table[key])
    merged = merge(document, overrides)
    problems: list[str] = []

    def problem(path: KeyPath, message: str, hint: str = "") -> None:
        if _reaches(overrides, path) or file is None:
            dotted = ".".join(map(str, path))
            problems.append(f"{message}\n  --> command line: {dotted}" + (f"\nhelp: {hint}" if hint else ""))
        else:
            problems.append(pointed(message, str(file), text, path, hint))

    sections = {k for k in JobConfig.model_fields if k not in ("params", "sources")}
    params: dict[str, Any] = {}
    for name in merged:
        if name not in sections and name not in parameters:
            problem((name,), f"there is no section or stage {name!r}", near(name, [*sections, *parameters]))
    for name, kind in parameters.items():
        table = merged.get(name, {})
        if not isinstance(table, dict):
            problem((name,), f"{name!r} must be a table")
            continue
        params[name] = _params(name, kind, table, problem)
    job = None
    try:
        own = {"params": params, "sources": () if file is None else (file,)}
        job = JobConfig.model_validate({**{k: merged[k] for k in sections if k in merged}, **own})
    except ValidationError as e:
        for error in e.errors(include_url=False):
            path = tuple(p for p in error["loc"] if not _is_type_tag(p))
            known = _known_keys(path)
            if error["type"] == "extra_forbidden" and known:
                problem(path, f"section {path[0]!r} has no setting {path[-1]!r}", near(str(path[-1]), known))
            else:
                problem(path, f"{'.'.join(map(str, path))}: {_plain(error['msg'])}")
    if problems:
        raise ConfigError("\n\n".join(dict.fromkeys(problems)))
    assert job is not None
    return job


def _read(file: Path | None) -> tuple[str, dict[str, Any]]:
    if file is None:
        return "", {}
    text = read_text(file, "job file")
    try:
        return text, parse_toml(text)
    except ValueError as e:
        raise ConfigError(f"{file}: not valid TOML: {e}") from None


def _params(name: str, kind: type, table: dict[str, Any], problem: Any) -> Any:
    fields = {f.name for f in dataclasses.fields(kind)}
    good = {}
    for key, value in table.items():
        if key not in fields:
            problem((name, key), f"{_noun(name)} has no setting {key!r}", near(key, fields))
        elif (bad := _absurd(value)) is not None:
            problem((name, key), f"{name}.{key}: {bad:g} is no number to work with", f"between -{_LARGEST:g} and {_LARGEST:g}")
        else:
            good[key] = value
    try:
        # rebuilt even without settings: a dataclass may check itself in __post_init__
        return TypeAdapter(kind).validate_python(good)
    except ValidationError as e:
        for error in e.errors(include_url=False):
            key = str(error["loc"][0]) if error["loc"] else ""
            problem((name, key), f"{name}.{key}: {_plain(error['msg'])}")
    except ConfigError as e:
        named = next((k for k in good if re.search(rf"\b{re.escape(k)}\b", e.message)), None)
        problem((name,) if named is None else (name, named), str(e))
    return None


def _absurd(value: Any) -> float | None:
    """The first number of a value that is not finite or too large for any setting."""
    if isinstance(value, (list, tuple)):
        return next((bad for bad in map(_absurd, value) if bad is not None), None)
    if isinstance(value, (int, float)) and not abs(value) <= _LARGEST:
        return float(value)
    return None


def _noun(name: str) -> str:
    return "section 'analyse'" if name == "analyse" else f"stage {name!r}"


def _plain(message: str) -> str:
    return message.removeprefix("Value error, ")


def _is_type_tag(part: Any) -> bool:
    return isinstance(part, str) and ("[" in part or part in ("constrained-str", "function-before"))


def _known_keys(path: KeyPath) -> list[str]:
    field = JobConfig.model_fields.get(str(path[0]))
    kind = field.annotation if field else None
    kind = getattr(kind, "__args__", (kind,))[0]
    return list(getattr(kind, "model_fields", {}))


def near(name: str, known: Any) -> str:
    """'did you mean …?' or the list of what is known."""
    hit = difflib.get_close_matches(str(name), list(known), 1)
    return f"did you mean {hit[0]!r}?" if hit else "known: " + ", ".join(sorted(known))


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested merge; `over` wins; lists are replaced."""
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merge(out[key], value) if both else value
    return out


def _reaches(tree: Any, path: KeyPath) -> bool:
    for key in path:
        if isinstance(tree, Mapping) and key in tree:
            tree = tree[key]
        else:
            return isinstance(tree, (list, tuple))
    return True


def parse_setting(text: str) -> tuple[list[str], Any]:
    """`--set raster.backend=rays` to (["raster", "backend"], "rays"). Values are TOML where they parse as it, else text.

    Raises ConfigError.
    """
    key, equals, value = text.partition("=")
    parts = [p.strip() for p in key.split(".")]
    if not equals or len(parts) < 2 or not all(parts):
        raise ConfigError(f"--set {_short(text)!r} is not STAGE.KEY=VALUE", "for example --set output.crf=20")
    if len(parts) > _MOST_PARTS:
        raise ConfigError(f"--set {_short(text)!r}: a key of {len(parts)} parts", "STAGE.KEY=VALUE")
    try:
        return parts, parse_toml(f"x = {value.strip()}")["x"]
    except tomllib.TOMLDecodeError:
        return parts, value.strip()
    except ValueError as e:
        raise ConfigError(f"--set {_short(text)}: {e}") from None


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:80]}…"


def put_setting(tree: dict[str, Any], parts: Sequence[str], value: Any, words: str) -> None:
    """Put a value into nested tables. words : what gave it, for the error. Raises ConfigError where the way is barred."""
    at = tree
    for part in parts[:-1]:
        at = at.setdefault(part, {})
        if not isinstance(at, dict):
            raise ConfigError(f"{words}: {part!r} was given a value of its own, it has no keys", "give one of them")
    if isinstance(at.get(parts[-1]), dict):
        raise ConfigError(f"{words}: keys of {parts[-1]!r} were given values already", "give one of them")
    at[parts[-1]] = value


def same_value(path: Sequence[str], a: Any, b: Any) -> bool:
    """Whether two ways to write a value of a job's key mean the same: 15cm and 0.15m, [0, 0, 90] and [0.0, 0.0, 90.0]."""
    section, *keys = path
    if len(keys) != 1:
        return bool(a == b)
    try:
        read = [getattr(getattr(JobConfig.model_validate({section: {keys[0]: v}}), section), keys[0]) for v in (a, b)]
    except (ValidationError, AttributeError):
        return str(a) == str(b)  # what is wrong with them is said when the whole job is read
    return bool(read[0] == read[1])
