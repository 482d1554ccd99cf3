"""What is stored comes back as it was: type for type, bit for bit; nothing else is taken,
nothing damaged is believed.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import struct
import zlib
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

from arfx.core import codec
from arfx.core.camera import Camera
from arfx.core.pose import Pose
from tests.exact import identical

ODD_NAN = struct.unpack("<d", struct.pack("<Q", 0xFFF8000000000123))[0]
GRID = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
VALUES: list[Any] = [
    None, True, False, 0, -1, 10**40, "", "straße \udcff", 0.1, -0.0, 5e-324, 1.7976931348623157e308, math.inf, -math.inf,
    math.nan, ODD_NAN, [], (), {}, [1, (2.0, [3])], {"b": 1, "a": (1,), 3: None, (1, 2): "x"}, Counter({"b": 2, "a": 5}),
    np.float32(0.1), np.float64(0.1), np.int8(-3), np.bool_(True), np.array(1.5, np.float32), np.zeros((0, 2), np.float32),
    GRID, np.asfortranarray(GRID), GRID[:, ::2], GRID.T, np.array([np.nan, -0.0, np.inf], np.float16), np.array([True, False]),
    np.arange(3, dtype=">i2"), np.array([1 + 2j], np.complex64), np.random.default_rng(7).bit_generator.state,
    Camera(64, 48, np.diag([60.0, 61.0, 1.0]), np.arange(4) * 1e-3, source="x"),
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=lambda v: type(v).__name__)
def test_values_come_back_as_they_were(value: Any) -> None:
    again = codec.loads(codec.dumps([value, value]))
    assert type(again) is list and len(again) == 2
    for one in again:
        if isinstance(value, np.ndarray) and not (
            value.flags.c_contiguous or value.flags.f_contiguous
        ):
            value = value.copy()  # gaps between rows are not kept
        assert identical(one, value)
        assert not isinstance(one, np.ndarray) or (
            one.flags.writeable and one.flags.aligned
        )


def test_a_random_generator_goes_on_where_it_was() -> None:
    one, two = np.random.default_rng(7), np.random.default_rng(0)
    one.normal(size=5)
    two.bit_generator.state = codec.loads(codec.dumps(one.bit_generator.state))
    assert identical(one.normal(size=9), two.normal(size=9))


@pytest.mark.parametrize(
    "value", [np.array([None]), np.array(["x"]), np.str_("x")], ids=repr
)
def test_arrays_without_numbers_are_refused_when_they_are_written(value: Any) -> None:
    with pytest.raises(TypeError, match="cannot be stored"):
        codec.dumps({"deep": [value]})


def test_equal_values_give_equal_bytes() -> None:
    """Whoever refers to whom: files are named after them."""
    text, grid = "".join(["a", "b"]), np.eye(3)
    apart = ["".join(["a", "b"]), "".join(["a", "b"]), grid, grid.copy()]
    assert codec.dumps([text, text, grid, grid]) == codec.dumps(apart)


def test_every_damage_is_seen() -> None:
    good = codec.dumps({"a": GRID, "b": [1.5, "x"]})
    assert identical(codec.loads(good)["a"], GRID)
    bad = [good[:n] for n in range(len(good))] + [good + b"\0", b"", b'{"key": "x"}']
    bad += [bytes([*good[:i], good[i] ^ 1, *good[i + 1 :]]) for i in range(len(good))]
    for data in bad:
        with pytest.raises(ValueError, match="damaged"):
            codec.loads(data)


class Ints(list):  # type: ignore[type-arg]
    pass


class Runs:
    def __reduce__(self) -> Any:
        return os.system, ("false",)


@pytest.mark.parametrize(
    "value", [Runs(), OrderedDict(), Path("x"), len, Ints(), np.dtype("f4"), b"cut"],
    ids=lambda v: type(v).__name__,
)  # fmt: skip
def test_what_is_whole_but_no_state_is_refused(value: Any) -> None:
    """Nothing but classes of values is taken by its name, and none is called."""
    body = zlib.compress(value if value == b"cut" else pickle.dumps([value]))
    with pytest.raises(ValueError, match="not a state of these classes"):
        codec.loads(codec.FORMAT + codec._digest(body) + body)


@dataclass(frozen=True, eq=False)
class Inner(codec.Document):
    a: codec.Array
    b: Annotated[np.ndarray, codec.Packed("<f2", "f4")]


@dataclass(frozen=True)
class Outer(codec.Document):
    name: str
    path: Path
    rows: tuple[tuple[float, float], ...]
    by_name: Mapping[str, Inner]
    some: Sequence[Inner] = ()
    pose: Pose | None = None
    width: codec.Unbounded = math.inf


def test_documents_are_json_by_the_types_of_their_fields() -> None:
    inner = Inner(np.eye(2), np.array([[0.5, 2.0]], np.float32))
    one = Outer(
        "x", Path("/a/b"), ((1.0, 2.0), (3.0, 4.0)), {"i": inner}, [inner], Pose.identity()
    )
    text = json.dumps(one.to_json(), allow_nan=False)
    again = Outer.from_json(json.loads(text))
    assert (
        json.dumps(again.to_json()) == text
        and again.width == math.inf
        and again.pose == one.pose
    )
    assert (again.name, again.path, again.rows) == (one.name, one.path, one.rows) and type(
        again.some
    ) is list
    for read in (again.by_name["i"], again.some[0]):
        assert identical(read.a, inner.a) and identical(read.b, inner.b)
    bare = Outer.from_json(
        {"name": "y", "path": "p", "rows": [], "by_name": {}, "width": 3}
    )
    assert bare.pose is None and bare.some == () and bare.width == 3
    for wrong in (
        {"name": "y"},
        {**one.to_json(), "other": 1},
        {**one.to_json(), "rows": 1},
        {**one.to_json(), "pose": [0]},
    ):
        with pytest.raises((TypeError, ValueError, KeyError, AttributeError)):
            Outer.from_json(wrong)
