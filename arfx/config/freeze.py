"""A job as plain data and as TOML: what the job folder keeps, and what chunk keys are made of."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from arfx.config.sections import JobConfig
from arfx.core.marker import MarkerSpec


def plain(value: Any) -> Any:
    """Nested dicts, lists, strings and numbers only; None left out; paths absolute."""
    if isinstance(value, MarkerSpec):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain({f.name: getattr(value, f.name) for f in dataclasses.fields(value)})
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, Path):
        return str(value.absolute())
    return value


def frozen(config: JobConfig) -> dict[str, Any]:
    """The job as plain data that `load` reads back to the same job (paths absolute)."""
    tree = {name: getattr(config, name).model_dump() for name in ("input", "model", "pipeline", "output")}
    tree["marker"] = [{"spec": str(m)} for m in config.markers]
    if tree["model"]["fit"] is not None:
        tree["model"]["fit"] = f"{float(tree['model']['fit'])!r}m"
    tree["model"]["offset"] = [f"{float(v)!r}m" for v in tree["model"]["offset"]]
    return {**plain(tree), **plain(config.params)}


def to_toml(tree: Mapping[str, Any], prefix: str = "") -> str:
    """TOML text of nested plain data (strings, numbers, booleans, lists of those, tables, lists of tables)."""
    lines, tables = [], []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            body = to_toml(value, f"{prefix}{key}.")
            tables.append(f"\n[{prefix}{key}]\n{body}")
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            tables += [f"\n[[{prefix}{key}]]\n{to_toml(v, f'{prefix}{key}.')}" for v in value]
        else:
            lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
    return "\n".join([*lines, *tables])
