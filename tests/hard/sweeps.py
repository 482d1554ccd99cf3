"""Towards every singularity of the code: inputs that are delta away from one, delta from 1e-1 to 1e-12.

For each the error against a closed form has to stay within its bound, or the code has to refuse. "float32" means that the
inputs carry float32's rounding, as everything that comes from pixels does; the solves are float64 throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from arfx.analyse.light.fit import REFUSED, fit
from arfx.analyse.light.light_map import add
from arfx.analyse.light.photometry import MEASURED, solve
from arfx.analyse.pose.planar import hypotheses
from arfx.core.camera import Camera
from arfx.core.lens import Lens, circle_of_confusion_mm, depth_of_field
from arfx.core.lens_fit import lens_from_blur
from arfx.core.marker import MarkerSpec
from arfx.core.numerics import angle_between, normalise
from arfx.core.pose import Pose, rotation_angle_rad, rotation_from_rotvec, rotvec_from_rotation
from arfx.errors import ArfxError
from arfx.papers.s1_gain import gain_and_bias
from arfx.papers.s1_light import eq8_weight
from arfx.papers.s2_lens import printed_limits
from arfx.papers.s4_volumes import octree_of
from arfx.stages.gi.pyramid import levels_of, structure_of
from arfx.stages.gi.voxelise import Volume

DELTAS = tuple(10.0**-k for k in range(1, 13))
Round = Callable[[Any], Any]


@dataclass(frozen=True)
class Sweep:
    """error(delta, formula, rounded) : its size, None = refused;  bound : by type of the inputs;  unit : of both
    formulas : that it is run under;  unbounded : formulas whose error is told, not limited (the paper's own defects)
    """

    name: str
    towards: str
    unit: str
    error: Callable[[float, str, Round], float | None]
    bound: dict[str, float]
    formulas: tuple[str, ...] = ("corrected",)
    unbounded: tuple[str, ...] = ()


@dataclass(frozen=True)
class Result:
    """errors : one a delta, None = refused;  sound : all finite and within the bound, or refused"""

    sweep: Sweep
    formula: str
    kind: str
    errors: tuple[float | None, ...]
    sound: bool

    @property
    def worst(self) -> float | None:
        told = [e for e in self.errors if e is not None]
        return max(told) if told else None


def run(sweep: Sweep, deltas: Sequence[float] = DELTAS) -> list[Result]:
    out = []
    for formula in sweep.formulas:
        for kind, rounded in (("float64", _as_is), ("float32", _float32)):
            errors = []
            for delta in deltas:
                try:
                    errors.append(sweep.error(delta, formula, rounded))
                except ArfxError:
                    errors.append(None)
            bound = np.inf if formula in sweep.unbounded else sweep.bound[kind]
            sound = all(e is None or (np.isfinite(e) and e <= bound) for e in errors)
            out.append(Result(sweep, formula, kind, tuple(errors), sound))
    return out


def _as_is(v: Any) -> Any:
    return v


def _float32(v: Any) -> Any:
    return np.asarray(v, np.float32).astype(float)


_AXES = normalise(np.random.default_rng(3).normal(size=(12, 3)))


def _rotation(at: float) -> Callable[[float, str, Round], float]:
    """Rotation matrix to vector and back, at angles delta beside `at`."""

    def error(delta: float, formula: str, rounded: Round) -> float:
        angles = np.array([at - delta, at, at + delta])
        matrices = rotation_from_rotvec((_AXES[:, None] * angles[:, None]).reshape(-1, 3))
        given = rounded(matrices)
        return float(np.abs(rotation_from_rotvec(rotvec_from_rotation(given)) - matrices).max())

    return error


def _between(at: float) -> Callable[[float, str, Round], float]:
    def error(delta: float, formula: str, rounded: Round) -> float:
        angle = at + (-delta if at > 0 else delta)
        a = np.array([1.0, 0.0, 0.0])
        b = np.array([np.cos(angle), np.sin(angle), 0.0])
        return abs(float(angle_between(rounded(a), rounded(b))) - angle)

    return error


def _light_weight(delta: float, formula: str, rounded: Round) -> float:
    """Eq. (8) at an angle delta from the normal, against the exponential itself."""
    s = 0.2
    cosine, variance = rounded(np.cos(delta)), np.full((1, 3), 1e12)
    add(
        np.array([[0.0, 0, cosine]]),
        np.zeros((1, 3)),
        variance,
        np.array([[0.0, 0, 1]]),
        np.zeros((1, 3)),
        np.ones((1, 3)),
        0,
        1,
        s,
    )
    found = 1 / float(variance[0, 0]) if formula == "corrected" else float(eq8_weight(cosine, s))
    return abs(found - float(np.exp(-(delta**2) / (2 * s * s))))


def _focus(delta: float, formula: str, rounded: Round) -> float:
    """Blur circle of a thing delta beyond the focus: against the difference written out."""
    lens = Lens(50.0, 2.8, 800.0)
    away = float(rounded(800.0 * (1 + delta)))
    exact = 50.0 * 50.0 * 800.0 * delta / ((800.0 - 50.0) * 2.8 * 800.0 * (1 + delta))
    return abs(float(circle_of_confusion_mm(away, lens)) - exact)


def _near_lens(delta: float, formula: str, rounded: Round) -> float:
    """A thing at a distance of delta focal lengths: bounded by its documented limit."""
    lens = Lens(50.0, 2.8, 800.0)
    limit = float(circle_of_confusion_mm(0.01 * 50.0, lens))
    return max(float(circle_of_confusion_mm(rounded(50.0 * delta), lens)) / limit - 1, 0.0)


def _focal(delta: float, formula: str, rounded: Round) -> float:
    """Focused delta beyond the focal length: finite, and what the formula says."""
    focus = float(rounded(50.0 * (1 + delta)))
    lens = Lens(50.0, 2.8, focus)  # refuses where rounding leaves nothing
    exact = 50.0 / 2.8 * 50.0 / (focus - 50.0)
    return abs(lens.coc_at_infinity_mm / exact - 1)


def _hyperfocal(delta: float, formula: str, rounded: Round) -> float | None:
    """Focused just nearer than the hyperfocal distance: the blur at the far limit is the circle that was allowed."""
    far = 50.0 * 50.0 / (8.0 * 0.03) + (50.0 if formula == "corrected" else 0.0)
    lens = Lens(50.0, 8.0, float(rounded(far * (1 - delta))))
    back = (depth_of_field if formula == "corrected" else printed_limits)(lens, 0.03).back_mm
    if back is None or np.isinf(back):
        return None
    return abs(float(circle_of_confusion_mm(lens.focus_mm + back, lens)) / 0.03 - 1)


def _albedo(delta: float, formula: str, rounded: Round) -> float | None:
    """Two albedos delta apart: the bias, against its own stated interval where it has one (1 = at its end)."""
    rho = np.array([0.5 - delta / 2, 0.5 + delta / 2] * 4)
    y = np.random.default_rng(0).uniform(0.3, 0.9, (30, 3))
    seen = rounded(rho[None, :, None] * y[:, None] + 0.05)
    found = (solve if formula == "corrected" else gain_and_bias)(seen, albedo=rho)
    return None if found.verdict != MEASURED else float(np.abs(found.bias - 0.05).max())


def _normals(delta: float, formula: str, rounded: Round) -> float | None:
    """Normals within 10 delta of the middle one: the lamp's direction, degrees, or none."""
    rng = np.random.default_rng(2)
    tilt, phi = 10 * delta * np.sqrt(rng.random(120)), 2 * np.pi * rng.random(120)
    n = np.stack([np.sin(tilt) * np.cos(phi), np.sin(tilt) * np.sin(phi), np.cos(tilt)], -1)
    lamp = normalise(np.array([0.5, 0.3, 0.8]))
    light = np.clip(n @ lamp, 0, None)[:, None] * np.array([0.6, 0.5, 0.4]) + 0.2
    found = fit(n, rounded(light))
    if found.verdict == REFUSED or not found.lights:
        return None
    off = min(float(np.degrees(angle_between(np.array(li.direction), lamp))) for li in found.lights)
    return off / max(min(li.confidence_deg for li in found.lights), 3.0)


def _tilt(at: float) -> Callable[[float, str, Round], float | None]:
    """A marker of 10 cm half a metre away, tilted by an angle delta from `at`: the best hypothesis's turn, degrees."""

    def error(delta: float, formula: str, rounded: Round) -> float | None:
        turn = rotation_from_rotvec(np.array([at - delta if at > 0 else delta, 0.0, 0.0])) @ np.diag([1.0, -1.0, -1.0])
        corners = MarkerSpec("36h11", 0, 0.1).corners_m
        seen = corners @ turn.T + np.array([0.02, 0.01, 0.5])
        ideal = rounded(seen[:, :2] / seen[:, 2:])
        focal = np.broadcast_to(900.0 * np.eye(2), (1, 4, 2, 2))
        (found,) = hypotheses([corners], ideal[None], focal, np.array([0.1]))
        if not found:
            return None
        off = [rotation_angle_rad(h.camera_from_marker, Pose(turn, np.zeros(3))) for h in found]
        return float(np.degrees(min(off)))

    return error


def _baseline(delta: float, formula: str, rounded: Round) -> float | None:
    """A marker seen 100 delta pixels wide: turn of the best hypothesis beside what a tenth of a pixel leaves, or none."""
    away = 0.1 * 900.0 / (100.0 * delta)
    turn = rotation_from_rotvec(np.array([0.6, 0.2, 0.0])) @ np.diag([1.0, -1.0, -1.0])
    corners = MarkerSpec("36h11", 0, 0.1).corners_m
    seen = corners @ turn.T + np.array([0.02, 0.01, 1.0]) * away
    (found,) = hypotheses([corners], rounded(seen[:, :2] / seen[:, 2:])[None], np.broadcast_to(900.0 * np.eye(2), (1, 4, 2, 2)),
                          np.array([0.1]))  # fmt: skip
    if not found:
        return None
    off = min(rotation_angle_rad(h.camera_from_marker, Pose(turn, np.zeros(3))) for h in found)
    return float(off / max(0.1 / (100.0 * delta), 1e-3))


def _dioptres(delta: float, formula: str, rounded: Round) -> float | None:
    """Edges whose distances differ by a share delta: the focus of the lens in units of its interval, or none."""
    d = 2.0 * (1 + delta * np.linspace(-1, 1, 60))
    blur = np.sqrt(0.6**2 + (15.0 / 2 * (d - 2.0 * (1 - 0.3 * delta))) ** 2)
    found = lens_from_blur(rounded(d), rounded(blur), 0.02)
    return None if not found.known else abs(found.focus - 2.0 * (1 - 0.3 * delta)) / max(found.focus_ci95, 1e-6)


def _distance(delta: float, formula: str, rounded: Round) -> float | None:
    """A point delta metres before the camera, a millionth of a radian wide: pixel to direction and back, px."""
    camera = Camera(1280, 720, np.array([[900.0, 0, 640], [0, 900.0, 360], [0, 0, 1]]), np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]))
    point = np.array([[0.1 * delta, 0.05 * delta, delta]])
    pixel = camera.project(rounded(point))
    if not np.isfinite(pixel).all():
        return None
    again = camera.project(np.concatenate([camera.normalised(pixel), np.ones((1, 1))], 1))
    return float(np.abs(again - pixel).max())


