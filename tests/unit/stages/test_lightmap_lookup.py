"""The shadow's look-up against one written down plainly, pixel by pixel in float64."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from arfx.core.camera import Camera
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.rect import Rect
from arfx.stages.light.plane_lookup import PlaneTexture, PlaneView, shadow_ratio
from arfx.stages.viewing import between_nodes, direction_grid

FAINT = 0.02


def camera(bent: bool) -> Camera:
    k = np.array([[300.0, 0, 158], [0, 305, 118], [0, 0, 1]])
    return Camera(
        320,
        240,
        k,
        np.array([-0.25, 0.08, 0.002, -0.001, 0.0]) if bent else np.zeros(5),
    )


def spot(
    rng: np.random.Generator,
    rows: int,
    columns: int,
    turn_deg: float,
    at: tuple[float, float],
    texel_m: float = 0.002,
) -> PlaneTexture:
    """A smooth blob of darkness with a border of zeros, turned about its middle, which lies
    at `at` metres.
    """
    dark = np.zeros((rows, columns), np.float32)
    cv2.ellipse(
        dark,
        (columns // 2, rows // 2),
        (columns // 4, rows // 5),
        rng.uniform(0, 180),
        0,
        360,
        0.9,
        -1,
    )
    dark = np.asarray(cv2.GaussianBlur(dark, (0, 0), 3), np.float32)
    dark[[0, 1, -2, -1]], dark[:, [0, 1, -2, -1]] = 0, 0
    a, scale = np.radians(turn_deg), 1 / texel_m
    linear = scale * np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    return PlaneTexture(
        dark,
        np.column_stack([linear, np.array([columns / 2, rows / 2]) - linear @ at]),
    )


def plainly(
    rect: Rect, grid: np.ndarray, anchor_from_camera: Pose, textures: list[PlaneTexture], shares: np.ndarray,
    blocked: PlaneTexture | None, strength: float,
) -> np.ndarray:  # fmt: skip
    d = (
        between_nodes(grid.astype(np.float32), rect).astype(float)
        @ anchor_from_camera.rotation.T
    )
    with np.errstate(all="ignore"):
        s = np.where(
            d[..., 2] < 0, -anchor_from_camera.translation_m[2] / d[..., 2], np.nan
        )
    place = anchor_from_camera.translation_m[:2] + s[..., None] * d[..., :2]

    def looked_up(t: PlaneTexture) -> np.ndarray:
        uv = place @ t.texel_from_m[:, :2].T + t.texel_from_m[:, 2]
        uv = np.where(np.isfinite(uv), uv, -1).astype(np.float32)
        return np.asarray(
            cv2.remap(
                t.dark,
                uv[..., 0],
                uv[..., 1],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
            )
        )

    there = 1 - looked_up(blocked) if blocked is not None else np.ones(d.shape[:2])
    taken = np.zeros(d.shape)
    for k, (t, share) in enumerate(zip(textures, shares, strict=True)):
        taken += share * (looked_up(t) * (there if k else 1))[..., None]
    if blocked is not None:
        taken /= np.maximum(shares[0] + (1 - shares[0]) * there[..., None], 1e-6)
    t = np.clip((taken.max(-1) - FAINT) * 0.5 / FAINT, 0, 1)
    left: np.ndarray = 1 - np.minimum(
        (strength * t * t * (3 - 2 * t))[..., None] * taken, 1
    )
    return left


@pytest.mark.parametrize("seed", range(12))
def test_every_pixel_is_what_it_is_plainly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cam = camera(bent=seed % 2 == 1)
    grid = direction_grid(cam).astype(np.float32)
    tilt = (
        rng.uniform(0, 60) if seed < 8 else rng.uniform(72, 80)
    )  # from 72 degrees on the horizon is in the picture
    roll = rotation_from_euler_deg(
        0, 0, rng.uniform(0, 360)
    )  # lines of pixels run towards the horizon, too
    turn = (
        roll
        @ rotation_from_euler_deg(180 - tilt, 0, 0)
        @ rotation_from_euler_deg(0, 0, rng.uniform(0, 360))
    )
    pose = Pose(
        turn,
        np.array(
            [
                rng.uniform(-0.05, 0.05),
                rng.uniform(-0.05, 0.05),
                rng.uniform(0.3, 0.6),
            ]
        ),
    ).inverse()
    several = 1 + seed % 3
    far, texel_m = np.zeros(2), 0.002
    if seed >= 8:  # just below the horizon
        d = (
            between_nodes(grid.astype(np.float32), cam.rect).astype(float)
            @ pose.rotation.T
        )
        row, column = max(
            zip(*np.nonzero(d[..., 2] < -0.05), strict=True),
            key=lambda at: d[at[0], at[1], 2],
        )
        s = -pose.translation_m[2] / d[row, column, 2]
        far, texel_m = pose.translation_m[:2] + s * d[row, column, :2], 0.02 * s
    textures = [
        spot(
            rng,
            60 + 20 * k,
            80,
            rng.uniform(0, 360),
            tuple(far + rng.uniform(-0.1, 0.1, 2)),
            texel_m,
        )
        for k in range(several)
    ]
    blocked = spot(rng, 50, 50, 20.0, (0.02, 0.03)) if seed % 4 == 3 else None
    shares = (
        rng.uniform(0.2, 1.0, (several, 3 if seed % 2 else 1)) * np.ones(3) / several
    )
    left, top = (int(v) for v in rng.integers(0, 60, 2))
    rect = Rect(left, top, 320 - int(rng.integers(0, 40)), 240)
    got = shadow_ratio(
        PlaneView(rect, grid, pose),
        textures[:1],
        textures[1:],
        shares,
        shares[0],
        blocked,
        FAINT,
        0.8,
    )
    want = plainly(rect, grid, pose, textures, shares, blocked, 0.8)
    assert want.min() < 0.9, "the case shows no shadow"
    # cv2.remap reads places to 1/32 of a texel, of 0.04 a texel at most
    np.testing.assert_allclose(got, want, atol=2e-3)
    assert (got[want == 1] == 1).mean() > 0.99, (
        "pixels that lose nothing keep their bits"
    )


@pytest.mark.parametrize("coloured", [False, True])
def test_any_rectangle_gives_the_same(coloured: bool) -> None:
    cam = camera(True)
    above = Pose(rotation_from_euler_deg(160, 0, 10), np.array([0, 0, 0.4])).inverse()
    grid = direction_grid(cam)
    texture = spot(np.random.default_rng(0), 80, 100, 30.0, (0.05, 0.1))
    shares = np.array([[1.0, 0.8, 0.6]]) if coloured else np.ones((1, 3))

    def ratio(rect: Rect) -> np.ndarray:
        return shadow_ratio(
            PlaneView(rect, grid, above),
            [texture],
            [],
            shares,
            shares[0],
            None,
            FAINT,
            1.0,
        )

    whole = ratio(cam.rect)
    assert whole.min() < 0.5
    for rect in (
        Rect(61, 40, 200, 181),
        Rect(0, 0, 75, 240),
        Rect(150, 101, 320, 102),
    ):
        np.testing.assert_allclose(ratio(rect), whole[rect.slices], atol=1e-6)
