"""What is written down and read again: state as bytes, exactly (`dumps`), and dataclasses
as JSON (`Document`).

State, from one process to the next, keeps type, bits and order: it is pickled, but for
arrays, of which type, shape and bytes are. What is read can only be plain values, numeric
arrays and scalars, Counters and dataclasses of arfx: no file names code to run. A file
begins with its format and a digest of the rest: one of another version, or a damaged one,
is refused as a whole."""

from __future__ import annotations

import base64
import hashlib
import io
import math
import pickle
import sys
import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Self

import numpy as np
from pydantic import ConfigDict, TypeAdapter
from pydantic_core import core_schema

FORMAT = b"arfx state 2\n"
_DIGEST_BYTES = 16


class _Pickler(pickle.Pickler):
    def persistent_id(self, v: Any) -> Any:
        if not isinstance(v, np.ndarray | np.generic):
            return None
        if v.dtype.kind not in "biufc":
            raise TypeError(f"an array of {v.dtype} cannot be stored")
        order: Any = "F" if v.flags.fnc else "C"  # sums may depend on it
        return isinstance(v, np.generic), v.dtype.str, v.shape, order, v.tobytes(order)

    def reducer_override(self, v: Any) -> Any:
        if isinstance(v, type | Counter):
            return NotImplemented
        if is_dataclass(v):  # by its fields: what it keeps beside them differs
            return type(v), tuple(getattr(v, f.name) for f in fields(v))
        raise TypeError(f"{type(v).__name__} cannot be stored")


class _Unpickler(pickle.Unpickler):
    def persistent_load(self, saved: Any) -> Any:
        scalar, dtype, shape, order, data = saved
        array = np.frombuffer(data, dtype).reshape(shape, order=order).copy(order)
        return array[()] if scalar else array

    def find_class(self, module: str, name: str) -> Any:
        kind = getattr(sys.modules.get(module), name, None)
        ours = module.startswith("arfx.") and isinstance(kind, type) and is_dataclass(kind)
        if ours or kind is Counter:
            return kind
        raise pickle.UnpicklingError(f"{module}.{name} is not taken")


def dumps(value: Any) -> bytes:
    """Raises TypeError for a value of a type that is not taken."""
    plain = io.BytesIO()
    pickler = _Pickler(plain, 5)
    pickler.fast = True  # without references: equal values give equal bytes
    pickler.dump(value)
    body = zlib.compress(plain.getvalue(), 1)
    return FORMAT + _digest(body) + body


def loads(data: bytes) -> Any:
    """What `dumps` was given; arrays are new and writable. Raises ValueError for other data."""
    head = len(FORMAT) + _DIGEST_BYTES
    digest, body = data[len(FORMAT) : head], data[head:]
    if not data.startswith(FORMAT) or digest != _digest(body):
        raise ValueError("not a state of this version, or damaged")
    try:
        return _Unpickler(io.BytesIO(zlib.decompress(body))).load()
    except Exception as e:  # whole, but of other classes
        raise ValueError(f"not a state of these classes: {e}") from e


def _digest(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=_DIGEST_BYTES).digest()


class Document:
    """Base of dataclasses that JSON files hold: written and read by the types of their
    fields, as pydantic does. A field that the JSON lacks has its default.

    Types: those of pydantic, dataclasses, classes that are `Plain`, `Array`, and what is
    annotated as `Packed` or with `Gaps`."""

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid")

    def to_json(self) -> dict[str, Any]:
        return _adapter(type(self)).dump_python(  # type: ignore[arg-type]
            self, mode="json", warnings=False, fallback=lambda v: v.tolist()
        )

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Raises TypeError, ValueError, KeyError or AttributeError for what is not of this
        class.
        """
        return _adapter(cls).validate_python(document)  # type: ignore[arg-type]

    @classmethod
    def from_line(cls, line: str) -> Self:
        """Of JSON. Raises as `from_json` does."""
        return _adapter(cls).validate_json(line)  # type: ignore[arg-type]


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


class Plain:
    """Base of classes, and of annotations, whose own `from_json` and `to_json` read and
    write a value as JSON holds it.
    """

    __slots__ = ()

    @classmethod
    def __get_pydantic_core_schema__(cls, *_: Any) -> core_schema.CoreSchema:
        kind: Any = cls
        return _converted(kind.from_json, kind.to_json)


def _converted(read: Any, write: Any) -> core_schema.CoreSchema:
    return core_schema.no_info_plain_validator_function(
        read, serialization=core_schema.plain_serializer_function_ser_schema(write)
    )


@dataclass(frozen=True)
class Packed:
    """Annotation of an array that is written as text.

    dtype : such as "<f2";  dtype_read : when read
    """

    dtype: str
    dtype_read: str

    def __get_pydantic_core_schema__(self, *_: Any) -> core_schema.CoreSchema:
        return _converted(self._read, self._write)

    def _write(self, a: np.ndarray) -> dict[str, Any]:
        data = base64.b64encode(a.astype(self.dtype).tobytes()).decode()
        return {"shape": list(a.shape), "data": data}

    def _read(self, v: Mapping[str, Any]) -> np.ndarray:
        a = np.frombuffer(base64.b64decode(v["data"]), self.dtype).reshape(v["shape"])
        return a.astype(self.dtype_read)


class Gaps(Plain):
    """Annotation of a float or an array in which what is not finite is unknown: null, NaN
    when read.
    """

    @staticmethod
    def to_json(v: float | np.ndarray) -> Any:
        out = np.array(v, object)
        out[~np.isfinite(v)] = None
        return out.tolist()

    @staticmethod
    def from_json(v: Any) -> Any:
        return np.array(v, float)[()]


class _InfinityAsNull(Plain):
    to_json = staticmethod(lambda v: v if math.isfinite(v) else None)
    from_json = staticmethod(lambda v: math.inf if v is None else v)


# a float that may be infinite, which JSON cannot say: null
Unbounded = Annotated[float, _InfinityAsNull]
Array = Annotated[np.ndarray, Gaps]
