"""Every fold of the analysis, stopped after every frame: what it goes on to is the same, bit for bit.

The folds are found, not listed: a new one fails here until the clip below gives all of its state something to do.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

import arfx.analyse
import arfx.run
from arfx.analyse.fold import PLANE, AnalysisFrame, AnalysisJob, Fold, Stateful
from arfx.analyse.folds import FOLDS, ON_PLANE, Analyser
from arfx.analyse.light import fold as light_fold
from arfx.analyse.params import AnalyseParams
from arfx.analyse.pose import at_rest
from arfx.core import codec
from arfx.core.marker import MarkerSpec, PatternSpec
from arfx.core.rect import Rect
from arfx.papers import FORMULAS
from arfx.run.analysis import Span
from tests.exact import identical
from tests.unit.analyse.synthetic import background, camera, hung, picture, poster, tilted

CAM = camera(480, 270, 450.0)
M, TWIN, OTHER = MarkerSpec("36h11", 3, 0.1), MarkerSpec("36h11", 3, 0.07), MarkerSpec("36h11", 7, 0.075)
Z = 450 * 0.1 / 64
FRAMES, STEP_S, CUT = 44, 0.12, 36
PRINT, PRINTED = PatternSpec(Path("poster.png"), 0.15, 0.1), poster(150, 100)


@dataclass(frozen=True)
class Shown:
    """A frame of the clip below, as the folds and the span read one."""

    k: int

    rect, key = Rect.of(480, 270), property(lambda self: self.k % 10 == 0)
    pts, time_s = property(lambda self: 100 + 12 * self.k), property(lambda self: STEP_S * self.k)

    @cached_property
    def image(self) -> np.ndarray:
        """Nothing of M for a while, then M under a light that turns, before a view that pans; a gap; a cut; a twin of M.
        Sharpened edges, so that what was assumed of them is corrected."""
        k = self.k
        markers = [(OTHER, tilted([0.1, 0.2, 0], [0.25, -0.13, Z]))]
        if 12 <= k < 28 or k >= 31:
            markers.append((M, tilted([0.25 + 0.01 * k, 0.1, 0.02 * k], [-0.14 + 0.004 * k, 0.03, Z])))
        if 34 <= k < CUT:
            markers.append((TWIN, tilted([0.1, 0.1, 0], [0.14, 0.1, Z])))
        wide = background(640, 270, 1 if k < CUT else 5)
        view = np.ascontiguousarray(wide[:, 2 * k : 2 * k + 480])
        if 7 <= k < 30:
            view = hung(CAM, PRINTED.mean(-1), PRINT.corners_m, tilted([0.1, 0.01 * k, 0], [0.02 * (k / 15 - 1), -0.11, Z]), view)
        luma = picture(CAM, markers, view, noise=1.0, blur_px=1.4, seed=k, linear=False)
        lit = 0.75 + 0.25 * np.cos(0.3 * k + np.linspace(0, 2, 480))
        return np.clip(luma * lit, 0, 255).astype(np.uint8)

    def luma(self) -> np.ndarray:
        return self.image

    def linear_at(self, pixels: np.ndarray) -> np.ndarray:
        return self._linear[pixels[:, 1], pixels[:, 0]]

    def reduced(self, width: int) -> np.ndarray:
        return cv2.resize(self._linear, (width, width * 9 // 16), interpolation=cv2.INTER_AREA)

    @cached_property
    def _linear(self) -> np.ndarray:
        light = (self.image / np.float32(255)).astype(np.float32) ** 2
        return light[..., None] * np.array([1.0, 0.9, 0.7], np.float32)


KINDS = {"light": FORMULAS["paper"]["light"]}
CLIP = [Shown(k) for k in range(FRAMES)]


def made() -> dict[str, Any]:
    """What a job folds over its frames, with everything that can be asked for."""
    params = AnalyseParams(reduced_px=50_000, search_interval_s=0.6, loss_search_frames=2)
    double = CAM.scaled_to(960, 540)
    return {
        "markers": Analyser(AnalysisJob((M, PRINT), double, params, prints={PRINT.key: PRINTED}), FOLDS),
        "printed": Analyser(AnalysisJob((M,), double, params, kinds=KINDS), {"light", "environment"}),
        "plane": Analyser(AnalysisJob((), CAM, params, anchor=PLANE), ON_PLANE),
        "span": Span((2 * STEP_S, (FRAMES - 3) * STEP_S), Fraction(1, 100)),
    }


def frames(span: Span) -> Iterator[tuple[Shown, Shown | None]]:
    """As run.analysis feeds them."""
    inside = span.inside(CLIP)  # type: ignore[arg-type]
    frame = next(inside, None)
    while frame is not None:
        following = next(inside, None)
        yield frame, following  # type: ignore[misc]
        frame = following


def step(folds: dict[str, Any], frame: Shown, following: Shown | None) -> None:
    after = None if following is None else following.luma
    for name in ("markers", "printed", "plane"):
        folds[name].step(AnalysisFrame(len(folds["span"].pts), frame.time_s, frame.luma(), frame, after))
    folds["span"].take(frame)


def state(folds: dict[str, Any]) -> dict[str, Any]:
    return {name: fold.state() for name, fold in folds.items()}


def modules() -> Iterator[ModuleType]:
    for room in (arfx.analyse, arfx.run):
        for m in pkgutil.walk_packages(room.__path__, room.__name__ + "."):
            yield importlib.import_module(m.name)


def every_kind() -> set[type]:
    list(modules())
    out, left = set(), [Stateful]
    while left:
        for kind in left.pop().__subclasses__():
            out.add(kind)
            left.append(kind)
    return {kind for kind in out if kind.__module__.startswith("arfx.")} - {Fold}


def within(top: Any) -> Iterator[Stateful]:
    if isinstance(top, Analyser):
        for fold in top.folds.values():
            yield from within(fold)
        return
    yield top
    for v in vars(top).values():
        if isinstance(v, Stateful) and not isinstance(v, Fold):
            yield from within(v)


@pytest.fixture
def soon_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists that are thinned out where a clip is long are so in this one."""
    monkeypatch.setattr(at_rest, "MAX_SAMPLES", 4)
    monkeypatch.setattr(light_fold, "MOST_ENVIRONMENT_SAMPLES", 3)


