"""Documents come back from JSON as they were; nothing else is taken."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from arfx.core import codec
from arfx.core.pose import Pose
from tests.exact import identical


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
        "x",
        Path("/a/b"),
        ((1.0, 2.0), (3.0, 4.0)),
        {"i": inner},
        [inner],
        Pose.identity(),
    )
    text = json.dumps(one.to_json(), allow_nan=False)
    again = Outer.from_json(json.loads(text))
    assert (
        json.dumps(again.to_json()) == text
        and again.width == math.inf
        and again.pose == one.pose
    )
    assert (again.name, again.path, again.rows) == (
        one.name,
        one.path,
        one.rows,
    ) and type(again.some) is list
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
