"""TOML and command-line settings to a typed job. Every error names file, line and what
would be right, all at once.

`load` receives the table of stages as an argument, so that config imports no stage."""

import difflib
import os
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache, reduce
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from pydantic import Field, ValidationError, create_model

from arfx.config.sections import JobConfig, kinds, section_models
from arfx.core.marker import PatternSpec
from arfx.core.opener import parse_toml, read_text
from arfx.core.toml_text import KeyPath, line_of
from arfx.errors import ConfigError, InputError

# section -> setting that is gone -> what to write instead
GONE = tomllib.loads(Path(__file__).with_name("gone.toml").read_text("utf-8"))
Parameters = Mapping[str, Mapping[str, Any]]
_PRESETS = (
    Path(__file__).parent / "presets",
    Path(__file__).parents[2] / "configs",
)  # in a wheel, in the source tree


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
        return f"{message}\n  --> {self.path}{place}" + (
            f"\nhelp: {hint}" if hint else ""
        )


def load(
    files: Path | Sequence[Path | JobFile] | None,
    overrides: Mapping[str, Any],
    parameters: Parameters,
    broken: Mapping[str, ConfigError] = MappingProxyType({}),
) -> JobConfig:
    """Read a job.
    files : job file or several; key by key the later wins;  overrides : nested mapping from
    the command line, which wins over all
    parameters : section name -> formula -> model of its settings, for every stage, "analyse"
    and "light"; the usual formula first
    broken : stages that cannot be loaded, with what is wrong
    Raises ConfigError holding every problem found; InputError if a file cannot be read."""
    read = [
        file if isinstance(file, JobFile) else read_job_file(file, parameters)
        for file in ([files] if isinstance(files, Path) else files or ())
    ]
    sources = tuple(dict.fromkeys(file.path for file in read))
    read.append(JobFile(Path("command line"), "", dict(overrides)))
    merged: dict[str, Any] = reduce(merge, (file.document for file in read))
    problems: list[str] = []

    def problem(path: KeyPath, message: str, hint: str = "") -> None:
        # of the last file that holds the key, or else its nearest parent
        file = max(reversed(read), key=lambda f: _depth(f.document, path))
        problems.append(file.located(message, path, hint))

    def unknown(path: KeyPath) -> None:
        name, key = str(path[0]), str(path[-1])
        if name in broken:
            return problem(path, broken[name].message, broken[name].hint)
        if len(path) == 1:
            known = suggestion(name, model.model_fields)
            return problem(path, f"there is no section or stage {name!r}", known)
        gone = GONE.get(name, {}).get(key) if len(path) == 2 else None
        owners = [f for f, kind in sections[name].items() if key in _fields(kind)]
        if owners and gone is None:
            message = f'{name}.{key} belongs to formula = "{owners[0]}"'
            return problem(path, message, f'{name}.formula is "{chosen[name]}"')
        kind = sections[name][chosen.get(name, "")]
        hint = gone or suggestion(key, _fields(kind))
        return problem(path, f"[{name}] has no setting {key!r}", hint)

    sections, chosen = all_sections(parameters), dict[str, str]()
    for name, formulas in parameters.items():
        table, usual = merged.get(name), next(iter(formulas))
        formula = table.get("formula", usual) if isinstance(table, dict) else usual
        known = formula in list(formulas)
        chosen[name] = formula if known else usual
        if not known and len(formulas) > 1:
            message = f"{name}.formula {formula!r} is unknown"
            problem((name, "formula"), message, "one of " + ", ".join(formulas))
    model = _job_model(
        tuple((name, parameters[name][f]) for name, f in chosen.items())
    )
    try:
        job = model.model_validate(merged)
    except ValidationError as e:
        for error in e.errors(include_url=False):
            path = _key_path(merged, error)
            if error["type"] in _UNKNOWN:
                unknown(path)
            else:
                problem(path, *_message(path, error))
    if problems:
        raise ConfigError("\n\n".join(dict.fromkeys(problems)))
    job._sources = sources
    return job


_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


@cache
def _job_model(chosen: tuple[tuple[str, type], ...]) -> type[JobConfig]:
    """A job whose stages have these settings."""
    fields: Any = {name: (kind, Field(default_factory=kind)) for name, kind in chosen}
    return create_model("Job", __base__=JobConfig, **fields)


def _key_path(tree: Any, error: Any) -> KeyPath:
    """Of an error of pydantic's, without the types that it tried."""
    path = []
    for part in error["loc"]:
        try:
            tree = tree[part]
        except (LookupError, TypeError):
            if error["type"] != "missing":
                continue
        path.append(part)
    return tuple(path)


def _message(path: KeyPath, error: Any) -> tuple[str, str]:
    """What is wrong, and what would be right."""
    cause, value = error.get("ctx", {}).get("error"), error["input"]
    text, hint = error["msg"].removeprefix("Value error, "), ""
    if isinstance(cause, ConfigError):
        text, hint = cause.message, cause.hint
    elif error["type"] in ("model_type", "dataclass_type"):
        text = "must be a table"
    elif cause is None and isinstance(value, (int, float, str)):
        text += f", is {value!r:.60}"
    place = "" if text.startswith(f"{path[0]}.") else f"{'.'.join(map(str, path))}: "
    return place + text, hint


def read_job_file(
    file: Path, parameters: Parameters, kind: str = "job file"
) -> JobFile:
    """kind : as in `opener.LIMITS`. Raises ConfigError, InputError."""
    text = read_text(file, kind)
    try:
        document = parse_toml(text)
    except ValueError as e:
        raise ConfigError(f"{file}: not valid TOML: {e}") from None
    locate_paths(document, file.parent, parameters)
    return JobFile(file, text, document)


def locate_paths(
    document: Mapping[str, Any], folder: Path, parameters: Parameters
) -> None:
    """Paths in a job file are relative to its folder: make them so from here."""
    sections = all_sections(parameters)
    for section, tables in document.items():
        keys = [
            key
            for model in sections.get(section, {}).values()
            for key, field in _fields(model).items()
            if any(kind in (Path, PatternSpec) for kind in kinds(field.annotation))
        ]
        for table in tables if isinstance(tables, list) else [tables]:
            for key in keys if isinstance(table, dict) else ():
                if isinstance(table.get(key), str):
                    table[key] = str(folder / table[key])


def all_sections(parameters: Parameters) -> dict[str, Mapping[str, Any]]:
    """Every section of a job file, as `parameters`; those without a formula's name have one."""
    return {name: {"": model} for name, model in section_models().items()} | {
        **parameters
    }


def _fields(kind: Any) -> dict[str, Any]:
    """Of a model of settings, by name."""
    return getattr(kind, "__pydantic_fields__", {})


def suggestion(name: str, known: Any) -> str:
    """'did you mean …?' or the list of what is known."""
    hit = _closest(str(name), tuple(known))
    return (
        f"did you mean {hit[0]!r}?" if hit else "known: " + ", ".join(sorted(known))
    )


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


def _depth(tree: Any, path: KeyPath) -> int:
    """How many keys of a path are there; a list has all."""
    for n, key in enumerate(path):
        if isinstance(tree, (list, tuple)):
            break
        if not isinstance(tree, Mapping) or key not in tree:
            return n
        tree = tree[key]
    return len(path)


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
