"""Health of the estimates: seams and furnaces are told from sound ones, what is not finite
is counted, files are read.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.analyse.pose.figures import _deviations
from arfx.core.cube import face_directions
from arfx.core.pixels import Pixels
from arfx.core.stage import Check, JobView
from arfx.run.summary import picture
from arfx.stages.gi.health import LIMIT, furnace_mean, seam_ratio, seams
from tests.scenes import facts, scene


def test_a_smooth_environment_has_no_seam_and_a_face_of_another_brightness_has() -> (
    None
):
    d = face_directions(8)
    smooth = 0.5 + 0.3 * d[..., :1] + 0.2 * d[..., 1:2] * np.ones(3)
    assert seam_ratio(smooth) < 1.6
    assert seam_ratio(np.full_like(smooth, 0.4)) == pytest.approx(1), (
        "a constant map is seamless"
    )
    broken = smooth + np.array([0, 1, 0, 1, 0, 1])[:, None, None, None]
    assert seam_ratio(broken) > 3


def test_seams_of_what_the_clip_saw_are_told() -> None:
    d = face_directions(64)
    smooth = np.concatenate(
        [0.5 + 0.3 * d[..., :1] * np.ones(3), np.ones_like(d[..., :1])], -1
    )
    broken = smooth + np.array([0, 1, 0, 1, 0, 1])[:, None, None, None]
    for rgba, ok in ((smooth, True), (broken, False)):
        (check,) = seams(
            JobView(
                (),
                replace(scene(), environment_maps={"a": rgba.astype(np.float16)}),
                {},
                picture,
            )
        )
        assert check.ok is ok
    assert not [*seams(JobView((), scene(), {}, picture))]


def test_the_white_furnace_of_a_box_vanishes_and_lost_light_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    job = JobView((), scene(), {"gi": frozenset({"draft"})}, picture)
    assert furnace_mean(job, "draft") == pytest.approx(1, abs=LIMIT)
    from arfx.stages.gi.stage import Gi

    run = Gi.run

    def darker(self, window, *rest):  # type: ignore[no-untyped-def]
        made = dict(run(self, window, *rest))
        for layer, a in made.items():
            if isinstance(a, Pixels):
                made[layer] = Pixels(a.rect, 0.9 * a.array)
            else:
                made[layer] = 0.9 * a
        return made

    monkeypatch.setattr(Gi, "run", darker)
    assert abs(furnace_mean(job, "draft") - 1) > LIMIT


def test_deviation_is_in_degrees_and_percent() -> None:
    f = facts(scene())
    c = np.diag([1e-4, 1e-4, 4e-4, 1e-6, 1e-6, 4e-6])
    turn, share = _deviations([f.with_(pose_covariance=c), f])
    assert turn == pytest.approx(np.degrees(0.02)) and share == pytest.approx(
        100 * 0.002 / 0.5
    )
    assert _deviations([f]) == (None, None)


def test_a_check_that_failed_says_what_was_done() -> None:
    assert (
        Check("a", 2, 1, False, "told").to_json()["action"] == "told"
        and Check("a", 0, 1, True, "told").to_json()["action"] == "none"
    )
