"""Rows of Tan, Chen, Sun 2009 that take no picture: equations (1), (2) and (4) to (9), on
readings made here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from arfx.analyse.light.fit import FittedLight, LightFit, fit
from arfx.analyse.light.hypotheses import MEASURED
from arfx.analyse.light.patches import WHITE
from arfx.analyse.light.photometry import EXACT, INK, PAPER, Photometry, solve
from arfx.analyse.params import LightParams
from arfx.core.colour import SRGB
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import angle_between, direction_of, normalise
from arfx.papers.s1_gain import brightness, eq6_smallest_vector, gain_and_bias
from arfx.papers.s1_light import (
    LightMap,
    Observation,
    PrintedLightParams,
    eq8_weight,
    eq9_lights,
    hemisphere,
    lights_of,
    squared_weight,
)
from arfx.papers.s1_lightmap import phong
from arfx.reproduce.rows import Items, curves, row
from arfx.reproduce.work import Work
from arfx.stages.composite import shade

BIAS = 12.0  # of 255, in all clips of this module
NOISE, DRIFT_PER_S = 0.05, 0.05  # of readings; by which the light changes in a second
S_RAD, EPSILON_DEG = 0.2, 30.0  # s of (8), epsilon of (9): the paper has no values
UP = np.array([0.0, 0.0, 1.0])
RHO = np.where(WHITE, PAPER, INK)
WEIGHTS = partial(eq8_weight, s=S_RAD), partial(squared_weight, s=S_RAD)
FREE = (
    "the length of (6)'s vector is free, and 1/b' changes with it: dividing (2) by g gives"
    " b' = b/g"
)
PEAKS = (
    "M is irradiance, light blurred by a cosine of 180 degrees: its peaks are no lamps."
    " Corrected: lamps are fitted to it"
)
NO_VALUE = "the paper names it and states no value"


def rows(work: Work) -> Items:
    yield from equation_1()
    yield from equation_2(work.scaled(60, 10))
    yield from equation_4()
    yield from equations_5_6(work.scaled(60, 12))
    yield from equation_7()
    yield from equation_8()
    yield from equation_9(work.scaled(12, 3))
    yield from section_2_3()


def section_2_3() -> Items:
    """Phong's model, and shadows."""
    v = normalise(np.array([[-0.6, 0, 0.8]]))
    d = np.array([0.6, 0, 0.8])
    highlight = phong(UP[None], v, d, np.array([0.3]))[0]
    yield row(
        "section 2.3, Phong's highlight in the mirrored direction",
        "brightest",
        highlight,
        "",
        "",
        abs(highlight - 1) < 1e-9,
    )
    light = np.full((1, 1, 3), SRGB.decode(np.array(200 / 255)), np.float32)
    half = np.full((1, 1, 1), 0.5, np.float32)
    no_bias = np.zeros(3, np.float32)
    dark = np.empty_like(light)
    shade(light, half, np.float32(1), no_bias, dark)
    coded = 255 * SRGB.encode(dark.astype(float))[0, 0, 0]
    yield row(
        "section 2.3, half of the light on coded 200",
        None,
        (coded, coded),
        "of 255",
        "the paper does not say what a shadow takes. Here, by both formulas: a share of the"
        " light, in linear light",
    )


def equation_1() -> Items:
    """Light of a surface."""
    d = normalise(np.array([[0.5, 0.2, 0.8], [-0.6, 0.1, 0.7]]))
    omega = np.array([[0.6, 0.5, 0.4], [0.2, 0.3, 0.4]])
    n = np.concatenate([hemisphere(3), -hemisphere(3)])
    x = np.maximum(n @ d.T, 0) @ omega
    lamps = [*zip(d, omega, strict=True)]
    shared = tuple(DirectionalLight(triple(a), triple(b)) for a, b in lamps)
    fitted = tuple(FittedLight(a, b[None], 1.0) for a, b in lamps)
    found = LightFit(MEASURED, "", np.zeros((1, 3)), np.zeros((1, 3)), fitted)
    both = Light((0.0,) * 3, shared).radiance(n), found.irradiance(n)
    yield row(
        "equation (1), two lights: largest difference from the sum",
        "x = Σ max(n·d, 0) Ω",
        [np.abs(seen - x).max() for seen in both],
        "",
        "",
        below=1e-12,
    )


