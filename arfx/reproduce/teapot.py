"""The Utah teapot (Martin Newell, 1975; in the public domain), from the control points of
its Bezier patches.

All of it but handle and spout is of revolution: a patch's net is a profile of four points,
turned. z up, about 6.4 wide.

In Newell's table the lid's knob has 0.45 where the factor 0.56 of all other patches makes 0.448.
"""

from __future__ import annotations

import numpy as np

# (radius, height) of the profiles' control points, each curve beginning where the one before ends
LID = (
    ((0, 3.15), (0.8, 3.15), (0, 2.85), (0.2, 2.7)),
    ((0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4)),
)  # fmt: skip
BODY = (
    ((1.4, 2.4), (1.3375, 2.53125), (1.4375, 2.53125), (1.5, 2.4)),
    ((1.5, 2.4), (1.75, 1.875), (2, 1.35), (2, 0.9)),
    ((2, 0.9), (2, 0.45), (1.5, 0.225), (1.5, 0.15)),
    ((1.5, 0.15), (1.5, 0.075), (1.425, 0), (0, 0)),
)  # fmt: skip
# Of handle and spout the half with y <= 0. A row of the net: x and z at the inner and the
# outer edge, and how far y goes between
HANDLE = (
    ((-1.6, 2.025, -1.5, 2.25, 0.3), (-2.3, 2.025, -2.5, 2.25, 0.3), (-2.7, 2.025, -3, 2.25, 0.3), (-2.7, 1.8, -3, 1.8, 0.3)),
    ((-2.7, 1.8, -3, 1.8, 0.3), (-2.7, 1.575, -3, 1.35, 0.3), (-2.5, 1.125, -2.65, 0.9375, 0.3), (-2, 0.9, -1.9, 0.6, 0.3)),
)  # fmt: skip
SPOUT = (
    ((1.7, 1.425, 1.7, 0.6, 0.66), (2.6, 1.425, 3.1, 0.825, 0.66), (2.3, 2.1, 2.4, 2.025, 0.25), (2.7, 2.4, 3.3, 2.4, 0.25)),
    (
        (2.7, 2.4, 3.3, 2.4, 0.25), (2.8, 2.475, 3.525, 2.49375, 0.25), (2.9, 2.475, 3.45, 2.5125, 0.15),
        (2.8, 2.4, 3.2, 2.4, 0.15),
    ),
)  # fmt: skip
QUARTER = ((1, 0), (1, 0.56), (0.56, 1), (0, 1))  # a quarter of a circle, nearly

Curves = tuple[tuple[tuple[float, ...], ...], ...]


def bernstein(t: np.ndarray) -> np.ndarray:
    """(n, 4) weights of the four points of a cubic Bezier curve at t."""
    return np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], -1)


def along(curves: Curves, steps: tuple[int, ...]) -> np.ndarray:
    """(1 + sum of steps, columns) points along curves that follow each other, so many steps
    on each.
    """
    parts = [
        bernstein(np.arange(n) / n) @ np.array(c, float)
        for c, n in zip(curves, steps, strict=True)
    ]
    return np.concatenate([*parts, np.array(curves[-1][-1:], float)])


def turned(curves: Curves, steps: tuple[int, ...], sides: int) -> np.ndarray:
    """(rings, sides, 3) points of a surface of revolution about z. sides : a multiple of four"""
    t = np.arange(sides // 4) / (sides // 4)
    quarter = bernstein(t) @ np.array(QUARTER)
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    circle = np.concatenate([quarter @ np.linalg.matrix_power(turn, k) for k in range(4)])
    profile = along(curves, steps)
    ring = np.broadcast_to(circle, (len(profile), sides, 2)) * profile[:, None, :1]
    return np.concatenate(
        [ring, np.broadcast_to(profile[:, None, 1:], (*ring.shape[:2], 1))], -1
    )


def tube(curves: Curves, steps: tuple[int, ...], sides: int) -> np.ndarray:
    """(rings, sides, 3) points of the handle or the spout. sides : even"""
    weights = bernstein(2 * np.arange(sides // 2) / sides)
    inner_x, inner_z, outer_x, outer_z, y = along(curves, steps).T[..., None]
    inner, outer = weights[:, :2].sum(-1), weights[:, 2:].sum(-1)
    bulge = weights[:, 1:3].sum(-1)
    half = np.stack(
        [inner * inner_x + outer * outer_x, -bulge * y, inner * inner_z + outer * outer_z],
        -1,
    )
    edge = np.stack([outer_x, 0 * y, outer_z], -1)  # where the other half begins
    other = half[:, :0:-1] * [1, -1, 1]
    return np.concatenate([half, edge, other], 1)