def _focal_length(delta: float, formula: str, rounded: Round) -> float:
    """A focal length of width / delta: the same."""
    f = 1280.0 / delta
    camera = Camera(1280, 720, np.array([[f, 0, 640], [0, f, 360], [0, 0, 1.0]]))
    pixels = np.array([[3.0, 5.0], [640.0, 360.0], [1270.0, 700.0]])
    ideal = rounded(camera.normalised(pixels))
    return float(np.abs(camera.project(np.concatenate([ideal, np.ones((3, 1))], 1)) - pixels).max())


_WALL = np.array([(7, y, z) for z in range(16) for y in range(16)])


def _wall(delta: float, formula: str, rounded: Round) -> float:
    """A wall of opacity 1 - delta, one voxel thick, at the mip level of eight voxels: what leaks beside what should."""
    values = np.zeros((len(_WALL), 4), np.float32)
    values[:, 3] = rounded(1 - delta)
    if formula == "paper":
        tree = octree_of(Volume(16, (0.0, 0.0, 0.0), 1.0), _WALL, np.zeros((len(_WALL), 3)), values[:, 3])
        opacity = tree.tree.eta[tree.rows_of(3), 3]
    else:
        opacity = levels_of(structure_of(_WALL, 16), values)[3][:, 0, 3]
    return abs(float(opacity.max()) - (1 - delta))


