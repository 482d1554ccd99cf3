"""What is made of a model and of how it stands is made once, however many jobs have it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from arfx.stages.gi import stage
from arfx.stages.light.region import shadow_region
from tests.scenes import box_model, camera, scene


def test_later_jobs_find_transport_and_shadow_region(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Red without `memo_of`: every scene makes its own."""
    made: list[Any] = []

    def make(*args: Any) -> Any:
        made.append(args)
        return Transport(*args)

    Transport = stage.Transport
    monkeypatch.setattr(stage, "Transport", make)
    model, gi = replace(box_model()), stage.Gi()  # its own: other tests share theirs
    first, later = scene(model=model), scene(camera(320, 240), model=model)
    one, two = gi.prepare(first, "draft"), gi.prepare(later, "draft")
    assert (
        one is not None
        and two is not None
        and one.transport is two.transport
        and len(made) == 1
    )
    assert shadow_region(first) is shadow_region(later)
    elsewhere = replace(
        first, world_from_model=np.diag([1.5, 1.5, 1.5, 1]) @ first.world_from_model
    )
    assert gi.prepare(
        elsewhere, "draft"
    ).transport is not one.transport and shadow_region(
        elsewhere
    ) is not shadow_region(first)
    assert gi.prepare(first, "standard").transport is not one.transport, (
        "another level has other rays"
    )
    assert (
        gi.prepare(scene(model=replace(model)), "draft").transport
        is not one.transport
    ), "another model, if it looks the same"
