"""What frames show, as tables: rows of one kind each, kept by columns.

The first field of a row is the number of its frame. Tables of parts of a clip are joined by
putting one behind the other, with these numbers counted on. Files hold plain arrays (numpy's
npz), so that nothing in them names code to run."""

import hashlib
import io
import math
from ast import literal_eval
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache
from typing import Any, get_type_hints

import numpy as np
from numpy import ndarray

Columns = dict[str, ndarray]
Tables = dict[str, Columns]
_SHAPES = "/shapes"  # texts, of arrays of one column that differ: it is what they hold, flat
_DIGEST_BYTES = 16
_NONE = ""  # in place of a shape: no array


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
        shapes = [_NONE if v is None else str(np.shape(v)) for v in values]
        if len({*shapes}) <= 1 and _NONE not in shapes:
            out[name] = np.array(values)
            continue
        known = [np.ravel(v) for v in values if v is not None]
        out[name] = np.concatenate(known or [np.zeros(0)])
        out[name + _SHAPES] = np.array(shapes)
    return out


def rows_of(columns: Mapping[str, ndarray], kind: type, shift: int = 0) -> list[Any]:
    """The rows again. shift : to be added to their frames' numbers"""
    values = []
    for name, hint in _fields(kind):
        if _is_row(hint):
            outer = f"{name}."
            inner = {
                k.removeprefix(outer): v for k, v in columns.items() if outer in k
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
    return [*get_type_hints(kind).items()]


def _is_row(hint: Any) -> bool:
    return isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields"))


def _arrays(flat: ndarray, shapes: ndarray) -> list[ndarray | None]:
    out: list[ndarray | None] = []
    for text in shapes.tolist():
        shape = None if text == _NONE else literal_eval(text)
        count = 0 if shape is None else math.prod(shape)
        out.append(None if shape is None else flat[:count].reshape(shape))
        flat = flat[count:]
    return out
