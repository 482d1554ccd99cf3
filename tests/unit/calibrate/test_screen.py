"""Views that must not take part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from arfx.calibrate.screen import (
    drop_copies,
    drop_corners,
    most_varied,
    reject_views,
    rejection_limit_px,
    sharpest_of_each,
)
from arfx.core.camera import Camera
from tests.unit.calibrate.boards import (
    CHESS,
    SIZE,
    TRUE,
    names,
    poses,
    render,
    view,
    views,
)


def test_copies_count_once_and_the_sharpest_stays() -> None:
    some = views(6)
    rng = np.random.default_rng(3)
    blurred = [
        replace(view(p, rng, name=f"copy{i}"), sharpness=0.2)
        for i, p in enumerate(poses(6)[:2])
    ]
    turned = replace(
        some[3], name="turned", pixels=some[3].pixels[::-1].copy(), sharpness=0.1
    )
    kept, dropped = drop_copies([*blurred, *some, turned])
    assert names(kept) == names(some)
    assert sorted(names(dropped)) == ["copy0", "copy1", "turned"]
    assert (
        "the same view as v00" in next(d for d in dropped if d.name == "copy0").reason
    )


def test_a_copy_does_not_make_the_uncertainty_smaller() -> None:
    some = views(8)
    kept, _ = drop_copies(some + [replace(v, name=v.name + "b") for v in some])
    assert len(kept) == 8


@pytest.mark.parametrize("bad_share", [1, 4])
def test_views_of_another_camera_are_rejected_not_averaged(bad_share: int) -> None:
    other = Camera(*SIZE, np.array([[760.0, 0, 300], [0, 760, 250], [0, 0, 1]]))
    rng = np.random.default_rng(0)
    bad = [
        view(p, rng, 0.1, f"bad{i}", other)
        for i, p in enumerate(poses(bad_share, seed=5))
    ]
    mixed = views(10)
    mixed[2:2] = bad
    fitted, rejected = reject_views(mixed)
    assert sorted(names(rejected)) == sorted(names(bad))
    assert "with the camera of the other views" in rejected[0].reason
    assert fitted.camera.fx == pytest.approx(TRUE.fx, abs=3)


def test_of_three_views_each_is_needed() -> None:
    for noise_px in (0.3, 1.0, 2.0):
        some = views(3)
        some[1] = views(3, seed=9, noise_px=noise_px)[1]
        fitted, rejected = reject_views(some)
        assert not rejected and fitted.camera.fx == pytest.approx(TRUE.fx, rel=0.1)


def test_a_wrong_corner_costs_the_corner_not_the_view() -> None:
    some = views(10)
    wrong = some[4].pixels.copy()
    wrong[7] += [6, -3]
    some[4] = replace(some[4], pixels=wrong)
    fitted, rejected = reject_views(some)
    assert not rejected
    trimmed = drop_corners(fitted)
    assert sum(len(v.ids) for v in trimmed) == 10 * 54 - 1
    assert 7 not in trimmed[4].ids
    assert len(trimmed[4].pixels) == 53


def test_good_views_are_not_rejected_by_chance() -> None:
    for seed in range(5):
        _, rejected = reject_views(views(12, seed=seed))
        assert not rejected


def test_the_limit_follows_the_views() -> None:
    assert rejection_limit_px(np.array([0.2, 0.2, 0.2])) == pytest.approx(0.4)
    assert rejection_limit_px(np.array([0.1, 0.2, 0.3, 0.4, 0.5])) == pytest.approx(
        0.3 + 5 * 0.14826
    )


def test_of_a_video_the_varied_sharp_views_are_kept() -> None:
    near = [replace(views(1, seed=k)[0], name=f"same{k}") for k in range(30)]
    blurred = [replace(v, name="blurred", sharpness=0.1) for v in views(3)]
    different = [replace(v, name=f"different{i}") for i, v in enumerate(views(6)[1:])]
    kept = most_varied([*near[:15], *different, *blurred, *near[15:]], 6)
    assert sorted(n for n in names(kept) if n.startswith("different")) == [
        f"different{i}" for i in range(5)
    ]
    assert "blurred" not in names(kept)
    assert most_varied(near[:4], 6) == near[:4]


def test_of_each_stretch_of_frames_the_sharpest_is_searched() -> None:
    pose = poses(1)[0]
    frames = [
        (f"{b}", render(CHESS, pose, blur_px=b)) for b in (3.0, 0.7, 2.0, 2.5, 1.0)
    ]
    assert [name for name, _ in sharpest_of_each(iter(frames), 3)] == ["0.7", "1.0"]
    assert [name for name, _ in sharpest_of_each(iter(frames), 1)] == [
        name for name, _ in frames
    ]
