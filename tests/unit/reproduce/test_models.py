"""The models of the papers' tables and figures."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from arfx.errors import ConfigError
from arfx.media.models import load_model
from arfx.reproduce import teapot as newell
from arfx.reproduce.models import MODELS, write_model


@cache
def made(name: str) -> list[Any]:
    return MODELS[name]()


@pytest.mark.parametrize(
    ("name", "faces"),
    [("apple", 4000), ("teapot", 6000), ("aeroplane", 21000), ("cube", 12)],
)
def test_as_many_faces_as_the_table_says(name: str, faces: int, tmp_path: Path) -> None:
    assert write_model(name, tmp_path / "model.glb") == faces
    assert load_model(tmp_path / "model.glb", None).face_count == faces


@pytest.mark.parametrize("name", ["apple", "aeroplane", "rabbit"])
def test_parts_are_closed_and_face_outward(name: str) -> None:
    for part in made(name):
        assert part.is_watertight and part.volume > 0


def test_faces_have_an_area_and_the_teapot_faces_outward() -> None:
    for name in ("teapot", "apple", "aeroplane", "cube", "rabbit"):
        assert all(part.area_faces.min() > 0 for part in made(name)), name
    body, _, handle, spout = made("teapot")
    assert (
        np.mean(
            np.einsum("ij,ij->i", body.face_normals, body.triangles_center - [0, 0.2, 0])
            > 0
        )
        > 0.9
    )
    for part in (
        handle,
        spout,
    ):  # away from the plane in which its middle lies, but within the lip of the spout
        side = part.triangles_center[:, 2]
        assert np.mean(part.face_normals[:, 2] * side > 0) > 0.7


def test_the_teapot_goes_through_newells_points() -> None:
    body, lid = (
        newell.turned(newell.BODY, (2, 2, 2, 2), 8),
        newell.turned(newell.LID, (2, 2), 8),
    )
    assert body[0, 0] == pytest.approx([1.4, 0, 2.4]) and body[4, 2] == pytest.approx(
        [0, 2, 0.9]
    )
    assert lid[0] == pytest.approx(np.tile([0, 0, 3.15], (8, 1))) and lid[
        -1, 4
    ] == pytest.approx([-1.3, 0, 2.4])
    # in the middle of a patch: each control point with its weight
    quarter = newell.bernstein(np.array([0.5]))[0]
    assert body[3, 1, 0] == pytest.approx(
        quarter @ [1, 1, 0.56, 0] * (quarter @ [1.5, 1.75, 2, 2])
    )
    handle, spout = (
        newell.tube(newell.HANDLE, (1, 1), 4),
        newell.tube(newell.SPOUT, (1, 1), 4),
    )
    assert handle[0, 0] == pytest.approx([-1.6, 0, 2.025]) and handle[
        -1, 2
    ] == pytest.approx([-1.9, 0, 0.6])
    assert spout[1, 2] == pytest.approx([3.3, 0, 2.4]) and spout[0, 1] == pytest.approx(
        [1.7, -0.66 * 0.75, 1.0125]
    )
    assert spout[:, 3] == pytest.approx(spout[:, 1] * [1, -1, 1])


def test_teapot_cube_and_rabbit_stand_side_by_side() -> None:
    group = made("group")
    boxes = [
        np.array([m.bounds for m in group[k]])
        for k in (slice(0, 4), slice(4, 5), slice(5, 6))
    ]
    spans = [(b[:, 0].min(0), b[:, 1].max(0)) for b in boxes]
    for (_, left), (right, _) in itertools.pairwise(spans):
        assert left[0] < right[0]
    assert [low[1] for low, _ in spans] == pytest.approx([0, 0, 0], abs=0.002)


def test_a_model_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no model 'duck'"):
        write_model("duck", tmp_path / "duck.glb")
