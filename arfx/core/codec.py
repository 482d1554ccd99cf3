"""Plain values as bytes and back, exactly: type, bits, order. What state is kept in, from one process to the next.

Taken: None, bool, int, float, str, list, tuple, dict, Counter, numpy arrays and scalars of numbers, dataclasses marked `stored`.
Anything else is refused when it is written, subclasses too. What is read can only be of these types: no file names code to run.
A file begins with its format and a digest of the rest: one of another version, or a damaged one, is refused as a whole.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

FORMAT = b"arfx state 1\n"
_DIGEST_BYTES = 16
_STORED: dict[str, type] = {}
T = TypeVar("T")


def stored(kind: type[T]) -> type[T]:
    """Decorator of a dataclass whose objects may be written. They are made anew from their fields, in order."""
    if kind.__name__ in _STORED or not all(f.init and not f.kw_only for f in fields(kind)):  # type: ignore[arg-type]
        raise TypeError(f"{kind.__name__}: another class of this name is stored, or not every field is a plain argument")
    _STORED[kind.__name__] = kind
    return kind


def dumps(value: Any) -> bytes:
    """Raises TypeError for a value of a type that is not taken."""
    raw = bytearray()
    tree = json.dumps(_written(value, raw), separators=(",", ":")).encode()
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
        return _read(json.loads(plain[8:at]), take)
    except Exception as e:  # whole, but of classes that are no longer what they were
        raise ValueError(f"not a state of these classes: {e}") from e


def _digest(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=_DIGEST_BYTES).digest()


def _written(v: Any, raw: bytearray) -> Any:
    """As JSON; what is not text or a finite number goes into raw, in the order in which it will be read."""
    kind = type(v)
    if v is None or kind in (bool, int, str) or (kind is float and math.isfinite(v)):
        return v  # JSON's decimals are the shortest that are read back as the same float
    if kind in (list, tuple):
        return [kind.__name__, *[_written(x, raw) for x in v]]
    if kind in (dict, Counter):
        return [kind.__name__, *[_written(x, raw) for pair in v.items() for x in pair]]
    if _STORED.get(kind.__name__) is kind:
        return [kind.__name__, *[_written(getattr(v, f.name), raw) for f in fields(kind)]]
    if kind is float:
        raw += struct.pack("<d", v)
        return ["float"]
    if (kind is np.ndarray or isinstance(v, np.generic)) and v.dtype.kind in "biufc":
        if kind is not np.ndarray:
            raw += v.tobytes()
            return ["scalar", v.dtype.str]
        order = "F" if v.flags.f_contiguous and not v.flags.c_contiguous else "C"  # sums may depend on it
        raw += v.tobytes(order)
        return ["array", v.dtype.str, order, *v.shape]
    raise TypeError(f"{kind.__qualname__} cannot be stored")


def _read(node: Any, take: Callable[[int], bytes]) -> Any:
    if type(node) is not list:
        return node
    tag, rest = node[0], node[1:]
    if tag == "array":
        dtype, order, shape = np.dtype(rest[0]), rest[1], rest[2:]
        return np.frombuffer(take(dtype.itemsize * math.prod(shape)), dtype).reshape(shape, order=order).copy(order)
    if tag == "scalar":
        dtype = np.dtype(rest[0])
        return np.frombuffer(take(dtype.itemsize), dtype)[0]
    if tag == "float":
        return struct.unpack("<d", take(8))[0]
    values = [_read(x, take) for x in rest]
    if tag == "list":
        return values
    if tag == "tuple":
        return tuple(values)
    if tag in ("dict", "Counter"):
        pairs = dict(zip(values[::2], values[1::2], strict=True))
        return Counter(pairs) if tag == "Counter" else pairs
    if tag in _STORED:
        return _STORED[tag](*values)
    raise ValueError(f"unknown type {tag!r}")
