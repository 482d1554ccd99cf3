"""What a sweep towards a singularity is, and how it is judged.

Inputs that are delta away from a singularity, delta from 1 down to 1e-12. A sweep states
where an answer is owed and where a refusal is: an answer where the least standard deviation
that the data allow (the Cramer-Rao bound of the noise put in) is one that a user can use, a
refusal where no method could answer. A refusal where an answer is owed is a failure, as is
an answer where a refusal is owed, and one that is further from the truth than the data and
the answer's own uncertainty explain."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from arfx.errors import ArfxError

# four points a decade where answers turn into refusals, one beyond
DELTAS = (*(10.0 ** (-k / 4) for k in range(17)), *(10.0**-k for k in range(5, 13)))
ANSWER, REFUSAL, EITHER = "answer", "refusal", "either"
SIGMAS = 4.0  # an answer further from the truth than this is wrong


@dataclass(frozen=True)
class Data:
    """What kind of numbers a sweep is given. rounding : relative, of the inputs;  camera :
    with the noise of one
    draw : seed of the noise"""

    kind: str
    rounding: float = 0.0
    camera: bool = False
    draw: int = 0

    def __call__(self, value: Any) -> Any:
        """As the inputs carry it."""
        return (
            value
            if self.kind == EXACT.kind
            else np.asarray(value, np.float32).astype(float)
        )

    def noise(self, sigma: float, shape: tuple[int, ...]) -> np.ndarray:
        """Normal noise of a camera, 0 for exact numbers."""
        return (
            np.random.default_rng(self.draw).normal(0, sigma, shape)
            if self.camera
            else np.zeros(shape)
        )


EXACT, FLOAT32 = Data("float64", 1e-16), Data("float32", 6e-8)
CAMERA = tuple(Data("camera", 6e-8, True, draw) for draw in range(6))
NUMBERS: tuple[tuple[Data, ...], ...] = ((EXACT,), (FLOAT32,))
WITH_CAMERA: tuple[tuple[Data, ...], ...] = (*NUMBERS, CAMERA)


@dataclass(frozen=True)
class Answer:
    """error : its distance from the truth;  stated : its own standard deviation, nan where
    it states none
    """

    error: float
    stated: float = float("nan")


@dataclass(frozen=True)
class Expected:
    """owed : ANSWER, REFUSAL or EITHER;  bound : least standard deviation possible, or for
    closed forms the error allowed
    """

    owed: str
    bound: float


@dataclass(frozen=True)
class Sweep:
    """answer(delta, formula, data) : None or an ArfxError = refused;  expected(delta,
    data);  unit : of errors and bounds
    formulas : that it is run under;  unbounded : formulas whose error is told, not limited
    (the paper's own defects)
    """

    name: str
    towards: str
    unit: str
    answer: Callable[[float, str, Data], Answer | None]
    expected: Callable[[float, Data], Expected]
    kinds: tuple[tuple[Data, ...], ...] = NUMBERS
    deltas: tuple[float, ...] = DELTAS
    formulas: tuple[str, ...] = ("corrected",)
    unbounded: tuple[str, ...] = ()


def always(float64: float, float32: float) -> Callable[[float, Data], Expected]:
    """A closed form: an answer is always owed, within these errors."""
    return lambda delta, data: Expected(
        ANSWER, float64 / SIGMAS if data is EXACT else float32 / SIGMAS
    )


def informed(
    sigma: Callable[[float, Data], float], useful: float, useless: float
) -> Callable[[float, Data], Expected]:
    """An estimate: an answer is owed where its least standard deviation is at most
    `useful`, a refusal from `useless` on.
    """

    def expected(delta: float, data: Data) -> Expected:
        least = sigma(delta, data)
        return Expected(
            ANSWER if least <= useful else REFUSAL if not least < useless else EITHER,
            least,
        )

    return expected


def least_sigma(
    model: Callable[[np.ndarray], np.ndarray], at: Sequence[float], sigma: float | np.ndarray,
    prior: Sequence[float] | None = None,
) -> np.ndarray:  # fmt: skip
    """(p, p) Cramer-Rao bound of the covariance of the parameters `at`, from readings
    model(at) with standard deviation sigma.

    prior : (p,) standard deviations known beforehand, inf = nothing. Infinite where the
    readings do not determine them.
    """
    x = np.asarray(at, float)
    steps = np.eye(len(x)) * 1e-6
    jacobian = np.stack(
        [(model(x + s) - model(x - s)).ravel() / 2e-6 for s in steps], 1
    )
    rows = jacobian / np.broadcast_to(sigma, model(x).shape).reshape(-1, 1)
    information = rows.T @ rows + np.diag(
        np.zeros(len(x)) if prior is None else 1 / np.square(prior)
    )
    size = np.sqrt(np.diag(information))
    if not size.all() or np.linalg.cond(information / np.outer(size, size)) > 1e13:
        return np.full((len(x), len(x)), np.inf)
    return np.asarray(
        np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    )


@dataclass(frozen=True)
class Point:
    """One delta. answers : one a draw, None = refused;  wrong : what does not hold, "" =
    all does
    """

    delta: float
    expected: Expected
    answers: tuple[Answer | None, ...]
    wrong: str

    @property
    def error(self) -> float | None:
        """Root mean square of those given."""
        told = [a.error for a in self.answers if a is not None]
        return float(np.sqrt(np.mean(np.square(told)))) if told else None

    @property
    def refused(self) -> int:
        return sum(a is None for a in self.answers)


@dataclass(frozen=True)
class Result:
    sweep: Sweep
    formula: str
    kind: str
    points: tuple[Point, ...]

    @property
    def wrong(self) -> list[str]:
        return [f"at {p.delta:.2g}: {p.wrong}" for p in self.points if p.wrong]

    @property
    def worst(self) -> float | None:
        return max(
            (e for p in self.points if (e := p.error) is not None), default=None
        )

    def count(self, owed: str) -> tuple[int, int]:
        """(points at which that is owed, of these so many where all draws got it)"""
        mine = [p for p in self.points if p.expected.owed == owed]
        got = [
            p for p in mine if p.refused == (len(p.answers) if owed == REFUSAL else 0)
        ]
        return len(mine), len(got)


def run(sweep: Sweep, deltas: Sequence[float] | None = None) -> list[Result]:
    out = []
    for formula in sweep.formulas:
        for draws in sweep.kinds:
            free = formula in sweep.unbounded
            points = tuple(
                _point(sweep, delta, formula, draws, free)
                for delta in sweep.deltas
                if deltas is None or delta in deltas
            )
            out.append(Result(sweep, formula, draws[0].kind, points))
    return out


def _point(
    sweep: Sweep, delta: float, formula: str, draws: Sequence[Data], free: bool
) -> Point:
    answers = []
    for data in draws:
        try:
            answers.append(sweep.answer(delta, formula, data))
        except ArfxError:
            answers.append(None)
    expected = Expected(EITHER, np.inf) if free else sweep.expected(delta, draws[0])
    return Point(delta, expected, tuple(answers), _wrong(expected, answers))


def _wrong(expected: Expected, answers: Sequence[Answer | None]) -> str:
    told = [a for a in answers if a is not None]
    if expected.owed == ANSWER and len(told) < len(answers):
        return f"refused, though {expected.bound:.1e} could be known"
    if expected.owed == REFUSAL and told:
        return (
            f"answered, though nothing better than {expected.bound:.1e} can be known"
        )
    for a in told:
        if not np.isfinite(a.error):
            return "not finite"
        if a.error > SIGMAS * max(
            expected.bound, a.stated if np.isfinite(a.stated) else 0.0
        ):
            return f"error {a.error:.1e}, stated {a.stated:.1e}, possible {expected.bound:.1e}"
    return ""


def plot(results: Sequence[Result]) -> bytes:
    """Error, stated uncertainty and bound against delta, one panel a sweep. PNG bytes."""
    names = list(dict.fromkeys((r.sweep.name, r.sweep.towards) for r in results))
    columns = 4
    fig = Figure(
        figsize=(4.2 * columns, 2.9 * -(-len(names) // columns)), layout="constrained"
    )
    axes = np.atleast_1d(
        fig.subplots(-(-len(names) // columns), columns, squeeze=False)
    ).ravel()
    colours = {"float64": "#2f81f7", "float32": "#1b9e77", "camera": "#d9822b"}
    for axis, (name, towards) in zip(axes, names, strict=False):
        mine = [
            r for r in results if (r.sweep.name, r.sweep.towards) == (name, towards)
        ]
        for row, r in enumerate(mine):
            delta, colour = (
                [p.delta for p in r.points],
                colours[r.kind] if r.formula == "corrected" else "#8b949e",
            )
            axis.loglog(delta, [np.nan if p.error is None else max(p.error, 1e-18) for p in r.points], "-", marker=".", ms=3,
                        lw=1, color=colour, label=f"{r.formula} {r.kind}: error")  # fmt: skip
            stated = [
                np.median([a.stated for a in p.answers if a is not None] or [np.nan])
                for p in r.points
            ]
            if np.isfinite(stated).any():
                axis.loglog(delta, stated, "--", lw=1, color=colour, label="stated")
            if r.formula not in r.sweep.unbounded:
                axis.loglog(
                    delta,
                    [p.expected.bound for p in r.points],
                    ":",
                    lw=0.8,
                    color=colour,
                )
            refused = [p.delta for p in r.points if p.refused]
            axis.plot(
                refused,
                [0.98 - 0.05 * row] * len(refused),
                "x",
                ms=4,
                color=colour,
                transform=axis.get_xaxis_transform(),
            )
        for p in mine[-1].points:
            if p.expected.owed == REFUSAL:
                axis.axvspan(
                    p.delta / 1.4, p.delta * 1.4, color="#8b949e", alpha=0.12, lw=0
                )
        axis.set_title(f"{name}, towards {towards}", fontsize=8, loc="left")
        axis.set_ylabel(mine[0].sweep.unit, fontsize=7)
        axis.tick_params(labelsize=6)
        axis.legend(fontsize=5, frameon=False)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    fig.supxlabel(
        "distance from the singularity; dotted: what the data allow (or the error allowed);"
        " crosses: refused; grey: a refusal is owed; 1e-18 stands for no error",
        fontsize=8,
    )
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=110)
    return out.getvalue()
