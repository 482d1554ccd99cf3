"""Every observer of the analysis, fed a clip in stretches: their rows are joined, and nothing
of them is lost."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from arfx.analyse.clip import marker_poses
from arfx.analyse.job import PLANE, Analysis, AnalysisFrame, AnalysisJob
from arfx.analyse.light.frames import Reading
from arfx.analyse.light.observe import BackgroundChange
from arfx.analyse.light.seen import Snapshot
from arfx.analyse.markers import tracker
from arfx.analyse.markers.search import (
    FrameRow,
    OtherPrint,
    Sighting,
    choose_transfer,
    records,
)
from arfx.analyse.motion import flow
from arfx.analyse.motion.flow import KeyPicture, MotionStep, joined_steps
from arfx.analyse.pose.at_rest import FlowSample, RestPicture, rests
from arfx.analyse.tables import from_bytes, to_bytes
from arfx.core.marker import MarkerSpec, PatternSpec
from arfx.core.rect import Rect
from tests.exact import identical
from tests.observed import Observed
from tests.unit.analyse.synthetic import (
    background,
    camera,
    hung,
    picture,
    poster,
    tilted,
)

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
    """A frame of the clip below, as the observers read one."""

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
                (
                    M,
                    tilted(
                        [0.25 + 0.01 * k, 0.1, 0.02 * k], [-0.14 + 0.004 * k, 0.03, Z]
                    ),
                )
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
        luma = picture(
            CAM, markers, view, noise=1.0, blur_px=1.4, seed=k, linear=False
        )
        lit = 0.75 + 0.25 * np.cos(0.3 * k + np.linspace(0, 2, 480))
        return np.clip(luma * lit, 0, 255).astype(np.uint8)

    def luma(self) -> np.ndarray:
        return self.image

    def linear(self, rect: Rect) -> np.ndarray:
        return self._linear[rect.slices]

    def reduced(self, width: int) -> np.ndarray:
        return cv2.resize(
            self._linear, (width, width * 9 // 16), interpolation=cv2.INTER_AREA
        )

    @cached_property
    def _linear(self) -> np.ndarray:
        light = (self.image / np.float32(255)).astype(np.float32) ** 2
        return light[..., None] * np.array([1.0, 0.9, 0.7], np.float32)


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
KINDS = {
    *(FrameRow, Sighting, OtherPrint, FlowSample, RestPicture),
    *(Reading, BackgroundChange, Snapshot, MotionStep, KeyPicture),
}
WANTED = {"light", "environment", "flow", "lens"}
Made = dict[str, Observed]


@pytest.fixture(scope="module", autouse=True)
def quick_search() -> Iterator[None]:
    """Frames small enough for the tests are reduced, and prints lost and found, as in large ones."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracker, "LOSS_SEARCH_FRAMES", 2)
        patch.setattr(tracker, "SEARCH_INTERVAL_S", 0.6)
        patch.setattr(tracker, "REDUCED_PX", 50_000)
        yield


def made() -> Made:
    """What jobs observe, with everything that can be asked for."""
    more: dict[str, Any] = {"prints": {PRINT.key: PRINTED}}
    return {
        "markers": Observed(
            AnalysisJob((M, PRINT), CAM.scaled_to(960, 540), **more), WANTED, FRAMES
        ),
        "plane": Observed(AnalysisJob((), CAM, anchor=PLANE), WANTED, FRAMES),
    }


def shown(k: int, number: int) -> AnalysisFrame:
    frame, after = CLIP[k], CLIP[k + 1].luma if k + 1 < FRAMES else None
    return AnalysisFrame(number, frame.time_s, frame.luma(), frame, after)


def stretch(first: int, end: int, number: int = 0) -> Made:
    """What frames first ... end - 1 hold, numbered from `number`."""
    every = made()
    for k in range(first, end):
        for observed in every.values():
            observed.step(shown(k, number + k - first))
    return every


def joined(numbered: bool = True, cuts: tuple[int, ...] = CUTS) -> Made:
    """The clip by its stretches. numbered : their frames know their numbers in the clip"""
    whole = made()
    for a, b in pairwise(cuts):
        later = stretch(a, b, a if numbered else 0)
        for name, observed in whole.items():
            kept = from_bytes(to_bytes(later[name].tables()))
            observed.add(kept, 0 if numbered else a)
    return whole


