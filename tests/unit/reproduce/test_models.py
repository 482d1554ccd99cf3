"""The models of the papers' tables and figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from arfx.media.models import load_model
from arfx.reproduce.work import MODELS, Work


@pytest.mark.parametrize(
    ("name", "faces"),
    [("apple", 4000), ("teapot", 6000), ("aeroplane", 21000), ("cube", 12)],
)
def test_as_many_faces_as_the_table_says(
    name: str, faces: int, tmp_path: Path
) -> None:
    assert load_model(Work(tmp_path).model(name)).face_count == faces


@pytest.mark.parametrize("file", sorted(MODELS.iterdir()), ids=lambda file: file.stem)
def test_faces_have_an_area(file: Path) -> None:
    parts = load_model(file).parts
    corners = np.concatenate([part.vertices[part.faces] for part in parts])
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.min() > 0
