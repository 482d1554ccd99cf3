"""Sweeps of what is estimated from readings: where an answer is owed follows from the noise
and the information in the data.

The bounds are worked out here, from models of the readings that share no code with the estimators.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from arfx.analyse.lens import lens_from_blur
from arfx.analyse.light.fit import REFUSED, fit
from arfx.analyse.light.photometry import EXACT, MEASURED, solve
from arfx.analyse.pose.planar import Observed, information
from arfx.core.marker import MarkerSpec
from arfx.core.numerics import angle_between, normalise
from arfx.core.pose import Pose, rotation_angle_rad, rotation_from_rotvec
from arfx.papers.s1_gain import gain_and_bias
from tests.hard.sweeps import (
    ANSWER,
    EITHER,
    REFUSAL,
    WITH_CAMERA,
    Answer,
    Data,
    Expected,
    Sweep,
    informed,
    least_sigma,
)
from tests.planar import planar

# --- bias of the camera, as two albedos become one
# ---------------------------------------------------------------------------

_ALBEDO_LIGHT = np.random.default_rng(0).uniform(0.3, 0.9, (30, 3))
_READING_SIGMA = 0.002  # of the light of white
# of a value: normal equations square what float64 rounds, and a light for every frame is
# taken out of them
_FLOAT64 = 1e-7
_BIAS = 0.05


def _albedos(delta: float) -> np.ndarray:
    return np.array([0.5 - delta / 2, 0.5 + delta / 2] * 4)


def _bias(delta: float, formula: str, data: Data) -> Answer | None:
    """Two albedos delta apart: the camera's bias, of white."""
    rho = _albedos(delta)
    clean = data(rho[None, :, None] * _ALBEDO_LIGHT[:, None] + _BIAS)
    seen = clean + data.noise(_READING_SIGMA, clean.shape)
    if formula == "paper":
        found = gain_and_bias(seen, albedo=rho)
        return (
            None
            if found.verdict != MEASURED
            else Answer(float(np.abs(found.bias - _BIAS).max()))
        )
    variance = np.full(seen.shape, _READING_SIGMA**2) if data.camera else None
    solved = solve(seen, variance, rho, tolerances=EXACT)
    if solved.verdict != MEASURED:
        return None
    return Answer(
        float(np.abs(solved.bias - _BIAS).max()),
        float((solved.bias_95[:, 1] - solved.bias_95[:, 0]).max() / 3.92),
    )


def _bias_sigma(delta: float, data: Data) -> float:
    """Readings rho y_t + b of one channel, a light y_t each frame: what is left of b when
    every y_t is eliminated.
    """
    rho = _albedos(delta)
    left = 30 * float(((rho - rho.mean()) ** 2).sum() / (rho**2).sum()) * len(rho)
    sigma = _READING_SIGMA if data.camera else max(_FLOAT64, data.rounding)
    return sigma / np.sqrt(left)


# --- direction of the light, as a print's normals become one
# -----------------------------------------------------------------

_LAMP, _LAMP_RGB, _AMBIENT = (
    normalise(np.array([0.5, 0.3, 0.8])),
    np.array([0.6, 0.5, 0.4]),
    0.2,
)
# of the bright light: no print is a better diffuse surface, so the fit believes no reading
# more
_MODEL_ERROR = 0.002
_EXPONENT_SIGMA = 0.08  # of the logarithm of the camera's exponent


def _print_normals(delta: float) -> np.ndarray:
    """(120, 3) within 60 delta degrees of the middle one."""
    rng = np.random.default_rng(2)
    tilt, phi = (
        np.pi / 3 * delta * np.sqrt(rng.random(120)),
        2 * np.pi * rng.random(120),
    )
    return np.stack(
        [np.sin(tilt) * np.cos(phi), np.sin(tilt) * np.sin(phi), np.cos(tilt)], -1
    )


def _direction(delta: float, formula: str, data: Data) -> Answer | None:
    """The lamp's direction, degrees."""
    n = _print_normals(delta)
    light = data(np.clip(n @ _LAMP, 0, None)[:, None] * _LAMP_RGB + _AMBIENT)
    noisy = light + data.noise(_READING_SIGMA, light.shape)
    found = fit(
        n, noisy, np.full(light.shape, _READING_SIGMA**2 if data.camera else 0.0)
    )
    if found.verdict == REFUSED or not found.lights:
        return None
    lamp = found.lights[0]
    # a cone of 95 % is 2.45 standard deviations of a direction's two angles
    return Answer(
        float(np.degrees(angle_between(lamp.direction, _LAMP))),
        lamp.confidence_deg / 2.45,
    )


