"""Every fold of the analysis, fed a clip in stretches: what they learned is joined, and
nothing of it is lost.

The folds are found, not listed: a new one fails here until the clip below gives all of its
state something to do."""

from __future__ import annotations

import copy
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

import arfx.analyse
import arfx.run
from arfx.analyse.fold import PLANE, Analysis, AnalysisFrame, AnalysisJob, Fold, Stateful
from arfx.analyse.folds import FOLDS, ON_PLANE, Analyser
from arfx.analyse.markers import pattern_tracker, tracker
from arfx.analyse.markers.tracker import Tracks
from arfx.analyse.motion import flow
from arfx.analyse.params import AnalyseParams
from arfx.core import codec
from arfx.core.marker import MarkerSpec, PatternSpec
from arfx.core.rect import Rect
from arfx.papers import FORMULAS
from tests.exact import identical
from tests.unit.analyse.synthetic import background, camera, hung, picture, poster, tilted

CAM = camera(480, 270, 450.0)
M, TWIN, OTHER = (
    MarkerSpec("36h11", 3, 0.1),
    MarkerSpec("36h11", 3, 0.07),
    MarkerSpec("36h11", 7, 0.075),
)
Z = 450 * 0.1 / 64
FRAMES, STEP_S, CUT = 44, 0.12, 36
PRINT, PRINTED = PatternSpec(Path("poster.png"), 0.15, 0.1), poster(150, 100)