BOTH = ("corrected", "paper")
SWEEPS: tuple[Sweep, ...] = (
    Sweep("rotation vector", "angle 0", "matrix element", _rotation(0.0), {"float64": 1e-12, "float32": 1e-6}),
    Sweep("rotation vector", "angle pi/2", "matrix element", _rotation(np.pi / 2), {"float64": 1e-12, "float32": 1e-6}),
    Sweep("rotation vector", "angle pi", "matrix element", _rotation(np.pi), {"float64": 1e-12, "float32": 1e-6}),
    Sweep("angle between", "angle 0", "rad", _between(0.0), {"float64": 1e-15, "float32": 1e-7}),
    Sweep("angle between", "angle pi/2", "rad", _between(np.pi / 2), {"float64": 1e-15, "float32": 1e-7}),
    Sweep("angle between", "angle pi", "rad", _between(np.pi), {"float64": 1e-12, "float32": 3e-7}),
    Sweep("weight of a normal, eq. 8", "angle 0", "of 1", _light_weight, {"float64": 1e-9, "float32": 1e-5}, BOTH, ("paper",)),
    Sweep("blur circle", "the focus", "mm", _focus, {"float64": 1e-13, "float32": 1e-6}),
    Sweep("blur circle", "distance 0", "share over its limit", _near_lens, {"float64": 1e-12, "float32": 1e-6}),
    Sweep("lens", "focus at the focal length", "share", _focal, {"float64": 1e-9, "float32": 1e-9}),
    Sweep(
        "depth of field", "the hyperfocal distance", "share", _hyperfocal, {"float64": 1e-3, "float32": 1e-1}, BOTH, ("paper",)
    ),
    Sweep("photometry", "albedo contrast 0", "bias, of 1", _albedo, {"float64": 0.02, "float32": 0.02}, BOTH, ("paper",)),
    Sweep("light direction", "one normal", "of its confidence", _normals, {"float64": 2.0, "float32": 2.0}),
    Sweep("marker pose", "facing the camera", "deg", _tilt(0.0), {"float64": 0.05, "float32": 0.5}),
    Sweep("marker pose", "edge on", "deg", _tilt(np.pi / 2), {"float64": 1.0, "float32": 3.0}),
    Sweep("marker pose", "no width", "of its uncertainty", _baseline, {"float64": 3.0, "float32": 3.0}),
    Sweep("lens of the footage", "one distance", "of its interval", _dioptres, {"float64": 2.0, "float32": 2.0}),
    Sweep("projection", "distance 0", "px", _distance, {"float64": 1e-3, "float32": 1e-3}),
    Sweep("projection", "an endless focal length", "px", _focal_length, {"float64": 1e-3, "float32": 1e-3}),
    Sweep("voxel wall", "opacity 1", "of 1", _wall, {"float64": 1e-6, "float32": 1e-6}, BOTH, ("paper",)),
)