def _direction_sigma(delta: float, data: Data) -> float:
    n = _print_normals(delta)
    across = np.linalg.svd(_LAMP[None])[2][1:]

    def readings(x: np.ndarray) -> np.ndarray:
        """x : ambient light (3), the lamp's (3), its direction (2), exponent (1)"""
        lamp = normalise(_LAMP + x[6:8] @ across)
        return np.asarray(
            (np.clip(n @ lamp, 0, None)[:, None] * x[3:6] + x[:3]) ** x[8]
        )

    bright = float(_LAMP_RGB.mean() + _AMBIENT)
    sigma = np.hypot(_MODEL_ERROR * bright, _READING_SIGMA if data.camera else 0.0)
    known = [*[np.inf] * 8, _EXPONENT_SIGMA]
    least = least_sigma(
        readings, [*[_AMBIENT] * 3, *_LAMP_RGB, 0, 0, 1], sigma, known
    )[6:8, 6:8]
    return (
        float(np.degrees(np.sqrt(np.linalg.eigvalsh(least)[-1])))
        if np.isfinite(least).all()
        else np.inf
    )


# --- pose of a marker
# --------------------------------------------------------------------------------------------------------

_FOCAL_PX, _SIDE_M = 900.0, 0.1
_CORNER_SIGMA_PX = 0.05
_CORNERS_M = MarkerSpec("36h11", 0, _SIDE_M).corners_m


def _marker_pose(
    place: Callable[[float], tuple[np.ndarray, np.ndarray]],
) -> Callable[[float, str, Data], Answer | None]:
    """Turn of the nearer of both poses from the true one, degrees."""

    def answer(delta: float, formula: str, data: Data) -> Answer | None:
        turn, middle = place(delta)
        seen = _CORNERS_M @ turn.T + middle
        ideal = data(seen[:, :2] / seen[:, 2:]) + data.noise(
            _CORNER_SIGMA_PX / _FOCAL_PX, (4, 2)
        )
        scale = np.broadcast_to(_FOCAL_PX * np.eye(2), (1, 4, 2, 2))
        found = planar(_CORNERS_M, ideal, scale[0], _CORNER_SIGMA_PX)
        if not found:
            return None
        off = [rotation_angle_rad(pose, Pose(turn, np.zeros(3))) for pose, _ in found]
        best, _ = found[int(np.argmin(off))]
        observed = Observed(
            _CORNERS_M[None],
            ideal[None],
            scale,
            np.full((1, 4), _CORNER_SIGMA_PX**-2),
        )
        covariance = np.linalg.pinv(
            information(best.rotation[None], best.translation_m[None], observed)[0],
            hermitian=True,
        )
        stated = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
        return Answer(
            float(np.degrees(min(off))), min(float(np.degrees(stated)), 180.0)
        )

    return answer


def _pose_sigma(
    place: Callable[[float], tuple[np.ndarray, np.ndarray]], delta: float
) -> float:
    """Degrees, of the turn, from four corners."""
    turn, middle = place(delta)

    def corners(x: np.ndarray) -> np.ndarray:
        """x : rotation vector, translation over the distance"""
        p = (
            _CORNERS_M @ (rotation_from_rotvec(x[:3]) @ turn).T
            + middle
            + x[3:] * np.linalg.norm(middle)
        )
        return np.asarray(_FOCAL_PX * p[:, :2] / p[:, 2:])

    least = least_sigma(corners, np.zeros(6), _CORNER_SIGMA_PX)[:3, :3]
    return (
        min(float(np.degrees(np.sqrt(np.linalg.eigvalsh(least)[-1]))), 180.0)
        if np.isfinite(least).all()
        else 180.0
    )


_FACING = np.diag([1.0, -1.0, -1.0])
_ASIDE_M = np.array([0.02, 0.01, 0.5])


def _towards_facing(delta: float) -> tuple[np.ndarray, np.ndarray]:
    return rotation_from_rotvec(np.array([delta, 0.0, 0.0])) @ _FACING, _ASIDE_M


def _towards_edge_on(delta: float) -> tuple[np.ndarray, np.ndarray]:
    """Its plane passes the camera at an angle of delta, as seen from its middle."""
    view = np.arctan2(
        _ASIDE_M[1], _ASIDE_M[2]
    )  # the plane of a marker turned so far holds the camera
    return (
        rotation_from_rotvec(np.array([np.pi / 2 - view - delta, 0.0, 0.0]))
        @ _FACING,
        _ASIDE_M,
    )


