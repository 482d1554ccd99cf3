"""What a job can set: every stage and every section of a job file, as data and as one
Markdown text.

`arfx stages` prints it, and docs/stages.md is the same text."""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from arfx.config.load import all_sections, suggestion
from arfx.config.sections import Length, Time, option_of
from arfx.core.cost import Price, load_prices
from arfx.core.marker import MarkerSpec, PatternSpec
from arfx.errors import ConfigError
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


def everything() -> dict[str, Any]:
    """All stages in running order, and the other sections, each as `describe` has it."""
    others = [name for name in all_sections(parameters()) if name not in STAGES]
    return {
        "stages": [*map(describe, STAGES)],
        "sections": [*map(describe, others)],
    }


def describe(name: str) -> dict[str, Any]:
    """A stage or section as data; errors in grey levels, prices in ms. Raises ConfigError
    for a name that is neither.
    """
    every = all_sections(parameters())
    if name in STAGES.broken:
        raise STAGES.broken[name]
    if name not in every:
        raise ConfigError(
            f"there is no stage or section {name!r}", suggestion(name, every)
        )
    settings = _of_formulas(every[name])
    if name not in STAGES:
        kind = next(iter(every[name].values()))
        about = inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0]
        return {"name": name, "about": about, "settings": settings}
    stage, errors, prices = STAGES[name], shipped_errors(), load_prices()
    about = stage.__dict__.get("__doc__") or inspect.getmodule(stage).__doc__ or ""
    return {
        "name": name,
        "about": inspect.cleandoc(about),
        "always": name in ALWAYS,
        "requires": ["depth"] if name in ON_DEPTH else [],
        "facts": sorted(stage.facts),
        "writes": WRITES.get(name, ["image"]),
        "levels": [
            {
                "level": level,
                "error": errors.known(name, level, stage.levels[-1]),
                "price_ms": _price_ms(prices.prices.get(f"{name}/{level}")),
            }
            for level in stage.levels
        ],
        "prices": prices.source,
        "settings": settings,
    }


def _price_ms(price: Price | None) -> dict[str, float] | None:
    if price is None:
        return None
    return {term: 1e3 * s for term, s in price.coefficients.items() if s}


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
    return {
        "name": name,
        "type": _words(field.annotation),
        "default": _plain(field.default),
        "text": field.description or "",
        "option": " ".join(option_of(field)[0]),
    }


def _words(hint: Any) -> str:
    """A type as people say it: number, length, list of 3 numbers."""
    if hint in (Length, Time):
        return "length" if hint == Length else "time"
    origin, inner = (
        get_origin(hint),
        [a for a in get_args(hint) if a is not type(None)],
    )
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


def overview(every: dict[str, Any]) -> str:
    """All stages in running order and the other sections, one line each, in Markdown.
    every : as `everything`
    """
    return render("run/overview.jinja", **every)


def text(d: dict[str, Any]) -> str:
    """One stage or section in Markdown, with the prices that hold on this machine.

    d : as `describe`
    """
    return render("run/stage.jinja", d=d, prices=True).rstrip()


def page() -> str:
    """docs/stages.md: everything, without this machine's prices."""
    return render("run/stages.jinja", **everything()).rstrip() + "\n"
