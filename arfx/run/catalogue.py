"""What a job can set: every stage and every section of a job file, as data and as one
Markdown text.

`arfx stages` prints it, and docs/stages.md is the same text."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from arfx.config.load import suggestion
from arfx.config.sections import Length, Time, section_models
from arfx.core.cost import load_prices
from arfx.core.marker import MarkerSpec, PatternSpec
from arfx.errors import ConfigError
from arfx.papers import CORRECTED
from arfx.plan.errors import shipped_errors
from arfx.run.pages import render
from arfx.run.parameters import parameters
from arfx.stages import ALWAYS, ON_DEPTH, STAGES
from arfx.stages.raster.record import EXTRA_OUTPUTS, OUTPUTS

_WORDS = {
    bool: "true or false",
    int: "whole number",
    float: "number",
    str: "text",
    Path: "file or folder",
    MarkerSpec: "marker",
    PatternSpec: "pattern",
}

# Layers that the renderer's parts make; an effect behind them makes the picture.
WRITES = {
    "raster": sorted((*OUTPUTS, *EXTRA_OUTPUTS)),
    "lightmap": ["shadow", "virtual"],
    "holdout": ["shadow"],
    "gi": ["shadow", "virtual"],
    "hide": ["coverage", "virtual"],
}


def _sections() -> dict[str, Mapping[str, Any]]:
    """Sections of a job file that belong to no stage, with their models by formula."""
    own = {name: {CORRECTED: model} for name, model in section_models().items()}
    return own | {n: kinds for n, kinds in parameters().items() if n not in STAGES}


def sections() -> list[str]:
    """Names of the sections of a job file that belong to no stage."""
    return [*_sections()]


def describe(name: str) -> dict[str, Any]:
    """A stage or section as data; errors in grey levels, prices in ms. Raises ConfigError
    for a name that is neither.
    """
    if name in STAGES:
        return _stage(name)
    kinds = _sections().get(name)
    if kinds is None:
        raise ConfigError(
            f"there is no stage or section {name!r}",
            suggestion(name, [*STAGES, *sections()]),
        )
    about = _about(next(iter(kinds.values()))).partition("\n\n")[0]
    return {"name": name, "about": about, "settings": _of_formulas(kinds)}


def _stage(name: str) -> dict[str, Any]:
    stage = STAGES[name]
    errors, prices = shipped_errors(), load_prices()
    levels = []
    for level in stage.levels:
        price = prices.prices.get(f"{name}/{level}")
        terms = (
            None
            if price is None
            else {term: 1e3 * s for term, s in price.coefficients.items() if s}
        )
        levels.append(
            {
                "level": level,
                "error": errors.known(name, level, stage.levels[-1]),
                "price_ms": terms,
            }
        )
    about = stage.__dict__.get("__doc__") or inspect.getmodule(stage).__doc__ or ""
    return {
        "name": name,
        "about": inspect.cleandoc(about),
        "always": name in ALWAYS,
        "requires": ["depth"] if name in ON_DEPTH else [],
        "facts": sorted(stage.facts),
        "writes": WRITES.get(name, ["image"]),
        "levels": levels,
        "prices": prices.source,
        "settings": _of_formulas(parameters()[name]),
    }


def _about(kind: type) -> str:
    return inspect.cleandoc(kind.__doc__ or "")


def _of_formulas(kinds: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The settings under every formula, those of the usual one first; the others say
    theirs, where it or its default is new.
    """
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    usual = next(iter(kinds.values()))
    for formula, kind in kinds.items():
        for name, field in kind.__pydantic_fields__.items():
            row = _row(name, field)
            default = "" if name == "formula" else repr(row["default"])
            own = row if kind is usual else {**row, "formula": formula}
            rows.setdefault((name, default), own)
    return list(rows.values())


def _row(name: str, field: Any) -> dict[str, Any]:
    option = (field.json_schema_extra or {}).get("option", "").split()
    return {
        "name": name,
        "type": _words(field.annotation),
        "default": _plain(field.default),
        "text": field.description or "",
        "option": " ".join([w for w in option if w.startswith("-")] or option),
    }


def _words(hint: Any) -> str:
    """A type as people say it: number, length, list of 3 numbers."""
    if hint in (Length, Time):
        return "length" if hint == Length else "time"
    origin, inner = get_origin(hint), [a for a in get_args(hint) if a is not type(None)]
    if origin is Literal:
        return " or ".join(map(str, inner))
    if origin in (tuple, list):
        many = "" if origin is list or Ellipsis in inner else f"{len(inner)} "
        return f"list of {many}{_words(inner[0])}s".replace("texts", "names")
    if origin is Union or origin is type(int | None):
        return " or ".join(_words(a) for a in inner)
    return _words(inner[0]) if inner else _WORDS.get(hint, str(hint))


def _plain(default: Any) -> Any:
    """A default as JSON and TOML have it; None = it has none."""
    if isinstance(default, tuple):
        return list(default)
    return default if isinstance(default, (bool, int, float, str)) else None


def overview() -> str:
    """All stages in running order and the other sections, one line each, in Markdown."""
    return render(
        "run/overview.jinja",
        stages=map(describe, STAGES),
        sections=sections(),
        runs=_when,
        summary=_summary,
    )


def _when(d: dict[str, Any]) -> str:
    depends = f", with {' and '.join(d['requires'])}" if d["requires"] else ""
    return ("always" if d["always"] else "on request") + depends


def _summary(d: dict[str, Any]) -> str:
    """The first sentence of what a stage says of itself, without its name."""
    words = re.sub(
        rf"^{d['name']}: ", "", " ".join(d["about"].split()), flags=re.IGNORECASE
    )
    return re.split(r"(?<=[.])\s", words, maxsplit=1)[0].replace("|", "\\|")


def text(d: dict[str, Any], prices: bool = True) -> str:
    """One stage or section in Markdown.

    d : as `describe`;  prices : with those that hold on this machine
    """
    return render("run/stage.jinja", d=d, prices=prices, runs=_when).rstrip()


def page() -> str:
    """docs/stages.md: everything, without this machine's prices."""
    texts = [text(describe(name), prices=False) for name in [*STAGES, *sections()]]
    return render("run/stages.jinja", overview=overview(), texts=texts) + "\n"