def test_whatever_is_fed_frame_by_frame_is_a_fold() -> None:
    for module in modules():
        for _, kind in inspect.getmembers(module, inspect.isclass):
            fed = "step" in vars(kind) and kind.__module__ == module.__name__ and not getattr(kind, "_is_protocol", False)
            assert not fed or kind is Analyser or issubclass(kind, Stateful), f"{kind.__module__}.{kind.__name__} has a step"


def test_a_fold_goes_on_from_any_frame_to_the_same_bits(soon_thinned: None) -> None:
    whole, stopped = made(), made()
    folds = [f for top in whole.values() for f in within(top)]
    assert {type(f) for f in folds} == every_kind(), "the test does not make every fold, or not with all that it can do"
    constant = {(type(f).__name__, name) for f in folds for name in vars(f) if name not in f.given}
    constant -= {(type(f).__name__, name) for f in folds for name, v in vars(f).items() if isinstance(v, Stateful)}
    fixed = [(f, name, getattr(f, name)) for f in folds for name in f.given]
    before = [dict(f.state()) for f in folds]
    before = codec.loads(codec.dumps(before))
    count = 0
    for frame, following in frames(whole["span"]):
        step(whole, frame, following)
        saved = codec.dumps(state(stopped))
        stopped = made()
        for name, fold_state in codec.loads(saved).items():
            stopped[name].restore(fold_state)
        assert identical(state(stopped), codec.loads(saved))
        step(stopped, *next(frames(stopped["span"])))
        assert identical(state(stopped), state(whole)), f"frame {frame.k}"
        constant -= {
            (type(f).__name__, name)
            for f, first in zip(folds, before, strict=True)
            for name, v in f.state().items()
            if not isinstance(getattr(f, name), Stateful) and not identical(v, first[name])
        }
        count += 1
    assert count == len(whole["span"].pts) == FRAMES - 4
    assert not constant, "state that nothing in the clip changes: what is given, or what the clip lacks?"
    assert all(getattr(f, name) is value for f, name, value in fixed), "a given attribute changed"
    light, lens = (whole["markers"].folds[name] for name in ("light", "lens"))
    assert len(light.readings) > 20 and lens.readings
    assert identical(stopped["markers"].finish(), whole["markers"].finish())
