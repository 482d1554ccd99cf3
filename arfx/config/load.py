"""TOML and command-line settings to a typed job. Every error names file, line and what would be right, all at once.

`load` receives the table of stages as an argument, so that config imports no stage.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from pydantic import TypeAdapter, ValidationError

from arfx.config.locate import KeyPath, pointed
from arfx.config.sections import JobConfig, kinds, settings
from arfx.core.opener import parse_toml, read_text
from arfx.errors import ConfigError

Parameters = Mapping[str, Mapping[str, type]]
_TYPE_TAGS = ("constrained-str", "function-before")  # parts of pydantic's places that are no keys
_LARGEST = 1e9  # of any setting of a stage: far beyond each one's own range


class _JobFile(NamedTuple):
    path: Path
    text: str
    document: dict[str, Any]


def load(files: Path | Sequence[Path] | None, overrides: Mapping[str, Any], parameters: Parameters) -> JobConfig:
    """Read a job.

    files : job file or several; key by key the later wins;  overrides : nested mapping from the command line, which wins over all
    parameters : section name -> formula -> frozen dataclass, for every stage and for "analyse"; the usual formula first

    Raises ConfigError holding every problem found; InputError if a file cannot be read.
    """
    paths = [files] if isinstance(files, Path) else files or ()
    read = [_read(path, parameters) for path in paths]
    merged: dict[str, Any] = {}
    for tree in (*(file.document for file in read), overrides):
        merged = merge(merged, tree)
    problems: list[str] = []

    def problem(path: KeyPath, message: str, hint: str = "") -> None:
        if _reaches(overrides, path) or not read:
            dotted = ".".join(map(str, path))
            problems.append(f"{message}\n  --> command line: {dotted}" + (f"\nhelp: {hint}" if hint else ""))
        else:
            file = _origin(read, path)
            problems.append(pointed(message, str(file.path), file.text, path, hint))

    sections = {s.section for s in settings()}
    params: dict[str, Any] = {}
    for name in merged:
        if name not in sections and name not in parameters:
            problem((name,), f"there is no section or stage {name!r}", near(name, [*sections, *parameters]))
    for name, formulas in parameters.items():
        table = merged.get(name, {})
        if not isinstance(table, dict):
            problem((name,), f"{name!r} must be a table")
            continue
        params[name] = _params(name, formulas, table, problem)
    job = None
    try:
        own = {"params": params, "sources": tuple(paths)}
        job = JobConfig.model_validate({**{k: merged[k] for k in sections if k in merged}, **own})
    except ValidationError as e:
        for error in e.errors(include_url=False):
            path = tuple(p for p in error["loc"] if not (isinstance(p, str) and ("[" in p or p in _TYPE_TAGS)))
            known = [s.key for s in settings() if s.section == path[0]]
            if error["type"] == "extra_forbidden" and known:
                problem(path, f"section {path[0]!r} has no setting {path[-1]!r}", near(str(path[-1]), known))
            else:
                problem(path, f"{'.'.join(map(str, path))}: {_plain(error['msg'])}")
    if problems:
        raise ConfigError("\n\n".join(dict.fromkeys(problems)))
    assert job is not None
    return job


def _read(file: Path, parameters: Parameters) -> _JobFile:
    """A job file with its paths as they are from here."""
    text = read_text(file, "job file")
    try:
        document = parse_toml(text)
    except ValueError as e:
        raise ConfigError(f"{file}: not valid TOML: {e}") from None
    for section, key in _paths(parameters):
        table = document.get(section)
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(file.parent / table[key])
    return _JobFile(file, text, document)


def _origin(files: Sequence[_JobFile], path: KeyPath) -> _JobFile:
    """The file from which a key was taken: the last that holds it, or else its nearest parent."""
    return next(f for n in range(len(path), -1, -1) for f in reversed(files) if _reaches(f.document, path[:n]))


def _paths(parameters: Parameters) -> set[tuple[str, str]]:
    """(section, key) of the settings that are paths: in a job file they are relative to it."""
    made = ((name, kind) for name, formulas in parameters.items() for kind in formulas.values())
    hints = ((name, key, hint) for name, kind in made for key, hint in get_type_hints(kind).items())
    typed = [*((s.section, s.key, s.kinds) for s in settings()), *((name, key, kinds(hint)) for name, key, hint in hints)]
    return {(section, key) for section, key, made_of in typed if Path in made_of}


def _params(name: str, formulas: Mapping[str, type], table: dict[str, Any], problem: Any) -> Any:
    formula = next(iter(formulas))
    if len(formulas) > 1 and "formula" in table:
        formula = (table := dict(table)).pop("formula")
        if formula not in list(formulas):
            return problem((name, "formula"), f"{name}.formula {formula!r} is unknown", "one of " + ", ".join(formulas))
    kind = formulas[formula]
    fields, good = _fields(kind), {}
    for key, value in table.items():
        if key not in fields:
            other = next((f for f, k in formulas.items() if key in _fields(k)), None)
            if other is None:
                owner = "section 'analyse'" if name == "analyse" else f"stage {name!r}"
                problem((name, key), f"{owner} has no setting {key!r}", near(key, fields))
            else:
                problem((name, key), f'{name}.{key} belongs to formula = "{other}"', f'{name}.formula is "{formula}"')
        elif (bad := _absurd(value)) is not None:
            problem((name, key), f"{name}.{key}: {bad:g} is out of range", f"between -{_LARGEST:g} and {_LARGEST:g}")
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


def _fields(kind: type) -> set[str]:
    """Settings that can be given. That of the formula says which class it is."""
    return {f.name for f in dataclasses.fields(kind) if f.init}


def _absurd(value: Any) -> float | None:
    """The first number of a value that is not finite or too large for any setting."""
    if isinstance(value, (list, tuple)):
        return next((bad for bad in map(_absurd, value) if bad is not None), None)
    if isinstance(value, (int, float)) and not abs(value) <= _LARGEST:
        return float(value)
    return None


def _plain(message: str) -> str:
    return message.removeprefix("Value error, ")


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
