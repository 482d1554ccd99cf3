"""What is written down and read again: state as bytes, exactly (`dumps`), and dataclasses
as JSON (`Document`).

State, from one process to the next, keeps type, bits and order. Taken: None, bool, int,
float, str, list, tuple, dict, Counter, numeric numpy arrays and scalars, dataclasses marked
`serialisable`. Anything else is refused when it is written, subclasses too. What is read
can only be of these types: no file names code to run. A file begins with its format and a
digest of the
rest: one of another version, or a damaged one, is refused as a whole."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    Self,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

FORMAT = b"arfx state 1\n"
_DIGEST_BYTES = 16
_CLASSES: dict[str, type] = {}
T = TypeVar("T")


def serialisable(kind: type[T]) -> type[T]:
    """Decorator of a dataclass whose objects may be written.

    They are made anew from their fields, in order.
    """
    if kind.__name__ in _CLASSES or not all(f.init and not f.kw_only for f in fields(kind)):  # type: ignore[arg-type]
        raise TypeError(
            f"{kind.__name__}: another class of this name is serialisable, or not every"
            " field is a plain argument"
        )
    _CLASSES[kind.__name__] = kind
    return kind


def dumps(value: Any) -> bytes:
    """Raises TypeError for a value of a type that is not taken."""
    raw = bytearray()
    tree = json.dumps(_encode(value, raw), separators=(",", ":")).encode()
    body = zlib.compress(struct.pack("<Q", len(tree)) + tree + raw, 1)
    return FORMAT + _digest(body) + body


def loads(data: bytes) -> Any:
    """What `dumps` was given; arrays are new and writable. Raises ValueError for other data."""
    head = len(FORMAT) + _DIGEST_BYTES
    digest, body = data[len(FORMAT) : head], data[head:]
    if not data.startswith(FORMAT) or digest != _digest(body):
        raise ValueError("not a state of this version, or damaged")
    plain = zlib.decompress(body)
    (size,) = struct.unpack_from("<Q", plain)
    at = 8 + size

    def take(count: int) -> bytes:
        nonlocal at
        at += count
        return plain[at - count : at]

    try:
        return _decode(json.loads(plain[8:at]), take)
    except Exception as e:  # whole, but of classes that are no longer what they were
        raise ValueError(f"not a state of these classes: {e}") from e


def _digest(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=_DIGEST_BYTES).digest()


def _encode(v: Any, raw: bytearray) -> Any:
    """As JSON; what is not text or a finite number goes into raw, in the order in which it
    will be read.
    """
    kind = type(v)
    if v is None or kind in (bool, int, str) or (kind is float and math.isfinite(v)):
        return v  # JSON's decimals are the shortest that are read back as the same float
    if kind in (list, tuple):
        return [kind.__name__, *[_encode(x, raw) for x in v]]
    if kind in (dict, Counter):
        return [kind.__name__, *[_encode(x, raw) for pair in v.items() for x in pair]]
    if _CLASSES.get(kind.__name__) is kind:
        return [kind.__name__, *[_encode(getattr(v, f.name), raw) for f in fields(kind)]]
    if kind is float:
        raw += struct.pack("<d", v)
        return ["float"]
    if (kind is np.ndarray or isinstance(v, np.generic)) and v.dtype.kind in "biufc":
        if kind is not np.ndarray:
            raw += v.tobytes()
            return ["scalar", v.dtype.str]
        order = (
            "F" if v.flags.f_contiguous and not v.flags.c_contiguous else "C"
        )  # sums may depend on it
        raw += v.tobytes(order)
        return ["array", v.dtype.str, order, *v.shape]
    raise TypeError(f"{kind.__qualname__} cannot be stored")


def _decode(node: Any, take: Callable[[int], bytes]) -> Any:
    if type(node) is not list:
        return node
    tag, rest = node[0], node[1:]
    if tag == "array":
        dtype, order, shape = np.dtype(rest[0]), rest[1], rest[2:]
        return (
            np.frombuffer(take(dtype.itemsize * math.prod(shape)), dtype)
            .reshape(shape, order=order)
            .copy(order)
        )
    if tag == "scalar":
        dtype = np.dtype(rest[0])
        return np.frombuffer(take(dtype.itemsize), dtype)[0]
    if tag == "float":
        return struct.unpack("<d", take(8))[0]
    values = [_decode(x, take) for x in rest]
    if tag == "list":
        return values
    if tag == "tuple":
        return tuple(values)
    if tag in ("dict", "Counter"):
        pairs = dict(zip(values[::2], values[1::2], strict=True))
        return Counter(pairs) if tag == "Counter" else pairs
    if tag in _CLASSES:
        return _CLASSES[tag](*values)
    raise ValueError(f"unknown type {tag!r}")


Convert = Callable[[Any], Any]


class Document:
    """Base of dataclasses that JSON files hold: written and read by the types of their
    fields, through one pair of functions for each class. A field that the JSON lacks has
    its default.

    Types: what JSON holds itself, Any, Path, Fraction; arrays (lists of numbers, float64
    when read; with `Gaps`, or `Packed`);
    `Unbounded`; Documents, and classes with a `to_json` and `from_json` of their own;
    tuples, sequences, mappings and optionals of these."""

    __slots__ = ()

    def to_json(self) -> dict[str, Any]:
        kind: Any = type(self)
        return _of_class(kind)[0](self)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Raises TypeError, ValueError, KeyError or AttributeError for what is not of this
        class.
        """
        kind: Any = cls
        return _of_class(kind)[1](document)

    @classmethod
    def from_line(cls, line: str) -> Self:
        """Of JSON. Raises as `from_json` does."""
        return cls.from_json(json.loads(line))


