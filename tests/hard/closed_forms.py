"""Sweeps of what is computed, not estimated: an answer is always owed, but where none exists.

"float32" means that the inputs carry float32's rounding, as everything that comes from
pixels does; the code is float64 throughout."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from arfx.core.camera import Camera
from arfx.core.lens import Lens, circle_of_confusion_mm, depth_of_field
from arfx.core.numerics import angle_between, normalise
from arfx.core.pose import rotation_from_rotvec, rotvec_from_rotation
from arfx.papers.s1_light import eq8_weight, squared_weight
from arfx.papers.s2_lens import printed_limits
from arfx.papers.s4_volumes import octree_of
from arfx.papers.s4_voxels import Volume
from tests.hard.sweeps import (
    ANSWER,
    EITHER,
    REFUSAL,
    SIGMAS,
    Answer,
    Data,
    Expected,
    Sweep,
    always,
)

_AXES = normalise(np.random.default_rng(3).normal(size=(12, 3)))
_NEAREST_M = 1e-4  # docs/limits.md: nothing nearer to the camera is projected


def _rotation(at: float) -> Callable[[float, str, Data], Answer]:
    """Rotation matrix to vector and back, at angles delta beside `at`."""

    def answer(delta: float, formula: str, data: Data) -> Answer:
        angles = np.array([at - delta, at, at + delta])
        matrices = rotation_from_rotvec(
            (_AXES[:, None] * angles[:, None]).reshape(-1, 3)
        )
        return Answer(
            float(
                np.abs(
                    rotation_from_rotvec(rotvec_from_rotation(data(matrices)))
                    - matrices
                ).max()
            )
        )

    return answer


def _between(at: float) -> Callable[[float, str, Data], Answer]:
    def answer(delta: float, formula: str, data: Data) -> Answer:
        angle = at + (-delta if at > 0 else delta)
        b = np.array([np.cos(angle), np.sin(angle), 0.0])
        return Answer(
            abs(
                float(angle_between(data(np.array([1.0, 0.0, 0.0])), data(b))) - angle
            )
        )

    return answer


def _light_weight(delta: float, formula: str, data: Data) -> Answer:
    """Eq. (8) at an angle delta from the normal, against the exponential itself."""
    s = 0.2
    cosine = data(np.cos(delta))
    weight = squared_weight if formula == "corrected" else eq8_weight
    found = float(weight(cosine, s))
    return Answer(abs(found - float(np.exp(-(delta**2) / (2 * s * s)))))


def _focus(delta: float, formula: str, data: Data) -> Answer:
    """Blur circle of a thing delta beyond the focus: against the difference written out."""
    exact = 50.0 * 50.0 * 800.0 * delta / ((800.0 - 50.0) * 2.8 * 800.0 * (1 + delta))
    return Answer(
        abs(
            float(
                circle_of_confusion_mm(
                    float(data(800.0 * (1 + delta))), Lens(50.0, 2.8, 800.0)
                )
            )
            - exact
        )
    )


def _near_lens(delta: float, formula: str, data: Data) -> Answer:
    """A thing at a distance of delta focal lengths: bounded by its documented limit."""
    lens = Lens(50.0, 2.8, 800.0)
    limit = float(circle_of_confusion_mm(0.01 * 50.0, lens))
    return Answer(
        max(float(circle_of_confusion_mm(data(50.0 * delta), lens)) / limit - 1, 0.0)
    )


def _focal(delta: float, formula: str, data: Data) -> Answer:
    """Focused delta beyond the focal length: finite, and what the formula says."""
    focus = float(data(50.0 * (1 + delta)))
    return Answer(
        abs(
            Lens(50.0, 2.8, focus).coc_at_infinity_mm
            / (50.0 / 2.8 * 50.0 / (focus - 50.0))
            - 1
        )
    )


def _focal_expected(delta: float, data: Data) -> Expected:
    """Nothing is focused within the focal length: a refusal is owed where rounding leaves
    nothing.
    """
    return Expected(
        ANSWER if data(50.0 * (1 + delta)) > 50.0 else REFUSAL, 1e-9 / SIGMAS
    )


_HYPERFOCAL_MM = 50.0 * 50.0 / (8.0 * 0.03)


def _hyperfocal(delta: float, formula: str, data: Data) -> Answer | None:
    """Focused just nearer than the hyperfocal distance: the blur at the far limit is the
    circle that was allowed.

    Where rounding leaves the hyperfocal distance itself, all beyond is sharp."""
    far = _HYPERFOCAL_MM + (50.0 if formula == "corrected" else 0.0)
    lens = Lens(50.0, 8.0, float(data(far * (1 - delta / 2))))
    back = (depth_of_field if formula == "corrected" else printed_limits)(
        lens, 0.03
    ).back_mm
    if back is None or np.isinf(back):
        return Answer(0.0) if lens.focus_mm >= far * (1 - 1e-12) else None
    return Answer(
        abs(float(circle_of_confusion_mm(lens.focus_mm + back, lens)) / 0.03 - 1)
    )


def _distance(delta: float, formula: str, data: Data) -> Answer | None:
    """A point delta metres before the camera: pixel to direction and back, px."""
    camera = Camera(
        1280,
        720,
        np.array([[900.0, 0, 640], [0, 900.0, 360], [0, 0, 1]]),
        np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]),
    )
    pixel = camera.project(data(np.array([[0.1 * delta, 0.05 * delta, delta]])))
    if not np.isfinite(pixel).all():
        return None
    again = camera.project(
        np.concatenate([camera.normalised(pixel), np.ones((1, 1))], 1)
    )
    return Answer(float(np.abs(again - pixel).max()))


def _distance_expected(delta: float, data: Data) -> Expected:
    return Expected(
        (
            ANSWER
            if delta > 1.01 * _NEAREST_M
            else REFUSAL
            if delta < 0.99 * _NEAREST_M
            else EITHER
        ),
        1e-3 / SIGMAS,
    )


def _focal_length(delta: float, formula: str, data: Data) -> Answer:
    """A focal length of width / delta: pixel to direction and back, px."""
    f = 1280.0 / delta
    camera = Camera(1280, 720, np.array([[f, 0, 640], [0, f, 360], [0, 0, 1.0]]))
    pixels = np.array([[3.0, 5.0], [640.0, 360.0], [1270.0, 700.0]])
    ideal = data(camera.normalised(pixels))
    return Answer(
        float(
            np.abs(
                camera.project(np.concatenate([ideal, np.ones((3, 1))], 1)) - pixels
            ).max()
        )
    )


_WALL = np.array([(7, y, z) for z in range(16) for y in range(16)])


def _wall(delta: float, formula: str, data: Data) -> Answer:
    """A wall of opacity 1 - delta, one voxel thick, at the mip level of eight voxels: what
    leaks beside what should.

    Corrected: the mean of the children that are stored."""
    values = np.full(len(_WALL), data(1 - delta))
    cube, normals = Volume(16, (0.0, 0.0, 0.0), 1.0), np.zeros((len(_WALL), 3))
    tree = octree_of(cube, _WALL, normals, values, stored=formula == "corrected")
    opacity = tree.tree.eta[tree.rows_of(3), 3]
    return Answer(abs(float(opacity.max(initial=0.0)) - (1 - delta)))


BOTH, PAPER = ("corrected", "paper"), ("paper",)
CLOSED_FORMS: tuple[Sweep, ...] = (
    Sweep(
        "rotation vector",
        "angle 0",
        "matrix element",
        _rotation(0.0),
        always(1e-12, 1e-6),
    ),
    Sweep(
        "rotation vector",
        "angle pi/2",
        "matrix element",
        _rotation(np.pi / 2),
        always(1e-12, 1e-6),
    ),
    Sweep(
        "rotation vector",
        "angle pi",
        "matrix element",
        _rotation(np.pi),
        always(1e-12, 1e-6),
    ),
    Sweep("angle between", "angle 0", "rad", _between(0.0), always(1e-15, 1e-7)),
    Sweep(
        "angle between", "angle pi/2", "rad", _between(np.pi / 2), always(1e-15, 1e-7)
    ),
    Sweep("angle between", "angle pi", "rad", _between(np.pi), always(1e-12, 3e-7)),
    Sweep(
        "weight of a normal, eq. 8",
        "angle 0",
        "of 1",
        _light_weight,
        always(1e-9, 1e-5),
        formulas=BOTH,
        unbounded=PAPER,
    ),
    Sweep("blur circle", "the focus", "mm", _focus, always(1e-13, 1e-6)),
    Sweep(
        "blur circle",
        "distance 0",
        "share over its limit",
        _near_lens,
        always(1e-12, 1e-6),
    ),
    Sweep("lens", "focus at the focal length", "share", _focal, _focal_expected),
    Sweep(
        "depth of field",
        "the hyperfocal distance",
        "share",
        _hyperfocal,
        always(1e-3, 1e-1),
        formulas=BOTH,
        unbounded=PAPER,
    ),
    Sweep("projection", "distance 0", "px", _distance, _distance_expected),
    Sweep(
        "projection",
        "an endless focal length",
        "px",
        _focal_length,
        always(1e-3, 1e-3),
    ),
    Sweep(
        "voxel wall",
        "opacity 1",
        "of 1",
        _wall,
        always(1e-6, 1e-6),
        formulas=BOTH,
        unbounded=PAPER,
    ),
)
