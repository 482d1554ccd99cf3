"""A batch's table: [[job]] tables of TOML under the settings of a job file, or a row of CSV
for each job.

A column, or a key of a [[job]], is an option of `process` that takes a value, without its
dashes (clip, camera, output, fit), or a setting: in CSV as `section.key`, in TOML in a
table of the [[job]]. `config` names a job file that it is laid over."""

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from arfx.config.given import option_given, parse_value
from arfx.config.load import (
    JobFile,
    Parameters,
    all_sections,
    find_job_file,
    locate_paths,
    read_job_file,
    suggestion,
)
from arfx.config.sections import Setting, settings
from arfx.core.opener import read_text
from arfx.errors import ConfigError

SUFFIXES = (".toml", ".csv")
_MOST_PROBLEMS = 10  # that a message lists


def read_manifest(path: Path, parameters: Parameters) -> list[list[JobFile]]:
    """The files of each job, for `load`: what all share, job files that the job names as
    `config`, and last its own settings. Paths are from the manifest's folder. Raises
    ConfigError with the problems of all rows, InputError where it cannot be read."""
    shared, raw = (
        _toml(path, parameters) if path.suffix.lower() == ".toml" else _csv(path)
    )
    options = {s.name: s for s in settings() if bool not in s.kinds}
    rows, problems = [], []
    for row in raw:
        try:
            rows.append([*shared, *_job_files(row, options, parameters)])
        except ConfigError as e:
            problems.append(e.message)
    if not raw:
        problems.append(
            f"manifest {path} holds no [[job]] table, or no row below its heads\nhelp: each"
            " names at least a clip; a job file is given with --config"
        )
    if problems:
        raise ConfigError(listed(problems))
    return rows


def listed(problems: Sequence[str]) -> str:
    """The first of them, once each, and how many more there are."""
    different = list(dict.fromkeys(problems))
    more = len(different) - _MOST_PROBLEMS
    rest = [f"… and {more} more"] * (more > 0)
    return "\n\n".join([*different[:_MOST_PROBLEMS], *rest])


def _toml(path: Path, parameters: Parameters) -> tuple[list[JobFile], list[JobFile]]:
    file = read_job_file(path, parameters, "manifest")
    tables = file.document.pop("job", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise ConfigError(
            file.located(
                "'job' must be tables", ("job",), "[[job]], one for each clip"
            )
        )
    return [file], [
        file._replace(document=table, at=("job", k)) for k, table in enumerate(tables)
    ]


def _csv(path: Path) -> tuple[list[JobFile], list[JobFile]]:
    text = read_text(path, "manifest")
    first = text.partition("\n")[0]
    reader = csv.reader(
        io.StringIO(text, newline=""),
        delimiter=max(",;\t", key=first.count),
        strict=True,
    )
    file, heads, rows = JobFile(path, text, {}, line=1), list[str](), list[JobFile]()
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                pass
            elif not heads:
                heads = cells
                if twice := [h for h in heads if heads.count(h) > 1]:
                    message = f"column {twice[0]!r} is there twice"
                    raise ConfigError(file.located(message, ()))
            elif len(cells) > len(heads):
                message = f"{len(cells)} cells under {len(heads)} heads"
                hint = "quote a cell that holds a comma"
                raise ConfigError(file.located(message, (), hint))
            else:
                table = {h: c for h, c in zip(heads, cells, strict=False) if c}
                rows.append(file._replace(document=table))
            file = file._replace(line=reader.line_num + 1)
    except csv.Error as e:
        raise ConfigError(file.located(f"not valid CSV: {e}", ())) from None
    return [], rows


def _job_files(
    row: JobFile, options: Mapping[str, Setting], parameters: Parameters
) -> list[JobFile]:
    """The job files that a row names, and the row as the tables of one.

    Raises ConfigError with file, line and key.
    """
    sections = all_sections(parameters)
    named = row.document.pop("config", [])
    named = [named] if isinstance(named, str) else named
    if not isinstance(named, list) or not all(
        isinstance(name, str) for name in named
    ):
        raise ConfigError(
            row.located("config must be a job file or a list of them", ("config",))
        )
    files = [
        read_job_file(find_job_file(Path(name), row.path.parent), parameters)
        for name in named
    ]
    tree: dict[str, Any] = {}
    for path, value in _settings(row, options, sections):
        table = tree if len(path) == 1 else tree.setdefault(path[0], {})
        if not isinstance(table, dict) or path[-1] in table:
            raise ConfigError(row.located(f"{'.'.join(path)} is given twice", path))
        table[path[-1]] = value
    locate_paths(tree, row.path.parent, parameters)
    files.append(row._replace(document=tree))
    if not any("clip" in file.document.get("input", {}) for file in files):
        raise ConfigError(
            row.located(
                "no clip is named",
                (),
                "clip = the path of a video, from the manifest's folder",
            )
        )
    return files


def _settings(
    row: JobFile, options: Mapping[str, Setting], sections: Collection[str]
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(key path in a job file, value)"""
    for key, value in row.document.items():
        section, dot, rest = key.partition(".")
        if isinstance(value, dict) and key in sections:
            yield from (((key, inner), v) for inner, v in value.items())
        elif (
            isinstance(value, list)
            and all(isinstance(v, dict) for v in value)
            and key in sections
        ):
            yield (key,), value
        elif (option := options.get(key.replace("-", "_"))) is not None:
            one = option.repeated and not isinstance(value, list)
            yield option_given(option, [value] if one else value)
        elif dot and section in sections and rest and not row.at:
            yield (section, rest), parse_value(value, key)
        else:
            known = suggestion(key, [*options, *(f"{s}.…" for s in sorted(sections))])
            raise ConfigError(
                row._replace(line=row.line and 1).located(
                    f"a job has no setting {key!r}", (key,), known
                )
            )