@dataclass(frozen=True)
class Shown:
    """A frame of the clip below, as the folds read one."""

    k: int

    rect, time_s = Rect.of(480, 270), property(lambda self: STEP_S * self.k)

    @cached_property
    def image(self) -> np.ndarray:
        """Nothing of M for a while, then M under a light that turns, before a view that
        pans; a gap; a cut; a twin of M. Sharpened edges, so that what was assumed of them
        is corrected."""
        k = self.k
        markers = [(OTHER, tilted([0.1, 0.2, 0], [0.25, -0.13, Z]))]
        if 12 <= k < 28 or k >= 31:
            markers.append(
                (M, tilted([0.25 + 0.01 * k, 0.1, 0.02 * k], [-0.14 + 0.004 * k, 0.03, Z]))
            )
        if 34 <= k < CUT:
            markers.append((TWIN, tilted([0.1, 0.1, 0], [0.14, 0.1, Z])))
        wide = background(640, 270, 1 if k < CUT else 5)
        view = np.ascontiguousarray(wide[:, 2 * k : 2 * k + 480])
        if 7 <= k < 30:
            view = hung(
                CAM,
                PRINTED.mean(-1),
                PRINT.corners_m,
                tilted([0.1, 0.01 * k, 0], [0.02 * (k / 15 - 1), -0.11, Z]),
                view,
            )
        luma = picture(CAM, markers, view, noise=1.0, blur_px=1.4, seed=k, linear=False)
        lit = 0.75 + 0.25 * np.cos(0.3 * k + np.linspace(0, 2, 480))
        return np.clip(luma * lit, 0, 255).astype(np.uint8)

    def luma(self) -> np.ndarray:
        return self.image

    def linear_at(self, pixels: np.ndarray) -> np.ndarray:
        return self._linear[pixels[:, 1], pixels[:, 0]]

    def reduced(self, width: int) -> np.ndarray:
        return cv2.resize(
            self._linear, (width, width * 9 // 16), interpolation=cv2.INTER_AREA
        )

    @cached_property
    def _linear(self) -> np.ndarray:
        light = (self.image / np.float32(255)).astype(np.float32) ** 2
        return light[..., None] * np.array([1.0, 0.9, 0.7], np.float32)


KINDS = {"light": FORMULAS["paper"]["light"]}
CLIP = [Shown(k) for k in range(FRAMES)]
CUTS = (
    0,
    3,
    14,
    15,
    26,
    CUT,
    FRAMES,
)  # before anything is seen; a single frame; a cut at a border
Made = dict[str, Analyser]


@pytest.fixture(scope="module", autouse=True)
def quick_search() -> Iterator[None]:
    """Frames small enough for the tests are reduced, and prints lost and found, as in large ones."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracker, "LOSS_SEARCH_FRAMES", 2)
        for module in (tracker, pattern_tracker):
            patch.setattr(module, "REDUCED_PX", 50_000)
            patch.setattr(module, "SEARCH_INTERVAL_S", 0.6)
        yield


def made(transfer: str = "auto") -> Made:
    """What a job folds over its frames, with everything that can be asked for."""
    params = AnalyseParams(transfer=transfer)
    double, length_s = CAM.scaled_to(960, 540), FRAMES * STEP_S
    return {
        "markers": Analyser(
            AnalysisJob(
                (M, PRINT), double, params, prints={PRINT.key: PRINTED}, length_s=length_s
            ),
            FOLDS,
        ),
        "printed": Analyser(
            AnalysisJob((M,), double, params, kinds=KINDS, length_s=length_s),
            {"light", "environment"},
        ),
        "plane": Analyser(
            AnalysisJob((), CAM, params, anchor=PLANE, length_s=length_s), ON_PLANE
        ),
    }


def shown(k: int, number: int) -> AnalysisFrame:
    frame, after = CLIP[k], CLIP[k + 1].luma if k + 1 < FRAMES else None
    return AnalysisFrame(number, frame.time_s, frame.luma(), frame, after)


def stretch(
    first: int, end: int, lost: dict[str, Any], transfer: str = "auto", number: int = 0,
    look: Callable[[Made], None] = lambda _: None,
) -> tuple[Made, dict[str, Any]]:  # fmt: skip
    """What frames first ...

    end - 1 hold, numbered from `number`, and what the next stretch would lose. look : after
    each
    """
    folds = made(transfer)
    for name, analyser in folds.items():
        if lost.get(name) is not None:
            analyser.go_on(codec.loads(codec.dumps(lost[name])))
    for k in range(first, end):
        for analyser in folds.values():
            analyser.step(shown(k, number + k - first))
        look(folds)
    behind = (
        {name: a.end(shown(end, number + end - first)) for name, a in folds.items()}
        if end < FRAMES
        else {}
    )
    return folds, behind


def restored(folds: Made, transfer: str = "auto") -> Made:
    out = made(transfer)
    for name, analyser in out.items():
        analyser.restore(codec.loads(codec.dumps(folds[name].state())))
    return out


def joined(numbered: bool = True, cuts: tuple[int, ...] = CUTS) -> Made:
    """The clip by its stretches. numbered : their frames know their numbers in the clip"""
    whole, lost = made(), dict[str, Any]()
    for a, b in pairwise(cuts):
        part, behind = stretch(a, b, lost, "auto", a if numbered else 0)
        later = restored(part)
        for name, analyser in whole.items():
            if changes := analyser.settle(later[name]):
                again, behind[name] = (
                    stretch(a, b, lost, **changes, number=a if numbered else 0),
                    behind.get(name),
                )
                later[name] = restored(again[0])[name]
            analyser.join(later[name], 0 if numbered else a)
        lost = behind
    return whole


def state(folds: Made) -> dict[str, Any]:
    return {name: analyser.state() for name, analyser in folds.items()}


def modules() -> Iterator[ModuleType]:
    for room in (arfx.analyse, arfx.run):
        for m in pkgutil.walk_packages(room.__path__, room.__name__ + "."):
            if m.name != "arfx.run.preload":  # that loads compiled code, for seconds
                yield importlib.import_module(m.name)


def every_kind() -> set[type]:
    list(modules())
    out, left = set(), [Stateful]
    while left:
        for kind in left.pop().__subclasses__():
            out.add(kind)
            left.append(kind)
    return {kind for kind in out if kind.__module__.startswith("arfx.")} - {Fold, Tracks}


def within(top: Any) -> Iterator[Stateful]:
    if isinstance(top, Analyser):
        for fold in top.folds.values():
            yield from within(fold)
        return
    yield top
    for v in vars(top).values():
        if isinstance(v, Stateful) and not isinstance(v, Fold):
            yield from within(v)


def test_whatever_is_fed_frame_by_frame_is_a_fold() -> None:
    for module in modules():
        for _, kind in inspect.getmembers(module, inspect.isclass):
            fed = (
                "step" in vars(kind)
                and kind.__module__ == module.__name__
                and not getattr(kind, "_is_protocol", False)
            )
            assert not fed or kind is Analyser or issubclass(kind, Stateful), (
                f"{kind.__module__}.{kind.__name__} has a step"
            )


def own(f: Stateful) -> dict[str, Any]:
    return {
        n: v for n, v in vars(f).items() if n not in f.given and not isinstance(v, Stateful)
    }


@pytest.fixture(scope="module", autouse=True)
def flow_once() -> Iterator[None]:
    """The flow between two pictures, which depends on nothing else, is found once: stretch
    after stretch has the same ones.
    """
    kept: dict[tuple[Any, ...], Any] = {}

    def back(
        small: np.ndarray, reference: np.ndarray, *size: int, find: Any = flow._back
    ) -> Any:
        key = small.tobytes(), reference.tobytes(), small.shape, size
        if key not in kept:
            kept[key] = find(small, reference, *size)
        return copy.deepcopy(kept[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flow, "_back", back)
        yield


@pytest.fixture(scope="module")
def uncut_and_constant() -> tuple[Made, set[tuple[str, str]]]:
    """The clip in one stretch, and which attributes no frame changed."""
    folds = [f for top in made().values() for f in within(top)]
    first, constant = (
        [own(f) for f in folds],
        {(type(f).__name__, n) for f in folds for n in own(f)},
    )

    def look(folds: Made) -> None:
        for before, f in zip(
            first, (f for top in folds.values() for f in within(top)), strict=True
        ):
            constant.difference_update(
                (type(f).__name__, n)
                for n, v in own(f).items()
                if not identical(v, before[n])
            )

    return stretch(0, FRAMES, {}, look=look)[0], constant


@pytest.fixture(scope="module")
def uncut(uncut_and_constant: tuple[Made, set[tuple[str, str]]]) -> Made:
    return uncut_and_constant[0]


@pytest.fixture(scope="module")
def in_stretches() -> Made:
    return joined()


def test_every_attribute_is_given_or_carried_or_learned(
    uncut_and_constant: tuple[Made, set[tuple[str, str]]],
) -> None:
    uncut, constant = uncut_and_constant
    folds = [f for top in uncut.values() for f in within(top)]
    assert {type(f) for f in folds} == every_kind(), (
        "the test does not make every fold, or not with all that it can do"
    )
    assert all(f.given | f.carried <= vars(f).keys() for f in folds)
    assert not constant, (
        "state that nothing in the clip changes: is it given, or does the clip lack it?"
    )


def test_one_stretch_joined_to_nothing_is_that_stretch(uncut: Made) -> None:
    whole, later = made(), restored(uncut)
    for name, analyser in whole.items():
        assert not analyser.settle(later[name])
        analyser.join(later[name])
    assert identical(state(whole), state(uncut))


def test_what_stretches_learned_is_what_the_clip_shows(
    uncut: Made, in_stretches: Made
) -> None:
    """But for what begins anew: where the whole frame was searched, when pictures are
    taken, where a pattern is aligned from.
    """
    exact = {M.key, OTHER.key}
    for name in ("markers", "printed"):
        one, cut = (folds[name].folds["markers"] for folds in (uncut, in_stretches))
        assert [r.index for r in cut.records] == [*range(FRAMES)]
        for a, b in zip(one.records, cut.records, strict=True):
            assert (a.time_s, a.dissimilarity) == (b.time_s, b.dissimilarity) and identical(
                a.duplicates, b.duplicates
            )
            assert identical(*([d for d in r.detections if d.key in exact] for r in (a, b)))
            seen = [{d.key: d for d in r.detections} for r in (a, b)]
            assert seen[0].keys() <= seen[1].keys()
            assert all(
                np.abs(seen[1][k].corners_px - d.corners_px).max() < 0.05
                for k, d in seen[0].items()
            )
        assert one._refiner.transfer == cut._refiner.transfer == "gamma:1"
    one, cut = (folds["printed"].folds for folds in (uncut, in_stretches))
    # until a stretch has decided in what edges are symmetric its samples lie by the corners
    # as they were assumed
    assert [r[:2] for r in cut["light"].readings] == [
        r[:2] for r in one["light"].readings
    ] and len(cut["light"].readings) > 15
    cut = in_stretches["markers"].folds
    steps = cut["flow"]._motion.steps
    assert {3, 14, 15, 26} <= {s.index for s in steps if s.key and s.back is not None}, (
        "a border in a shot leads on"
    )
    assert [s.index for s in steps if s.back is None] == [0, CUT] and len(
        {s.index for s in steps}
    ) == len(steps)
    assert (
        in_stretches["plane"].folds["pose"].times_s == uncut["plane"].folds["pose"].times_s
    )
    assert not in_stretches["plane"].folds["pose"].rest.rests
    before, after = (
        folds["printed"].folds["pose"].finish(Analysis()) for folds in (uncut, in_stretches)
    )
    assert [(f.status, f.shot) for f in before.facts] == [
        (f.status, f.shot) for f in after.facts
    ]
    for a, b in zip(before.facts, after.facts, strict=True):
        assert (a.camera_from_world is None) or np.array_equal(
            a.camera_from_world.matrix, b.camera_from_world.matrix
        )


def test_frames_are_numbered_where_they_come_to_lie() -> None:
    numbered, again = state(joined(cuts=(0, 11, 15))), state(joined(False, (0, 11, 15)))
    assert (
        numbered["markers"]["light"]["readings"]
        and numbered["printed"]["light"]["readings"]
    )
    for name in ("markers", "printed", "plane"):
        a, b = again[name], numbered[name]
        for fold in a.keys() & {"markers"}:  # other dictionaries are looked for by number
            a[fold].pop("_survey"), b[fold].pop("_survey")
        assert identical(a, b), name
