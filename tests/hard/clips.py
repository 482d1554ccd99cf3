"""Whole clips that go towards a singularity and come back: is the pose as good as it says,
and does the object fade or jump?

Each clip is a few seconds of a print with known poses, drawn, and analysed as a job
analyses it. A frame's error is the left perturbation from the true pose to the smoothed
one; it holds where its Mahalanobis distance under the stated covariance is within 95 %.
Where the print can be read the object has to be there; nowhere may it be mirrored, or
appear or go at once."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.core.facts import FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.pose import (
    Pose,
    rotation_angle_rad,
    rotation_from_rotvec,
    rotvec_from_rotation,
)
from tests.observed import Observed
from tests.unit.analyse.synthetic import FACING, background, camera, picture

_PRINT = MarkerSpec("36h11", 3, 0.1)
_CAMERA = camera(480, 360, 600.0)
_FPS = 30.0
_CELLS = 8
WITHIN = float(chi2.ppf(0.95, 6))
MOST_OFF_PX = 6.0  # in the picture, of 360: what is fading may be that far off
MOST_TURN_DEG = (
    12.0  # of a pose that is shown: a mirrored one is off by twice its tilt
)


@dataclass(frozen=True)
class Shown:
    """What a frame shows. pose : camera_from_marker;  blur_px, motion_px : standard
    deviation, length;  contrast, exposure :
    of 1;  noise : of 255;  covered : share of the print's width;  slant : of the border of
    what covers, over the print's height
    zoom : of the calibrated focal length"""

    pose: Pose
    blur_px: float = 0.7
    motion_px: float = 0.0
    contrast: float = 1.0
    exposure: float = 1.0
    noise: float = 1.5
    covered: float = 0.0
    slant: float = 0.35
    zoom: float = 1.0


@dataclass(frozen=True)
class Clip:
    """shown(u) : u from 0 through 1, at the singularity, to 2
    least_held : share of the frames within 95 %; errors of neighbours are one, so that few
    may be more
    """

    name: str
    shown: Callable[[float], Shown]
    least_held: float = 0.9
    frames: int = 90


def _pose(
    side_px: float = 110.0,
    turn: Sequence[float] = (0.5, 0.25, 0.0),
    x_px: float = 20.0,
    y_px: float = 10.0,
) -> Pose:
    away = _PRINT.size_m * _CAMERA.fx / side_px
    place = np.array([x_px / _CAMERA.fx, y_px / _CAMERA.fy, 1.0]) * away
    return Pose(rotation_from_rotvec(np.asarray(turn, float)) @ FACING, place)


def _log(first: float, last: float, u: float) -> float:
    return float(first * (last / first) ** u)


_SWAY = 0.03


def _swaying(u: float, **changes: float) -> Pose:
    """Nobody holds still."""
    turn = (
        0.5 + _SWAY * np.sin(7 * u),
        0.25 + _SWAY * np.sin(5 * u + 1),
        0.02 * np.sin(6 * u),
    )
    return _pose(
        **{
            "turn": turn,
            "x_px": 20 + 12 * np.sin(4 * u),
            "y_px": 10 + 8 * np.sin(5 * u),
        }
        | changes
    )  # type: ignore[arg-type]


def _passing(u: float) -> Pose:
    """The camera flies low over the print and looks down and ahead, until the print leaves
    below.
    """
    eye = np.array([0.02, -0.7 + 0.62 * u, 0.28])
    ahead = np.array([0.0, np.cos(0.6), -np.sin(0.6)])
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    return Pose(rotation, -rotation @ eye)


_HALF = np.pi / 2
# a camera that zooms has another focal length than its calibration: the object keeps its
# place, no pose is right
CLIPS: tuple[Clip, ...] = (
    Clip(
        "shrinks from 200 to 6 px",
        lambda u: Shown(_swaying(u, side_px=_log(200, 6, _there(u)))),
    ),
    Clip(
        "turns edge-on",
        lambda u: Shown(
            _pose(130, (_HALF * 0.999 * _there(u), 0.1, 0.05 * u), y_px=0.0)
        ),
    ),
    Clip(
        "leaves by a border", lambda u: Shown(_swaying(u, x_px=20 + 330 * _there(u)))
    ),
    Clip(
        "fades in fog",
        lambda u: Shown(_swaying(u), contrast=_log(1, 0.01, _there(u))),
    ),
    Clip(
        "is blurred by 1 to 60 px",
        lambda u: Shown(_swaying(u), blur_px=_log(1, 60, _there(u))),
    ),
    Clip(
        "is smeared by 1 to 60 px",
        lambda u: Shown(_swaying(u), motion_px=_log(1, 60, _there(u))),
    ),
    Clip(
        "is covered by 0 to 95 %",
        lambda u: Shown(_swaying(u), covered=0.95 * _there(u)),
    ),
    # the first tenths of a pixel move a whole side by less than real prints are off
    Clip(
        "a card slides along a side",
        lambda u: Shown(_swaying(u), covered=0.5 * _there(u), slant=0.1),
        0.8,
    ),
    Clip(
        "lies in the dark",
        lambda u: Shown(_swaying(u), exposure=_log(1, 0.002, _there(u))),
    ),
    Clip(
        "drowns in noise", lambda u: Shown(_swaying(u), noise=_log(1, 90, _there(u)))
    ),
    Clip(
        "the camera zooms",
        lambda u: Shown(_swaying(u, side_px=70), zoom=_log(1, 2.5, _there(u))),
        0.0,
    ),
    Clip(
        "the camera rolls through 360 degrees",
        lambda u: Shown(_rolled(_swaying(u), np.pi * u)),
    ),
    Clip("the camera passes over it", lambda u: Shown(_passing(u))),
)


def _there(u: float) -> float:
    """0, 1, 0 at u = 0, 1, 2, and a rest of a sixth at 1."""
    return float(np.clip(1.2 * min(u, 2 - u), 0, 1))


def _rolled(pose: Pose, angle_rad: float) -> Pose:
    turn = rotation_from_rotvec(np.array([0.0, 0.0, angle_rad]))
    return Pose(turn @ pose.rotation, turn @ pose.translation_m)


def frame(shown: Shown, seed: int) -> np.ndarray:
    """(h, w) uint8 luma."""
    cam = (
        _CAMERA
        if shown.zoom == 1
        else camera(_CAMERA.width, _CAMERA.height, _CAMERA.fx * shown.zoom)
    )
    back = background(cam.width, cam.height)
    marker = (
        [(_PRINT, shown.pose)]
        if (shown.pose.apply(_PRINT.corners_m * 1.3)[:, 2] > 0.1).all()
        else []
    )
    code = picture(cam, marker, back, noise=0.0, blur_px=0.0).astype(np.float32) / 255
    if shown.covered and marker:
        quad = cam.project(shown.pose.apply(_PRINT.corners_m * 1.2))
        (x0, y0), (x1, y1) = quad.min(0), quad.max(0)
        edge, slant = (
            x0 + shown.covered * (x1 - x0),
            shown.slant * (y1 - y0),
        )  # as of a hand that comes in from the left
        hand = np.array([[x0, y0], [edge, y0], [edge - slant, y1], [x0, y1]])
        cv2.fillPoly(
            code, [np.rint(hand * 16).astype(np.int32)], 0.55, cv2.LINE_AA, 4
        )
    light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    light = cv2.GaussianBlur(light, (0, 0), shown.blur_px)
    if shown.motion_px > 1:
        light = cv2.filter2D(light, -1, _smear(shown.motion_px)[None])
    light = (0.35 + (light - 0.35) * shown.contrast) * shown.exposure
    code = np.where(
        light <= 0.0031308,
        light * 12.92,
        1.055 * np.clip(light, 0, None) ** (1 / 2.4) - 0.055,
    )
    noise = np.random.default_rng(seed).normal(0, shown.noise, code.shape)
    return np.clip(code * 255 + noise, 0, 255).round().astype(np.uint8)


def _smear(length_px: float) -> np.ndarray:
    """(n,) weights of the pixels of a row under a straight motion; n is odd, lest the
    picture moves.
    """
    reach = int(np.ceil(length_px / 2 + 0.5))
    edges = np.clip(np.arange(-reach, reach + 2) - 0.5, -length_px / 2, length_px / 2)
    return np.asarray(np.diff(edges) / length_px)


def readable(shown: Shown) -> bool:
    """Whether anybody could read and place the print: cells of three pixels and of three
    deviations of blur, all in the picture, well above the noise."""
    cam = camera(_CAMERA.width, _CAMERA.height, _CAMERA.fx * shown.zoom)
    px = cam.project(shown.pose.apply(_PRINT.corners_m))
    outer = cam.project(shown.pose.apply(_PRINT.corners_m * 1.25))
    if not (
        np.isfinite(outer).all()
        and (outer > 2).all()
        and (outer < [cam.width - 3, cam.height - 3]).all()
    ):
        return False
    cell = (
        cv2.contourArea(px.astype(np.float32))
        / np.linalg.norm(px - np.roll(px, 1, 0), axis=1).max()
        / _CELLS
    )
    blur = np.hypot(
        shown.blur_px, shown.motion_px / np.sqrt(12) if shown.motion_px > 1 else 0.0
    )
    codes = 150 * shown.contrast * shown.exposure ** (1 / 2.2)
    return bool(
        cell > 3 * max(1.0, blur)
        and codes > max(30, 8 * shown.noise)
        and shown.covered == 0
    )


@dataclass(frozen=True)
class Found:
    """distance : (n,) Mahalanobis, squared, of 6 degrees of freedom;  error_deg, error_px,
    stated_px : (n,) of the pose's turn,
    and of the print's middle in the picture;  NaN without a pose;  opacity : (n,);  owed :
    (n,) bool, readable
    """

    clip: Clip
    distance: np.ndarray
    error_deg: np.ndarray
    error_px: np.ndarray
    stated_px: np.ndarray
    opacity: np.ndarray
    owed: np.ndarray

    @property
    def held(self) -> float:
        told = self.distance[np.isfinite(self.distance) & (self.opacity > 0)]
        return float((told <= WITHIN).mean()) if len(told) else 1.0

    @property
    def wrong(self) -> list[str]:
        shown = self.opacity > 0
        out = []
        if self.held < self.clip.least_held:
            out.append(f"{self.held:.0%} of the poses within their 95 %")
        if (worst := np.nanmax(self.error_deg[shown], initial=0.0)) > MOST_TURN_DEG:
            out.append(f"a pose off by {worst:.0f} degrees")
        if (missing := int((self.owed & ~shown).sum())) > 0:
            out.append(f"absent in {missing} frames in which the print is readable")
        if (step := float(np.abs(np.diff(self.opacity)).max())) > 0.5:
            out.append(f"opacity jumps by {step:.2f}")
        if (
            most := float(np.nanmax(self.error_px[shown], initial=0.0))
        ) > MOST_OFF_PX:
            out.append(f"the object is {most:.1f} px off")
        return out


def analyse(clip: Clip) -> Found:
    steps = np.linspace(0, 2, clip.frames)
    shown = [clip.shown(float(u)) for u in steps]
    analyser = Observed(AnalysisJob((_PRINT,), _CAMERA))
    for k, s in enumerate(shown):
        analyser.step(AnalysisFrame(k, k / _FPS, frame(s, k)))
    facts = analyser.finish().facts
    rows = np.array([_compare(f, s) for f, s in zip(facts, shown, strict=True)])
    opacity = np.array([f.opacity for f in facts])
    return Found(
        clip,
        rows[:, 0],
        rows[:, 1],
        rows[:, 2],
        rows[:, 3],
        opacity,
        np.array([readable(s) for s in shown]),
    )


def _compare(f: FrameFacts, s: Shown) -> tuple[float, ...]:
    got = f.camera_from_world
    if got is None or f.pose_covariance is None:
        return (np.nan,) * 4
    turn = (
        got.rotation @ s.pose.rotation.T
    )  # estimate = perturbation of the truth from the left
    error = np.concatenate(
        [rotvec_from_rotation(turn), got.translation_m - turn @ s.pose.translation_m]
    )
    seen = camera(_CAMERA.width, _CAMERA.height, _CAMERA.fx * s.zoom).project(
        s.pose.translation_m[None]
    )[0]
    z = got.translation_m
    at = _CAMERA.project(z[None])[0]
    j = _CAMERA.fx / z[2] * np.array([[1, 0, -z[0] / z[2]], [0, 1, -z[1] / z[2]]])
    skew = np.array([[0, z[2], -z[1]], [-z[2], 0, z[0]], [z[1], -z[0], 0]])
    rows = j @ np.concatenate([skew, np.eye(3)], 1)
    stated = float(np.sqrt(np.trace(rows @ f.pose_covariance @ rows.T)))
    distance = float(
        error @ np.linalg.pinv(f.pose_covariance, hermitian=True) @ error
    )
    return (
        distance,
        float(np.degrees(rotation_angle_rad(got, s.pose))),
        float(np.linalg.norm(at - seen)),
        stated,
    )


def plot(found: Sequence[Found]) -> bytes:
    """Errors beside what is stated, and opacity, over time. PNG bytes."""
    columns = 4
    fig = Figure(
        figsize=(4.2 * columns, 2.9 * -(-len(found) // columns)), layout="constrained"
    )
    axes = np.atleast_1d(
        fig.subplots(-(-len(found) // columns), columns, squeeze=False)
    ).ravel()
    for axis, f in zip(axes, found, strict=False):
        t = np.arange(len(f.opacity)) / _FPS
        axis.semilogy(t, f.error_px, lw=1, color="#2f81f7", label="error, px")
        axis.semilogy(t, f.stated_px, "--", lw=1, color="#2f81f7", label="stated, px")
        axis.semilogy(
            t,
            np.sqrt(f.distance / WITHIN),
            lw=0.8,
            color="#d9822b",
            label="distance over its 95 %",
        )
        axis.axhline(1, color="#8b949e", lw=0.6, ls=":")
        axis.set_ylim(1e-3, 1e3)
        twin = axis.twinx()
        twin.fill_between(t, f.opacity, color="#1b9e77", alpha=0.15, lw=0)
        twin.set_ylim(0, 1.02)
        twin.tick_params(labelsize=5)
        axis.set_title(
            f"{f.clip.name}: {f.held:.0%} within 95 %", fontsize=8, loc="left"
        )
        axis.tick_params(labelsize=6)
        axis.legend(fontsize=5, frameon=False)
    for axis in axes[len(found) :]:
        axis.set_visible(False)
    fig.supxlabel("seconds; green: opacity", fontsize=8)
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=110)
    return out.getvalue()
