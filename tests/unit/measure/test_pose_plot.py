"""The report's plot of poses: what the curves show of a clip."""

from __future__ import annotations

import numpy as np

from arfx.core.facts import ABSENT, MEASURED, FrameFacts
from arfx.core.pose import Pose
from arfx.measure.pose_plot import STATUS_COLOUR, pose_plot
from arfx.run.pages import _templates


def facts_of(errors: list[float | None]) -> list[FrameFacts]:
    return [
        FrameFacts(
            index=k,
            time_s=k / 30,
            status=ABSENT if px is None else MEASURED,
            camera_from_world=None if px is None else Pose.identity(),
            reprojection_px=px,
        )
        for k, px in enumerate(errors)
    ]


def test_frames_without_a_pose_break_the_curve_and_colour_the_strip() -> None:
    plot = pose_plot(facts_of([0.1, 0.2, None, 0.3]), None, None)
    [(_, _, pieces)] = plot["error"]["curves"]
    assert [[y for _, y in piece] for piece in pieces] == [[0.1, 0.2], [0.3]]
    colours = [colour for _, _, colour in plot["strip"]]
    assert colours == [STATUS_COLOUR[s] for s in (MEASURED, ABSENT, MEASURED)]
    assert plot["strip"][-1][1] == plot["end"]


def test_the_peak_of_a_long_clip_is_drawn() -> None:
    errors = np.full(30_000, 0.1)
    errors[17_001] = 5.0
    plot = pose_plot(facts_of(errors.tolist()), None, None)
    [(_, _, [piece])] = plot["error"]["curves"]
    assert len(piece) <= 2000
    assert max(y for _, y in piece) == 5.0
    assert plot["error"]["top"] >= 5.0


def test_a_clip_without_frames_or_poses_is_drawn() -> None:
    for facts in ([], facts_of([None]), facts_of([None, None, None])):
        plot = pose_plot(facts, None, None)
        text = (
            "{% import 'measure/parts.html' as parts %}{{ parts.poses(plot, 'x') }}"
        )
        assert "nan" not in _drawn(text, plot)


def _drawn(text: str, plot: object) -> str:

    return _templates().from_string(text).render(plot=plot)
