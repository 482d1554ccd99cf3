"""What frames show, as tables: rows of one kind each, kept by columns.

The first field of a row is the number of its frame. Tables of parts of a clip are joined by
putting one behind the other, with these numbers counted on. Files hold plain arrays (numpy's
npz), so that nothing in them names code to run."""

import hashlib
import io
import math
from ast import literal_eval
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy import ndarray

T = TypeVar("T")
Columns = dict[str, ndarray]
Tables = dict[str, Columns]
_PLAIN = (int, float, bool, str)
_ARRAYS = (ndarray, ndarray | None)
_SHAPES = "/shapes"  # texts, of a column of arrays: it is what they hold, flat
_DIGEST_BYTES = 16


def by_columns(rows: Sequence[Any], kind: type, outer: str = "") -> Columns:
    """The rows, dataclasses or named tuples of `kind`, by field. outer : before its name

    Fields are numbers, texts, arrays of any shape, None in place of one, or such rows."""
    out: Columns = {}
    for name, hint in get_type_hints(kind).items():
        column, values = outer + name, [getattr(row, name) for row in rows]
        if hint in _PLAIN:
            out[column] = np.array(values)
        elif hint in _ARRAYS:
            known = [v.ravel() for v in values if v is not None]
            out[column] = np.concatenate(known or [np.zeros(0)])
            shapes = [None if v is None else v.shape for v in values]
            out[column + _SHAPES] = np.array([*map(str, shapes)])
        else:
            out |= by_columns(values, hint, f"{column}.")
    return out


def tables_of(rows: Iterable[Any]) -> Tables:
    """Rows of any kinds: a table of each, by the class's name."""
    every: dict[type, list[Any]] = {}
    for row in rows:
        every.setdefault(type(row), []).append(row)
    return {kind.__name__: by_columns(some, kind) for kind, some in every.items()}


def rows_of(tables: Mapping[str, Columns], kind: type[T], shift: int = 0) -> list[T]:
    """The rows of one kind again. shift : to be added to their frames' numbers"""
    if kind.__name__ not in tables:
        return []
    columns, frame = tables[kind.__name__], next(iter(get_type_hints(kind)))
    return _rows({**columns, frame: columns[frame] + shift}, kind)


def _rows(columns: Mapping[str, ndarray], kind: type, outer: str = "") -> list[Any]:
    fields: list[list[Any]] = []
    for name, hint in get_type_hints(kind).items():
        column = outer + name
        if hint in _PLAIN:
            fields.append(columns[column].tolist())
        elif hint in _ARRAYS:
            fields.append(_arrays(columns[column], columns[column + _SHAPES]))
        else:
            fields.append(_rows(columns, hint, f"{column}."))
    return [kind(*row) for row in zip(*fields, strict=True)]


def _arrays(flat: ndarray, texts: ndarray) -> list[ndarray | None]:
    shapes = [*map(cache(literal_eval), texts.tolist())]
    ends = np.cumsum([0 if shape is None else math.prod(shape) for shape in shapes])
    parts = np.split(flat, ends)  # and what is behind the last one: nothing
    return [
        None if shape is None else part.reshape(shape)
        for part, shape in zip(parts, shapes, strict=False)
    ]


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