@pytest.fixture(scope="module", autouse=True)
def flow_once() -> Iterator[None]:
    """The flow between two pictures, which depends on nothing else, is found once: stretch
    after stretch has the same ones.
    """
    kept: dict[tuple[Any, ...], Any] = {}

    def back(now: KeyPicture, reference: np.ndarray, find: Any = flow._back) -> Any:
        key = now.picture.tobytes(), reference.tobytes(), now.width, now.height
        if key not in kept:
            kept[key] = find(now, reference)
        return copy.deepcopy(kept[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flow, "_back", back)
        yield


@pytest.fixture(scope="module")
def uncut() -> Made:
    return stretch(0, FRAMES)


@pytest.fixture(scope="module")
def in_stretches() -> Made:
    return joined()


def test_the_clip_gives_every_table_rows(uncut: Made) -> None:
    """So that the tests below hold every one of them, those of new observers too."""
    given = {name for observed in uncut.values() for name in observed.tables()}
    assert given == {kind.__name__ for kind in KINDS}


def test_rows_come_back_from_a_file_as_they_were(uncut: Made) -> None:
    for observed, again in zip(uncut.values(), made().values(), strict=True):
        again.add(from_bytes(to_bytes(observed.tables())))
        rows = observed.observation.rows()
        for kind in {type(row) for row in rows}:
            one = [values(row) for row in rows if type(row) is kind]
            other = [*map(values, again.rows[kind])]
            assert one and identical(one, other), kind


def values(row: Any) -> Any:
    """What a row holds, numbers as Python's own."""
    if isinstance(row, np.generic):
        return row.item()
    if isinstance(row, tuple):
        return [values(v) for v in row]
    return (
        [values(getattr(row, f.name)) for f in fields(row)]
        if is_dataclass(row)
        else row
    )


def test_what_stretches_learned_is_what_the_clip_shows(
    uncut: Made, in_stretches: Made
) -> None:
    """But for what begins anew: where the whole frame was searched, when pictures are
    taken, where a pattern is aligned from.
    """
    one, cut = uncut["markers"], in_stretches["markers"]
    seen = []
    for observed in (one, cut):
        transfer = choose_transfer(observed.rows[Sighting])
        assert transfer == "gamma:1"
        seen.append(
            records(observed.rows[FrameRow], observed.rows[Sighting], transfer)
        )
    assert [r.frame for r in seen[1]] == [*range(FRAMES)]
    for a, b in zip(*seen, strict=True):
        assert a.time_s == b.time_s and identical(a.thumbnail, b.thumbnail)
        assert identical(
            *([d for d in r.detections if d.key == M.key] for r in (a, b))
        )
        found = [{d.key: d for d in r.detections} for r in (a, b)]
        assert found[0].keys() <= found[1].keys()
        assert all(
            np.abs(found[1][k].corners_px - d.corners_px).max() < 0.05
            for k, d in found[0].items()
        )
    twice = [observed.rows[OtherPrint] for observed in (one, cut)]
    assert twice[0] and {*twice[0]} <= {*twice[1]}
    readings = [
        [values(r) for r in observed.rows[Reading] if r.key == M.key]
        for observed in (one, cut)
    ]
    assert len(readings[1]) > 15 and identical(*readings)
    steps = joined_steps(cut.rows[MotionStep], cut.rows[KeyPicture])
    assert {3, 14, 15, 26} <= {
        s.frame for s in steps if s.key and s.back is not None
    }, "a border in a shot leads on"
    assert [s.frame for s in steps if s.back is None] == [0, CUT] and len(
        {s.frame for s in steps}
    ) == len(steps)
    rows = in_stretches["plane"].rows
    assert not rests(rows[RestPicture])[0]


def test_poses_of_coded_prints_do_not_depend_on_where_a_clip_is_cut() -> None:
    job = AnalysisJob((M,), CAM.scaled_to(960, 540))
    clips = []
    for cuts in ((0, FRAMES), CUTS):
        whole = Observed(job, (), FRAMES)
        for a, b in pairwise(cuts):
            part = Observed(job, (), FRAMES)
            for k in range(a, b):
                part.step(shown(k, k))
            whole.add(part.tables())
        clips.append(marker_poses(Analysis(), whole.rows, job))
    before, after = clips
    assert [(f.status, f.shot) for f in before.facts] == [
        (f.status, f.shot) for f in after.facts
    ]
    for a, b in zip(before.facts, after.facts, strict=True):
        assert (a.camera_from_world is None) or np.array_equal(
            a.camera_from_world.matrix, b.camera_from_world.matrix
        )


def test_frames_are_numbered_where_they_come_to_lie() -> None:
    numbered, again = (joined(n, (0, 11, 15)) for n in (True, False))
    assert numbered["markers"].rows[Reading]
    for name in ("markers", "plane"):
        for kind in KINDS - {OtherPrint}:  # dictionaries are looked for by number
            one, other = (
                [*map(values, clip[name].rows[kind])] for clip in (numbered, again)
            )
            assert identical(one, other), (name, kind)
