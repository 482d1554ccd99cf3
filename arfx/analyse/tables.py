"""What frames show, as tables: rows of one kind each, kept by columns.

The first field of a row is the number of its frame. Tables of parts of a clip are joined by
putting one behind the other, with these numbers counted on. Files hold plain arrays (numpy's
npz), so that nothing in them names code to run."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, get_type_hints

import numpy as np

Columns = dict[str, np.ndarray]
Tables = dict[str, Columns]
_SHAPES = (
    "/shapes"  # of arrays of one column that differ: the column is what they hold, flat
)
_DIGEST_BYTES = 16
_NONE, _UNUSED = -1, -2  # in shapes: instead of an array nothing; there are fewer axes


def by_columns(rows: Sequence[Any], kind: type) -> Columns:
    """The rows, dataclasses or named tuples of `kind`, as equally long arrays by field.

    Fields are numbers, texts, arrays of any shape, None in place of one, or such rows."""
    out: Columns = {}
    for name, hint in _fields(kind):
        values = [getattr(row, name) for row in rows]
        if _is_row(hint):
            inner = by_columns(values, hint)
            out |= {f"{name}.{k}": column for k, column in inner.items()}
            continue
        arrays = [None if v is None else np.asarray(v) for v in values]
        shapes = {None if a is None else a.shape for a in arrays}
        if len(shapes) <= 1 and None not in shapes:
            out[name] = np.array(arrays)
            continue
        known = [a.ravel() for a in arrays if a is not None]
        out[name] = np.concatenate(known) if known else np.zeros(0)
        out[name + _SHAPES] = _padded_shapes(arrays)
    return out


def rows_of(columns: Mapping[str, np.ndarray], kind: type, shift: int = 0) -> list[Any]:
    """The rows again. shift : to be added to their frames' numbers"""
    values = []
    for name, hint in _fields(kind):
        if _is_row(hint):
            first = f"{name}."
            inner = {
                k[len(first) :]: v for k, v in columns.items() if k.startswith(first)
            }
            values.append(rows_of(inner, hint))
        elif name + _SHAPES in columns:
            values.append(_arrays(columns[name], columns[name + _SHAPES]))
        else:
            column = columns[name] + shift if shift and not values else columns[name]
            values.append(column.tolist() if column.ndim == 1 else [*column])
    return [kind(*row) for row in zip(*values, strict=True)]


def to_bytes(tables: Mapping[str, Columns]) -> bytes:
    """A file: a digest of the rest, and numpy's npz."""
    arrays: dict[str, Any] = {
        f"{table}:{name}": column
        for table, columns in tables.items()
        for name, column in columns.items()
    }
    file = io.BytesIO()
    np.savez(file, **arrays)
    return _digest(file.getvalue()) + file.getvalue()


def from_bytes(data: bytes) -> Tables:
    """Raises ValueError for what is no file of tables, or a damaged one."""
    digest, body = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if digest != _digest(body):
        raise ValueError("not a whole file of tables")
    out: Tables = {}
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        for name in arrays.files:
            table, _, column = name.partition(":")
            out.setdefault(table, {})[column] = arrays[name]
    return out


def _digest(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=_DIGEST_BYTES).digest()


@cache
def _fields(kind: type) -> list[tuple[str, Any]]:
    hints = get_type_hints(kind)
    names = (
        [f.name for f in fields(kind)] if is_dataclass(kind) else [*kind.__annotations__]
    )
    return [(name, hints[name]) for name in names]


def _is_row(hint: Any) -> bool:
    return isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields"))


def _padded_shapes(arrays: Sequence[np.ndarray | None]) -> np.ndarray:
    most = max((a.ndim for a in arrays if a is not None), default=1)
    out = np.full((len(arrays), max(most, 1)), _UNUSED)
    for row, a in zip(out, arrays, strict=True):
        if a is None:
            row[0] = _NONE
        else:
            row[: a.ndim] = a.shape
    return out


def _arrays(flat: np.ndarray, shapes: np.ndarray) -> list[np.ndarray | None]:
    out: list[np.ndarray | None] = []
    start = 0
    for row in shapes:
        if row[0] == _NONE:
            out.append(None)
            continue
        shape = row[row != _UNUSED]
        end = start + int(shape.prod())
        out.append(flat[start:end].reshape(shape))
        start = end
    return out
