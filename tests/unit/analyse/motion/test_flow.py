"""Background motion and the field of sites: true motion is followed, rest is rest, a cut
begins anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest

from arfx.analyse.job import AnalysisFrame
from arfx.analyse.motion.advection import determinants, relaxed, with_advection
from arfx.analyse.motion.flow import (
    BORDER,
    GRID_PX,
    BackgroundMotion,
    MotionStep,
    node_positions,
)
from arfx.core.facts import ABSENT, MEASURED, FrameFacts
from arfx.core.pose import Pose
from arfx.stages.watercolor import field as reader
from arfx.stages.watercolor.sites import GRID_PX as STAGE_GRID_PX
from tests.scenes import camera, look_at, scene

W, H = 320, 240


@cache
def texture(seed: int = 0) -> np.ndarray:
    """(700, 700) uint8 blotches of several sizes."""
    g = np.random.default_rng(seed)
    t = sum(
        cv2.GaussianBlur(g.standard_normal((700, 700)), (0, 0), s) * s
        for s in (2, 5, 12)
    )
    made = np.clip(128 + 45 * t / t.std(), 0, 255).astype(np.uint8)
    made.setflags(write=False)
    return made


def view(world: np.ndarray, world_from_px: np.ndarray, seed: int) -> np.ndarray:
    """A frame with noise of 2 grey levels. world_from_px : (2, 3)"""
    m = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    frame = cv2.warpAffine(
        world, world_from_px, (W, H), flags=m, borderMode=cv2.BORDER_REFLECT
    ).astype(float)
    return np.clip(
        frame + np.random.default_rng(seed).normal(0, 2, frame.shape), 0, 255
    ).astype(np.uint8)


def pan(t: int) -> np.ndarray:
    return np.array([[1, 0, 150 + 2.5 * t], [0, 1, 150 - 1.0 * t]])


def zoom(t: int) -> np.ndarray:
    s = 1.5 * 2 ** (-t / 12)
    return np.array([[s, 0, 350 - s * W / 2], [0, s, 350 - s * H / 2]])


def roll(t: int) -> np.ndarray:
    c, s = np.cos(0.02 * t), np.sin(0.02 * t)
    return np.array(
        [[c, -s, 350 - c * W / 2 + s * H / 2], [s, c, 350 - s * W / 2 - c * H / 2]]
    )


def still(t: int) -> np.ndarray:
    return pan(0)


def folded(frames: list[np.ndarray]) -> BackgroundMotion:
    motion = BackgroundMotion()
    for k, frame in enumerate(frames):
        motion.step(AnalysisFrame(k, k / 30, frame))
    return motion


@cache
def followed(path: Callable[[int], np.ndarray], n: int) -> BackgroundMotion:
    return folded([view(texture(), path(t), t) for t in range(n)])


def field_of(f: FrameFacts) -> tuple[np.ndarray, np.ndarray]:
    assert f.advection is not None
    return f.advection.places()


def facts_of(
    motion: BackgroundMotion, n: int, **shots: int
) -> tuple[FrameFacts, ...]:
    cut = shots.get("cut", n)
    frames = [FrameFacts(k, k / 30, shot=int(k >= cut)) for k in range(n)]
    return with_advection(frames, motion.steps, camera(W, H), Pose.identity(), 0.0)


@pytest.mark.parametrize("path", [pan, zoom, roll])
def test_the_field_follows_true_motion(path: Callable[[int], np.ndarray]) -> None:
    """After a dozen frames a place in the picture still knows where it was in the first, to
    .3 px.
    """
    n = 13
    facts = facts_of(followed(path, n), n)
    u, v = field_of(facts[-1])
    gx, gy = np.moveaxis(node_positions(W, H), -1, 0)
    now, first = (np.vstack([path(t), [0, 0, 1]]) for t in (n - 1, 0))
    true = (
        np.linalg.inv(first)
        @ now
        @ np.stack([gx.ravel(), gy.ravel(), np.ones(gx.size)])
    )
    missed = np.hypot(u.ravel() - true[0], v.ravel() - true[1])
    inside = ((gx >= 0) & (gx < W) & (gy >= 0) & (gy < H)).ravel()
    assert np.median(missed[inside]) < 0.15 and missed[inside].max() < 0.3


@pytest.mark.parametrize("brighter", [0, 12])
@pytest.mark.parametrize("move_px", [(1.25, -0.75), (7.5, 2.0), (-0.5, 0.25)])
def test_nodes_are_moved_by_exact_shifts_to_a_tenth_of_a_pixel(
    move_px: tuple[float, float], brighter: int
) -> None:
    g = np.random.default_rng(0)
    world = (
        cv2.GaussianBlur(g.standard_normal((4 * H + 200, 4 * W + 200)), (0, 0), 10)
        * 10
    )

    def seen(by_px: tuple[float, float]) -> np.ndarray:
        x, y = (round(4 * (d + 20)) for d in by_px)
        part = world[y : y + 4 * H, x : x + 4 * W]
        frame = cv2.resize(part, (W, H), interpolation=cv2.INTER_AREA)
        return np.clip(120 + 50 * frame + g.normal(0, 1, (H, W)), 0, 255).astype(
            np.uint8
        )

    motion = folded([seen((0, 0)), cv2.add(seen(move_px), brighter)])
    back = motion.steps[1].back
    assert back is not None
    missed = np.linalg.norm(back - move_px, axis=-1)[BORDER:-BORDER, BORDER:-BORDER]
    assert np.sqrt((missed**2).mean()) < 0.1 and missed.max() < 0.3


def test_a_resting_camera_keeps_its_sites_in_noise() -> None:
    world = texture()
    motion = folded([view(world, still(0), t) for t in range(12)])
    assert len(motion.steps) == 1
    facts = facts_of(motion, 12)
    assert {f.advection.set for f in facts} == {0}


def test_a_new_set_only_where_the_picture_moved() -> None:
    world = texture()
    frames = [view(world, pan(t if t < 5 else 5), t) for t in range(12)]
    sets = [f.advection.set for f in facts_of(folded(frames), 12)]
    assert sets[:6] == [0, 1, 2, 3, 4, 5] and len(set(sets[6:])) <= 2


def test_a_cut_begins_anew_whether_or_not_the_flow_noticed() -> None:
    a, b = texture(1), texture(2)
    frames = [view(a, pan(t), t) for t in range(4)] + [
        view(b, pan(t), t) for t in range(4)
    ]
    for cut in (4, 2):  # as the flow sees it, and between two frames that are alike
        facts = facts_of(folded(frames), 8, cut=cut)
        u = [field_of(f)[0] for f in facts]
        assert np.abs(u[cut] - u[cut - 1]).min() > 1000
        gx = node_positions(W, H)[..., 0]
        assert np.ptp(u[cut] - gx) == 0
        assert np.abs(u[cut + 1] - u[cut]).max() < 20


@pytest.mark.parametrize(
    "frame", [np.zeros((H, W), np.uint8), np.full((H, W), 255, np.uint8)]
)
def test_flat_frames_do_not_move(frame: np.ndarray) -> None:
    assert len(folded([frame] * 3 + [frame ^ 1]).steps) == 1


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (9, 9), (20, 400)])
def test_any_size(size: tuple[int, int]) -> None:
    g = np.random.default_rng(0)
    motion = BackgroundMotion()
    for k in range(3):
        luma = g.integers(0, 256, size).astype(np.uint8)
        motion.step(AnalysisFrame(k, k / 30, luma))
    frames = [FrameFacts(k, k / 30) for k in range(3)]
    for f in with_advection(
        frames, motion.steps, camera(size[1], size[0]), Pose.identity(), 0.0
    ):
        assert np.isfinite(field_of(f)).all()


def test_noise_and_torn_motion_never_fold_the_field() -> None:
    g = np.random.default_rng(0)
    world = texture()
    frames = []
    for t in range(10):
        frame = view(world, pan(t), t)
        frame[:, W // 2 :] = view(world, pan(-3 * t), t)[
            :, W // 2 :
        ]  # the right half goes the other way, fast
        frames.append(frame)
    frames += [g.integers(0, 256, (H, W)).astype(np.uint8) for _ in range(3)]
    for f in facts_of(folded(frames), len(frames)):
        least = determinants(np.stack(field_of(f), -1))
        assert least.min() > 0.05 and least.max() < 20


def test_linear_fields_are_not_bent() -> None:
    gx, gy = np.moveaxis(node_positions(W, H), -1, 0)
    field = np.stack([0.3 * gx - 0.1 * gy + 5, 0.1 * gx + 0.3 * gy], -1)
    np.testing.assert_allclose(relaxed(field), field, atol=1e-9)


def test_near_the_marker_the_pose_is_believed() -> None:
    """A blank picture shows no motion; the poses do, and the sites on the plane go with it."""
    nodes = node_positions(W, H).shape[:2]
    even = np.zeros(nodes, np.uint8)
    steps = [
        MotionStep(0, None, True, even),
        MotionStep(1, np.zeros((*nodes, 2), np.float32), False, even),
    ]
    s = scene(camera(W, H))
    poses = [look_at(0.5, 40, 20), look_at(0.5, 40, 26)]
    given = [
        FrameFacts(k, k / 30, status=MEASURED, camera_from_world=p, opacity=1.0)
        for k, p in enumerate(poses)
    ]
    facts = with_advection(given, steps, s.camera, s.world_from_anchor, 0.15)
    where, pose = reader.frame_field(facts[1], s, 8.0, 0.0)
    assert pose == poses[1]
    ground = np.array([[0.05, 0.02, 0], [-0.04, 0.05, 0], [0.0, -0.06, 0]])
    before, now = (s.camera.project(p.apply(ground)) for p in poses)
    for place, was in zip(now, before, strict=True):
        i, j = ((place - [where.x0, where.y0]) / GRID_PX).round().astype(int)
        # to first order: the field around the nearest node
        node = np.array([where.x0 + GRID_PX * i, where.y0 + GRID_PX * j])
        jac = np.array([[where.u[j, i + 1] - where.u[j, i], where.u[j + 1, i] - where.u[j, i]],
                        [where.v[j, i + 1] - where.v[j, i], where.v[j + 1, i] - where.v[j, i]]]) / GRID_PX  # fmt: skip
        assert (
            np.linalg.norm(
                np.array([where.u[j, i], where.v[j, i]]) + jac @ (place - node) - was
            )
            < 1.5
        )
        assert np.linalg.norm(place - was) > 2.5


def test_the_stage_reads_what_is_written_and_json_keeps_it() -> None:
    world = texture()
    facts = facts_of(folded([view(world, pan(t), t) for t in range(4)]), 4)
    back = FrameFacts.from_json(json.loads(json.dumps(facts[-1].to_json())))
    assert GRID_PX == STAGE_GRID_PX and back.status == ABSENT
    where, pose = reader.frame_field(back, scene(camera(W, H)), 8.0, 0.5)
    assert pose is None and where.u.shape == node_positions(W, H).shape[:2]
    assert where.x0 == node_positions(W, H)[0, 0, 0]
    assert np.median(where.u - node_positions(W, H)[..., 0]) == pytest.approx(
        7.5, abs=0.4
    )


def test_detail_goes_with_the_things_and_holds_still() -> None:
    """A patch of texture on an even ground in a noisy pan: cells are finer on it, coarser
    beside it, and the wanted sizes at a place of the ground hardly change from frame to
    frame."""
    world = np.full((700, 700), 120, np.uint8)
    world[210:330, 260:330] = texture(3)[210:330, 260:330] // 2 + 40
    world[210:330:12, 260:330] = 230
    motion = folded([view(world, pan(t), t) for t in range(16)])
    facts = with_advection(
        [FrameFacts(t, t / 30) for t in range(16)],
        motion.steps,
        camera(W, H),
        Pose.identity(),
        0.0,
    )
    s, on, off = scene(camera(W, H)), [], []
    for t, f in enumerate(facts):
        field, _ = reader.frame_field(f, s, 8.0, 0.0)
        assert (field.size >= 8 * 2**-0.91).all() and (
            field.size <= 8 * 2**0.31
        ).all()
        x, y = (
            (295 - 150 - 2.5 * t - field.x0) / GRID_PX,
            (270 - 150 + t - field.y0) / GRID_PX,
        )
        grid = field.size.astype(np.float32)
        on.append(
            float(
                cv2.remap(
                    grid, np.float32([[x]]), np.float32([[y]]), cv2.INTER_LINEAR
                )[0, 0]
            )
        )
        off.append(float(field.size[-2, 4]))
    assert max(on) < 0.8 * 8 < 8 < min(off)
    assert np.abs(np.diff(np.log2(on))).max() < 0.08


def test_detail_goes_on_after_a_pause_and_begins_anew_at_a_cut() -> None:
    a, b = np.full((H, W), 90, np.uint8), view(texture(1), pan(0), 1)
    motion = folded([b, b, a, a])
    facts = [FrameFacts(t, t / 30, shot=t // 2) for t in range(4)]
    made = with_advection(facts, motion.steps, camera(W, H), Pose.identity(), 0.0)
    size = [
        reader.frame_field(f, scene(camera(W, H)), 8.0, 0.0)[0].size for f in made
    ]
    assert (
        np.array_equal(size[0], size[1])
        and size[0].mean() < 7
        and (size[2] > 8).all()
    )
