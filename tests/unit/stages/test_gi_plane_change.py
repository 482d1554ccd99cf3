"""The planes' change is looked up every few pixels, as far apart as its texels are; in between it is linear."""

from __future__ import annotations

import numpy as np

from arfx.stages.gi.plane_pixels import PlaneChange, add_delta, cell_px
from arfx.stages.light.planes import WARP

HEIGHT, WIDTH = 96, 128
FLOOR = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
WALL = [[0, 0.5, 0], [1, 0, 0], [0, 0, 1], [0, -1, 0]]


def changed(
    cell: int, planes: list, real: np.ndarray | None = None, deeper: float = 0.0, behind: float = 0.0  # type: ignore[type-arg]
) -> np.ndarray:  # fmt: skip
    """(h, w, 3) ratio, seen from 1 m over the floor and tilted towards the wall. behind : what lies after the nodes in memory"""
    x, y = np.meshgrid(np.arange(0, WIDTH + 8, 8), np.arange(0, HEIGHT + 8, 8))
    right, down, ahead = np.array([1.0, 0, 0]), np.array([0, -0.6, -0.8]), np.array([0, 0.8, -0.6])
    u, v = (x - WIDTH / 2)[..., None] / 120, (y - HEIGHT / 2)[..., None] / 120
    nodes = (u * right + v * down + ahead).astype(np.float32)
    nodes = np.concatenate([nodes, np.full_like(nodes[:1], behind)])[:-1]
    t = np.linspace(-1, 1, 16)
    bump = np.exp(-((t[:, None] - 0.1) ** 2 + t[None] ** 2) / 0.2)
    delta = np.array([np.repeat((k + 1) * 0.2 * bump[..., None], 3, -1) for k in range(len(planes))], np.float32)
    f32 = np.float32
    more = np.full_like(delta, deeper) if deeper else np.zeros((0, 16, 16, 3), f32)
    change = PlaneChange(delta, more, f32(1.0), f32(0.9), f32(1), np.int64(cell))
    out = np.full((HEIGHT, WIDTH, 3), 0.5, f32)
    measured = np.zeros((0, 0), f32) if real is None else real
    within = np.array([3, 5, WIDTH - 2, HEIGHT])
    add_delta(out, 0, 0, within, nodes, np.array([0, -0.5, 0.9], f32), np.array(planes, f32), change, measured)
    return out


def test_far_between_as_at_each_pixel() -> None:
    fine = changed(1, [FLOOR])
    assert fine.max() > 0.6 and (fine[:5] == 0.5).all() and (fine[:, :3] == 0.5).all()
    for cell in (2, 4):
        assert np.abs(changed(cell, [FLOOR]) - fine).max() < 0.01
    assert np.abs(changed(4, [FLOOR], deeper=0.3) - changed(1, [FLOOR], deeper=0.3)).max() < 0.03


def test_what_lies_behind_the_nodes_in_memory_does_not_count() -> None:
    """The last cells end where the picture does, on the last node."""
    for cell in (4, 8):
        assert (changed(cell, [FLOOR], behind=np.nan) == changed(cell, [FLOOR])).all()


def test_the_edge_between_two_planes_stays_sharp() -> None:
    """Cells that show both are looked up pixel by pixel."""
    fine, coarse = changed(1, [FLOOR, WALL]), changed(4, [FLOOR, WALL])
    step = np.abs(np.diff(fine[..., 0], axis=0)).max()
    assert step > 0.1 and np.abs(coarse - fine).max() < 0.04


def test_what_stands_before_the_plane_stays() -> None:
    near = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    near[:, : WIDTH // 2] = 0.2
    for cell in (1, 4):
        out = changed(cell, [FLOOR], near)
        assert (out[:, : WIDTH // 2] == 0.5).all() and out[:, WIDTH // 2 :].max() > 0.6


def test_cells_are_as_wide_as_texels() -> None:
    side = 64
    pitch_m = 2 / (side * float(WARP))
    assert [cell_px(p / pitch_m, 1.0, side) for p in (0.1, 1.0, 3.9, 4.1, 100.0)] == [1, 1, 2, 4, 8]
