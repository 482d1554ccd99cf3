"""Dataclasses as JSON, and back: `Document`, by pydantic, with annotations for what JSON has
no words for."""

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Self

import numpy as np
from numpy import ndarray
from pydantic import ConfigDict, TypeAdapter
from pydantic_core import core_schema


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

    def _write(self, a: ndarray) -> dict[str, Any]:
        data = base64.b64encode(a.astype(self.dtype).tobytes()).decode()
        return {"shape": list(a.shape), "data": data}

    def _read(self, v: Mapping[str, Any]) -> ndarray:
        a = np.frombuffer(base64.b64decode(v["data"]), self.dtype).reshape(v["shape"])
        return a.astype(self.dtype_read)


class Gaps(Plain):
    """Annotation of a float or an array in which what is not finite is unknown: null, NaN
    when read.
    """

    @staticmethod
    def to_json(v: float | ndarray) -> Any:
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
Array = Annotated[ndarray, Gaps]