def _towards_no_width(delta: float) -> tuple[np.ndarray, np.ndarray]:
    """100 delta pixels wide."""
    away = _SIDE_M * _FOCAL_PX / (100.0 * delta)
    return (
        rotation_from_rotvec(np.array([0.6, 0.2, 0.0])) @ _FACING,
        np.array([0.02, 0.01, 1.0]) * away,
    )


def _pose_expected(
    place: Callable[[float], tuple[np.ndarray, np.ndarray]],
) -> Callable[[float, Data], Expected]:
    """Four corners always have a pose, whose covariance says what it is worth, but where
    noise may turn the marker's back.
    """

    def expected(delta: float, data: Data) -> Expected:
        turn, middle = place(delta)
        seen = _CORNERS_M @ turn.T + middle
        px = _FOCAL_PX * seen[:, :2] / seen[:, 2:]
        across = np.linalg.svd(px - px.mean(0))[1][
            1
        ]  # how far the corners are from lying in a line
        return Expected(
            ANSWER if across > 8 * _CORNER_SIGMA_PX else EITHER,
            _pose_sigma(place, delta),
        )

    return expected


# --- the lens that the footage was filmed with, as all distances become one
# --------------------------------------------------

_DIOPTRES, _PX_PER_DIOPTRE, _SHARP_PX, _BLUR_SIGMA_PX = 2.0, 15.0, 0.6, 0.02


def _edges(delta: float) -> tuple[np.ndarray, float]:
    """(dioptres of 60 edges whose distances differ by a share delta, focus)"""
    return _DIOPTRES * (1 + delta * np.linspace(-1, 1, 60)), _DIOPTRES * (
        1 - 0.3 * delta
    )


def _blur_px(d: np.ndarray, focus: float, k: float, sharp: float) -> np.ndarray:
    return np.asarray(np.sqrt(sharp**2 + (k / 2 * (d - focus)) ** 2))


def _footage_lens(delta: float, formula: str, data: Data) -> Answer | None:
    """Its focus, dioptres."""
    d, focus = _edges(delta)
    blur = data(_blur_px(d, focus, _PX_PER_DIOPTRE, _SHARP_PX)) + data.noise(
        _BLUR_SIGMA_PX, d.shape
    )
    found = lens_from_blur(data(d), blur, _BLUR_SIGMA_PX)
    return (
        Answer(abs(found.focus - focus), found.focus_ci95 / 1.96)
        if found.known
        else None
    )


def _footage_lens_expected(delta: float, data: Data) -> Expected:
    """The blur has to grow away from the focus by six of its deviations to be told from one
    that does not.
    """
    d, focus = _edges(delta)

    def readings(x: np.ndarray) -> np.ndarray:
        """x : focus, its distance's square's share of blur^2 (px^2), blur^2 in the focus"""
        return np.asarray(np.sqrt(x[2] + x[1] * (d - x[0]) ** 2))

    least = least_sigma(
        readings, [focus, _PX_PER_DIOPTRE**2 / 4, _SHARP_PX**2], _BLUR_SIGMA_PX
    )
    focus_sigma, growth = (
        float(np.sqrt(least[0, 0])),
        _PX_PER_DIOPTRE**2 / 4 / float(np.sqrt(least[1, 1])),
    )
    if growth > 6 and 1.96 * focus_sigma < 0.25 * _DIOPTRES:
        return Expected(ANSWER, focus_sigma)
    return Expected(
        REFUSAL if growth < 1 or focus_sigma > _DIOPTRES else EITHER, focus_sigma
    )


POSES = (
    ("facing the camera", _towards_facing),
    ("edge on", _towards_edge_on),
    ("no width", _towards_no_width),
)
ESTIMATES: tuple[Sweep, ...] = (
    Sweep("photometry", "albedo contrast 0", "bias, of 1", _bias, informed(_bias_sigma, 5e-3, 0.2), WITH_CAMERA,
          formulas=("corrected", "paper"), unbounded=("paper",)),
    Sweep("light direction", "one normal", "deg", _direction, informed(_direction_sigma, 2.0, 60.0), WITH_CAMERA),
    *(Sweep("marker pose", towards, "deg", _marker_pose(place), _pose_expected(place), WITH_CAMERA) for towards, place in POSES),
    Sweep("lens of the footage", "one distance", "dioptres", _footage_lens, _footage_lens_expected, WITH_CAMERA),
)  # fmt: skip