@dataclass(frozen=True)
class Packed:
    """Annotation of an array that is written as text.

    dtype : such as "<f2";  dtype_read : when read, None = the same
    """

    dtype: str
    dtype_read: str | None = None

    def write(self, a: np.ndarray) -> dict[str, Any]:
        return {
            "shape": list(a.shape),
            "data": base64.b64encode(a.astype(self.dtype).tobytes()).decode(),
        }

    def read(self, v: Mapping[str, Any]) -> np.ndarray:
        a = np.frombuffer(base64.b64decode(v["data"]), self.dtype).reshape(v["shape"])
        return a if self.dtype_read is None else a.astype(self.dtype_read)


class _InfinityAsNull:
    write = staticmethod(lambda v: v if math.isfinite(v) else None)
    read = staticmethod(lambda v: math.inf if v is None else v)


class Gaps:
    """Annotation of a float or an array in which what is not finite is unknown: null, NaN
    when read.
    """

    @staticmethod
    def write(v: float | np.ndarray) -> Any:
        out = np.array(v, object)
        out[~np.isfinite(v)] = None
        return out.tolist()

    @staticmethod
    def read(v: Any) -> Any:
        return np.array(v, float)[()]


Unbounded = Annotated[
    float, _InfinityAsNull
]  # a float that may be infinite, which JSON cannot say: null


@cache
def _of_type(hint: Any) -> tuple[Convert | None, Convert | None]:
    """(writes, reads) a value of this type; None = it is JSON already."""
    write: Any
    read: Any
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return parts[1].write, parts[1].read
    if origin in (Union, UnionType):
        every = [_of_type(p) for p in parts if p is not type(None)]
        write, read = every[0] if len(every) == 1 else (None, None)
        return write and (lambda v: None if v is None else write(v)), read and (
            lambda v: None if v is None else read(v)
        )
    if origin in (tuple, Sequence):
        write, read = _of_type(parts[0])
        container: Convert = tuple if origin is tuple else list
        return write and (lambda v: list(map(write, v))), (
            (lambda v: container(map(read, v))) if read else container
        )
    if origin in (dict, Mapping):
        write, read = _of_type(parts[1])
        return write and (lambda v: {k: write(x) for k, x in v.items()}), read and (
            lambda v: {k: read(x) for k, x in v.items()}
        )
    if hint is np.ndarray:
        return (lambda a: np.asarray(a).tolist()), (lambda v: np.array(v, float))
    if hint in (Path, Fraction):
        return str, hint
    if not isinstance(hint, type) or not hasattr(hint, "from_json"):
        return None, None
    own = "from_json" in vars(hint) or not issubclass(hint, Document)
    return (hint.to_json, hint.from_json) if own else _of_class(hint)  # type: ignore[attr-defined]


@cache
def _of_class(kind: type) -> tuple[Convert, Convert]:
    """(writes, reads) an object of this dataclass."""
    hints = get_type_hints(kind, include_extras=True)
    of = {f.name: _of_type(hints[f.name]) for f in fields(kind)}
    writers, readers = (
        [(name, pair[k]) for name, pair in of.items() if pair[k] is not None]
        for k in (0, 1)
    )

    def write(v: Any) -> dict[str, Any]:
        out = {name: getattr(v, name) for name in of}
        for name, convert in writers:
            out[name] = convert(out[name])  # type: ignore[misc]
        return out

    def read(d: Mapping[str, Any]) -> Any:
        out = dict(d)
        for name, convert in readers:
            if name in out:
                out[name] = convert(out[name])  # type: ignore[misc]
        return kind(**out)

    return write, read
