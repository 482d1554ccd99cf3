"""TOML and command-line settings to a typed job. Every error names file, line and what
would be right, all at once.

`load` receives the table of stages as an argument, so that config imports no stage."""

from __future__ import annotations

import dataclasses
import difflib
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from pydantic import TypeAdapter, ValidationError

from arfx.config.gone import GONE
from arfx.config.sections import JobConfig, kinds, settings
from arfx.core.marker import PatternSpec
from arfx.core.opener import parse_toml, read_text
from arfx.core.toml_text import KeyPath, line_of
from arfx.errors import ConfigError, InputError

Parameters = Mapping[str, Mapping[str, type]]
_PRESETS = (
    Path(__file__).parent / "presets",
    Path(__file__).parents[2] / "configs",
)  # in a wheel, in the source tree
_TYPE_TAGS = (
    "constrained-str",
    "function-before",
)  # parts of pydantic's places that are no keys
_adapter = cache(TypeAdapter)
_LARGEST = 1e9  # of any setting of a stage: far beyond each one's own range


class JobFile(NamedTuple):
    """Settings that a file gives. document : the tables of a job file, with paths as they
    are from here
    at : key path of these in the file's text
    line : of a table's row, in which all of them stand; 0 = found by key"""

    path: Path
    text: str
    document: dict[str, Any]
    at: KeyPath = ()
    line: int = 0

    def located(self, message: str, path: KeyPath, hint: str = "") -> str:
        """The message with file, line and key."""
        line = self.line or line_of(self.text, (*self.at, *path))
        place = f":{line}" if line else f": {'.'.join(map(str, path))}"
        return f"{message}\n  --> {self.path}{place}" + (f"\nhelp: {hint}" if hint else "")


def load(
    files: Path | Sequence[Path | JobFile] | None,
    overrides: Mapping[str, Any],
    parameters: Parameters,
) -> JobConfig:
    """Read a job.
    files : job file or several; key by key the later wins;  overrides : nested mapping from
    the command line, which wins over all
    parameters : section name -> formula -> frozen dataclass, for every stage and for
    "analyse"; the usual formula first
    Raises ConfigError holding every problem found; InputError if a file cannot be read."""
    named = [files] if isinstance(files, Path) else files or ()
    read = [
        file if isinstance(file, JobFile) else read_job_file(file, parameters)
        for file in named
    ]
    sources = tuple(dict.fromkeys(file.path for file in read))
    read.append(JobFile(Path("command line"), "", dict(overrides)))
    merged: dict[str, Any] = {}
    for file in read:
        merged = merge(merged, file.document)
    problems: list[str] = []

    def problem(path: KeyPath, message: str, hint: str = "") -> None:
        # of the last file that holds the key, or else its nearest parent
        file = next(
            f
            for n in range(len(path), -1, -1)
            for f in reversed(read)
            if _contains(f.document, path[:n])
        )
        problems.append(file.located(message, path, hint))

    def unknown(path: KeyPath, owner: str, known: Iterable[str]) -> None:
        message = f"{owner} {path[0]!r} has no setting {path[-1]!r}"
        problem(path, message, GONE.get(path) or suggestion(str(path[-1]), known))

    def checked(kind: type, values: Mapping[str, Any], at: KeyPath = ()) -> Any:
        """The values as this type; None after telling what is wrong with them."""
        try:
            return _adapter(kind).validate_python(values)
        except ValidationError as e:
            for error in e.errors(include_url=False):
                path = (*at, *(p for p in error["loc"] if not _type_tag(p)))
                known = [s.key for s in settings() if s.section == path[0]]
                if error["type"] == "extra_forbidden" and known:
                    unknown(path, "section", known)
                else:
                    message = error["msg"].removeprefix("Value error, ")
                    problem(path, f"{'.'.join(map(str, path))}: {message}")
        except ConfigError as e:  # of a dataclass that checks itself
            named = [k for k in values if re.search(rf"\b{re.escape(k)}\b", e.message)]
            problem((*at, *named[:1]), str(e))
        return None

    def chosen(name: str, formulas: Mapping[str, type]) -> Any:
        """The settings of a stage."""
        table = merged.get(name, {})
        if not isinstance(table, dict):
            return problem((name,), f"{name!r} must be a table")
        formula = next(iter(formulas))
        if len(formulas) > 1:
            table = dict(table)
            formula = table.pop("formula", formula)
        if formula not in list(formulas):
            message = f"{name}.formula {formula!r} is unknown"
            return problem((name, "formula"), message, "one of " + ", ".join(formulas))
        good = {}
        for key, value in table.items():
            path = name, key
            owners = [f for f, kind in formulas.items() if key in _fields(kind)]
            if formula not in owners:
                if owners and path not in GONE:
                    message = f'{name}.{key} belongs to formula = "{owners[0]}"'
                    problem(path, message, f'{name}.formula is "{formula}"')
                    continue
                owner = "section" if name == "analyse" else "stage"
                unknown(path, owner, _fields(formulas[formula]))
            elif (bad := _out_of_range(value)) is not None:
                message = f"{name}.{key}: {bad:g} is out of range"
                problem(path, message, f"between -{_LARGEST:g} and {_LARGEST:g}")
            else:
                good[key] = value
        # made even without settings: a dataclass may check itself
        return checked(formulas[formula], good, (name,))

    sections = {s.section for s in settings()}
    known = [*sections, *parameters]
    for name in (name for name in merged if name not in known):
        problem((name,), f"there is no section or stage {name!r}", suggestion(name, known))
    given: dict[str, Any] = {name: merged[name] for name in sections & merged.keys()}
    given["params"] = {name: chosen(name, kinds) for name, kinds in parameters.items()}
    job = checked(JobConfig, {**given, "sources": sources})
    if problems:
        raise ConfigError("\n\n".join(dict.fromkeys(problems)))
    assert isinstance(job, JobConfig)
    return job