def plot(results: Sequence[Result]) -> bytes:
    """Error against delta, one panel a sweep; refusals are crosses along the top. PNG bytes."""
    import io

    from matplotlib.figure import Figure

    names = list(dict.fromkeys((r.sweep.name, r.sweep.towards) for r in results))
    columns = 4
    rows = -(-len(names) // columns)
    fig = Figure(figsize=(4.0 * columns, 2.7 * rows), layout="constrained")
    axes = np.atleast_1d(fig.subplots(rows, columns, squeeze=False)).ravel()
    colours = {"corrected": "#2f81f7", "paper": "#d9822b"}
    for axis, (name, towards) in zip(axes, names, strict=False):
        mine = [r for r in results if (r.sweep.name, r.sweep.towards) == (name, towards)]
        for r in mine:
            style = "-" if r.kind == "float64" else "--"
            y = [np.nan if e is None else max(e, 1e-18) for e in r.errors]
            axis.loglog(
                DELTAS[: len(y)], y, style, marker=".", ms=3, lw=1, color=colours[r.formula], label=f"{r.formula} {r.kind}"
            )
            refused = [d for d, e in zip(DELTAS, r.errors, strict=False) if e is None]
            axis.plot(refused, [0.97 if r.kind == "float64" else 0.92] * len(refused), "x", ms=4, color=colours[r.formula],
                      transform=axis.get_xaxis_transform())  # fmt: skip
        for value in mine[0].sweep.bound.values():
            axis.axhline(value, color="#8b949e", lw=0.6, ls=":")
        axis.set_title(f"{name}, towards {towards}", fontsize=8, loc="left")
        axis.set_ylabel(mine[0].sweep.unit, fontsize=7)
        axis.tick_params(labelsize=6)
        axis.legend(fontsize=5, frameon=False)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    fig.supxlabel(
        "distance from the singularity; crosses: refused (upper row float64, lower float32); dotted: what float64 (lower) and "
        "float32 (upper) must stay below; 1e-18 stands for no error",
        fontsize=8,
    )
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=110)
    return out.getvalue()