def clip(seed: int, frames: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """(grey (t, 8) of ink and paper, 0..1, light (t,) of 255), without noise."""
    y = np.random.default_rng(seed).uniform(60, 230, frames)
    return (RHO * y[:, None] + BIAS) / 255, y


def three(grey: np.ndarray) -> np.ndarray:
    return np.repeat(grey[..., None], 3, 2)


def bias_of(found: Photometry) -> float:
    """Of 255."""
    return 255 * float(found.bias[0])


def equation_2(seeds: int) -> Items:
    """Albedos out of a picture."""
    why = (
        "brightness is affine in the albedo, not linear: what is found depends on the light"
        " of the picture that it is taken from. Corrected: known albedos of ink and paper"
    )
    rows = []
    for seed in range(seeds):
        one, y = clip(seed)
        grey = three(one)
        both = gain_and_bias(grey, brightness(grey)), solve(grey, None, RHO)
        ratios = (found.y[:, 0] / found.y[0, 0] / (y / y[0]) for found in both)
        off = (100 * np.abs(ratio - 1).max() for ratio in ratios)
        rows.append([*map(bias_of, both), *off])
    by, bc, ey, ec = np.median(rows, 0)
    low, high = np.percentile(rows, (10, 90), 0)[:, 0]
    yield row(
        "equation (2), ρ as mean brightness: bias, true 12 of 255",
        "12",
        (by, bc),
        "of 255",
        f"{why} (10 to 90 % of clips: {low:.1f} to {high:.1f})",
    )
    yield row(
        "equation (2), ρ as mean brightness: largest error of the light's ratios",
        "0",
        (ey, ec),
        "%",
        why,
    )


def equation_4() -> Items:
    """Gain and bias as reciprocals."""
    for frames in (10, 40):
        grey = three(clip(0, frames)[0])
        inverse, quotient, corrected = (
            bias_of(found)
            for found in (
                gain_and_bias(grey, RHO, printed_bias=True),
                gain_and_bias(grey, RHO),
                solve(grey, None, RHO),
            )
        )
        yield row(
            f"equation (4), b = 1/b', {frames} frames, true 12 of 255",
            "12",
            (inverse, corrected),
            "of 255",
            FREE,
        )
    yield row(
        "equation (4), b = b'/g', 40 frames, true 12 of 255",
        "12",
        (quotient, corrected),
        "of 255",
        tolerance=1e-6,
    )


def equations_5_6(seeds: int) -> Items:
    """The homogeneous system: solutions beside one another, and under noise."""
    grey, _ = clip(0)
    flat = np.tile(RHO * 120 + BIAS, (25, 1)) / 255
    for item, seen, rho in (
        ("equation (5), one patch, 25 frames", grey[:, :1], RHO[:1]),
        ("equation (5), four patches of one albedo, 25 frames", grey[:, :4], RHO[:4]),
        ("equation (6), ink and paper, 25 frames", grey, RHO),
        ("equation (6), ink and paper, one frame", grey[:1], RHO),
        ("equation (6), ink and paper, constant light", flat, RHO),
    ):
        one = solve(three(seen), None, rho, tolerances=EXACT).verdict == MEASURED
        yield row(
            f"{item}: solutions",
            "1",
            (eq6_smallest_vector(seen, rho).nullity, 1 if one else "refused"),
            "dimensions",
            "whatever the light does, a patch of one albedo cannot tell g, b and x apart."
            " Corrected: it is said, and b = 0 assumed",
        )
    yield row(
        "equation (6), bias without noise, true 12 of 255",
        "12",
        (
            255 * eq6_smallest_vector(grey, RHO).bias,
            bias_of(solve(three(grey), None, RHO)),
        ),
        "of 255",
        tolerance=1e-6,
    )
    rho = np.linspace(0.45, 0.55, 8)
    found = []
    solved = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        noisy = rho * rng.uniform(100, 200, (6, 1)) + BIAS + rng.normal(0, 2, (6, 8))
        found.append(
            [unit * eq6_smallest_vector(noisy / unit, rho).bias for unit in (1, 255)]
        )
        solution = solve(three(noisy), None, rho, tolerances=EXACT)
        if solution.verdict == MEASURED:
            solved.append(solution.bias[0])
    for unit, bias in zip(("255", "1"), np.median(found, 0), strict=True):
        yield row(
            "equation (6), bias with noise of 2, true 12 of 255, albedos .45 to .55, I up"
            f" to {unit}",
            "12",
            (bias, np.median(solved)),
            "of 255",
            "the noise is in the I column alone, so the vector is biased, and by the unit of"
            " I. Corrected: g = 1, robust least squares, refused in"
            f" {seeds - len(solved)} of {seeds} clips of 6 frames",
        )


def equation_7() -> Items:
    """The update of the map."""

    def seen(values: np.ndarray) -> np.ndarray:
        """(t, 2) printed and corrected map at a normal that shows these values (t,), one
        after the other.
        """
        printed = LightMap(3, S_RAD)
        corrected = 0.0
        variance = np.inf
        out = []
        at = (printed.n @ UP).argmax()
        for x in values:
            printed.add(UP, np.full(3, x))
            variance += (
                DRIFT_PER_S * corrected
            ) ** 2 / 30  # what it may have changed by
            gain = 1 - NOISE**2 / (NOISE**2 + variance)
            corrected = corrected + gain * (x - corrected)
            variance = gain * NOISE**2
            out.append((printed.M[at, 0], corrected))
        return np.array(out)

    yield row(
        "equation (7), constant light after 1,000 updates",
        "1",
        seen(np.full(1000, 0.7))[-1] / 0.7,
        "of the light",
        tolerance=1e-6,
    )
    noisy = seen(0.7 + NOISE * np.random.default_rng(0).normal(size=400))
    yield row(
        "equation (7), noise of one normal that is left",
        "M ← (1 − f) M + f x",
        100 * np.std(noisy[50:], axis=0) / NOISE,
        "%",
        "f = 1 at the normal itself: the newest reading replaces all older ones. Corrected:"
        " an update by precision",
    )
    yield row(
        "section 2.2, normals that one frame renews by half or more",
        "one",
        [100 * np.mean(weight(hemisphere(4) @ UP) >= 0.5) for weight in WEIGHTS],
        "% of the hemisphere",
        "as section 2.2 says, light that changes at once is not renewed at once; and (8)"
        " lacks its square: see there",
    )


def equation_8() -> Items:
    """The weight of a normal."""
    yield row("equation (8), s", "a blur constant", (S_RAD, S_RAD), "rad", NO_VALUE)
    for angle_deg in (0, 1, 5, 10, 20, 30):
        f = [weight(np.cos(np.radians([angle_deg])))[0] for weight in WEIGHTS]
        yield row(
            f"equation (8), weight at {angle_deg} degrees",
            "exp(−θ / (2 s²))",
            f,
            "",
            "the square of a Gaussian is missing in print: the weight has a cusp at 0",
            np.ptp(f) < 1e-6,
        )
    # nothing of the sphere is left out by cos(cos θ) > 0, half of it by cos θ > 0
    away = np.cos(np.radians([91.0, 120, 150, 180]))
    yield row(
        "equation (8), condition cos(n·n') > 0: directions behind that it excludes",
        "all",
        [100 * np.mean(f == 0) for f in (eq8_weight(away, 2.0), WEIGHTS[1](away))],
        "%",
        "the cosine of a cosine is never negative: the condition excludes nothing."
        " Corrected: n·n' > 0",
    )
    angles_deg = np.linspace(0, 40, 161)
    printed, corrected = (
        weight(np.cos(np.radians(angles_deg))) for weight in WEIGHTS
    )
    yield curves(
        "equation (8), weight at 10 degrees",
        "weight of a reading over the angle to its normal",
        (
            "angle between a normal and the one that was seen, degrees",
            f"weight, s = {S_RAD} rad",
        ),
        angles_deg,
        {"printed": printed, "corrected": corrected},
    )


def lit(n: np.ndarray, lamps: np.ndarray, ambient: float) -> np.ndarray:
    """(k, 3) irradiance of lamps of strength 1 in directions (l, 3)."""
    return np.repeat((ambient + np.maximum(n @ lamps.T, 0).sum(1))[:, None], 3, 1)


def cap(count: int, seed: int = 0) -> np.ndarray:
    """(count, 3) normals within 75 degrees of UP."""
    rng = np.random.default_rng(seed)
    z = 1 - rng.random(count) * (1 - np.cos(np.radians(75)))
    return direction_of(2 * np.pi * rng.random(count), np.arcsin(z))


def equation_9(seeds: int) -> Items:
    """Lights at the peaks of the map."""
    params = PrintedLightParams(albedos="known")
    yield row(
        "equation (9), I_c",
        "a large value",
        f"{params.peak:g} of the largest",
        "",
        NO_VALUE,
    )
    yield row(
        "equation (9), ε", "a small angle", params.peak_apart_deg, "degrees", NO_VALUE
    )
    candidates = hemisphere(4)
    n = cap(220)
    for apart_deg in (30, 60, 80):
        half = np.radians(apart_deg / 2)
        lamps = np.array([[s * np.sin(half), 0, np.cos(half)] for s in (1, -1)])
        M = lit(candidates, lamps, 0.2)
        peaks = candidates[eq9_lights(M, candidates, 0.0, EPSILON_DEG)]
        fitted = [
            li.direction
            for li in fit(n, lit(n, lamps, 0.2)).lights
            if not li.dome and li.confidence_deg < 90
        ]
        what = f"equation (9), two equal lamps {apart_deg} degrees apart"
        yield row(
            f"{what}: lights", "2", (len(peaks), len(fitted) or "refused"), "", PEAKS
        )
        yield row(
            f"{what}: direction off",
            "0",
            (off_deg(peaks, lamps), off_deg(fitted, lamps) if fitted else "refused"),
            "degrees",
            PEAKS,
        )
    off = [one_lamp(seed, params) for seed in range(seeds)]
    yield row(
        "equation (9), one lamp with ambient light, median: direction off",
        "0",
        np.nanmedian(off, 0),
        "degrees",
        PEAKS,
    )
    normals = normalise(np.random.default_rng(0).normal(size=(50, 3)))
    single = (lights_of([reading(n, 0.6)], params)[0][0].lights for n in normals)
    claimed = (
        fit(np.tile(n, (20, 1)), np.full((20, 3), 0.6)).verdict == MEASURED
        for n in normals[:5]
    )
    yield row(
        "equation (9), a marker at rest, 50 normals: lights",
        "at a peak",
        (sum(map(len, single)), sum(claimed)),
        "",
        "from one normal no direction can be known: the peak is the normal itself."
        " Corrected: refused, another cue is taken",
    )
    five = normalise(
        np.array([[0, 0, 1.0], [1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]])
    )
    kept = lights_of([reading(five, 0.6)], PrintedLightParams(peak=0.3))[0][0].lights
    yield row(
        "equation (9), five peaks: lights",
        "5",
        (len(kept), LightParams().most_lights),
        "",
        "corrected: two lamps at most",
    )


def reading(
    n: np.ndarray, x: np.ndarray | float, variance: float = 1e-6
) -> Observation:
    normals = np.atleast_2d(n)
    return Observation(
        normals, np.full(normals.shape, x), np.full(normals.shape, variance)
    )


def off_deg(found: Sequence[np.ndarray] | np.ndarray, lamps: np.ndarray) -> float:
    """Largest angle from a found direction to the nearest lamp; NaN where none is found."""
    away = (float(np.degrees(angle_between(d, lamps).min())) for d in found)
    return max(away, default=np.nan)


def one_lamp(seed: int, params: PrintedLightParams) -> tuple[float, float]:
    """Degrees off by the printed and the corrected method, NaN where nothing is claimed: a
    marker turned through 100 normals.
    """
    rng = np.random.default_rng(seed)
    tilt = np.radians(rng.uniform(10, 45))
    azimuth = rng.uniform(0, 2 * np.pi)
    lamp = direction_of(azimuth, np.pi / 2 - tilt)[None]
    n = cap(100, seed)
    x = lit(n, lamp, 0.4) * (1 + 0.005 * rng.normal(size=(100, 1)))
    readings = [reading(*each, 1e-5) for each in zip(n, x, strict=True)]
    printed = lights_of(readings, params)[0][-1].lights[0]
    corrected = fit(n, x, np.full(x.shape, 1e-5)).lights[:1]
    return off_deg([printed.unit], lamp), off_deg(
        [li.direction for li in corrected], lamp
    )