def read_job_file(file: Path, parameters: Parameters, kind: str = "job file") -> JobFile:
    """kind : as in `opener.LIMITS`. Raises ConfigError, InputError."""
    text = read_text(file, kind)
    try:
        document = parse_toml(text)
    except ValueError as e:
        raise ConfigError(f"{file}: not valid TOML: {e}") from None
    locate_paths(document, file.parent, parameters)
    return JobFile(file, text, document)


def locate_paths(document: Mapping[str, Any], folder: Path, parameters: Parameters) -> None:
    """Paths in a job file are relative to its folder: make them so from here."""
    for section, tables in document.items():
        keys = {s.key for s in settings() if s.section == section and _begins_path(s.kinds)}
        for kind in parameters.get(section, {}).values():
            keys |= _path_fields(kind)
        for table in tables if isinstance(tables, list) else [tables]:
            for key in keys if isinstance(table, dict) else ():
                if isinstance(table.get(key), str):
                    table[key] = str(folder / table[key])


def _begins_path(types: Collection[Any]) -> bool:
    return Path in types or PatternSpec in types


@cache
def _path_fields(kind: type) -> frozenset[str]:
    return frozenset(k for k, hint in get_type_hints(kind).items() if Path in kinds(hint))


def _type_tag(part: str | int) -> bool:
    """Whether a part of pydantic's place of an error is a type, not a key."""
    return isinstance(part, str) and ("[" in part or part in _TYPE_TAGS)


def _fields(kind: type) -> set[str]:
    """Settings that can be given. That of the formula says which class it is."""
    return {f.name for f in dataclasses.fields(kind) if f.init}


def _out_of_range(value: Any) -> float | None:
    """The first number of a value that is not finite or too large for any setting."""
    if isinstance(value, (list, tuple)):
        return next((bad for bad in map(_out_of_range, value) if bad is not None), None)
    if isinstance(value, (int, float)) and not abs(value) <= _LARGEST:
        return float(value)
    return None


def suggestion(name: str, known: Any) -> str:
    """'did you mean …?' or the list of what is known."""
    hit = _closest(str(name), tuple(known))
    return f"did you mean {hit[0]!r}?" if hit else "known: " + ", ".join(sorted(known))


@lru_cache(maxsize=64)  # a misspelt head of a table is met in every row
def _closest(name: str, known: tuple[str, ...]) -> list[str]:
    return difflib.get_close_matches(name, known, 1)


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested merge; `over` wins; lists are replaced."""
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merge(out[key], value) if both else value
    return out


def _contains(tree: Any, path: KeyPath) -> bool:
    for key in path:
        if isinstance(tree, Mapping) and key in tree:
            tree = tree[key]
        else:
            return isinstance(tree, (list, tuple))
    return True


def presets() -> dict[str, Path]:
    """Name -> file of the job presets that come with arfx."""
    place = next((p for p in _PRESETS if p.is_dir()), None)
    return {} if place is None else {p.stem: p for p in sorted(place.glob("*.toml"))}


def find_job_file(name_or_file: Path, folder: Path = Path()) -> Path:
    """A job file in a folder, or a preset by its bare name. Raises InputError naming the
    presets.
    """
    file = folder / name_or_file
    if os.path.exists(file) or file.suffix or len(name_or_file.parts) > 1:  # noqa: PTH110 - False for a name too long
        return file
    known = presets()
    if str(name_or_file) not in known:
        raise InputError(
            f"there is no job file or preset {str(name_or_file)!r}",
            suggestion(str(name_or_file), known),
        )
    return known[str(name_or_file)]
