"""The throw-away frame that loads compiled code: it must stay cheap whatever quality the job asks for."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from arfx.run import warm


@pytest.mark.parametrize(
    ("quality", "used"), [("draft", "draft"), ("standard", "standard"), ("high", "standard"), ("reference", "standard")]
)
def test_dear_qualities_are_warmed_up_at_a_quick_level(quality: str, used: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def level_named(levels: object, name: str) -> object:
        asked.append(name)
        raise StopIteration

    monkeypatch.setattr(warm, "level_named", level_named)
    monkeypatch.setattr(warm, "make_stages", lambda config: {"dof": SimpleNamespace(levels=())})
    monkeypatch.setattr(warm, "make_scene", lambda *a: SimpleNamespace(model_corners_m=np.array([[0.0, 0, 0], [1, 1, 1]])))
    monkeypatch.setattr(warm, "with_model", lambda facts, scene: facts)
    config = SimpleNamespace(markers=(), model=SimpleNamespace(anchor="plane"), pipeline=SimpleNamespace(quality=quality, seed=0))
    with pytest.raises(StopIteration):
        warm.warm_up(config, SimpleNamespace(camera=None, model=None))  # type: ignore[arg-type]
    assert asked == [used]
