"""Rows of Tan, Chen, Sun 2009 that take no picture: equations (1), (2) and (4) to (9), on
readings made here.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from arfx.analyse.light.fit import FittedLight, LightFit, fit
from arfx.analyse.light.hypotheses import MEASURED
from arfx.analyse.light.patches import WHITE
from arfx.analyse.light.photometry import EXACT, INK, PAPER, solve
from arfx.analyse.params import LightParams
from arfx.core.colour import SRGB
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import angle_between, normalise
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
from arfx.reproduce.rows import Item, curves, row
from arfx.reproduce.work import Work
from arfx.stages.composite import shade

BIAS = 12.0  # of 255, in all clips of this module
NOISE, DRIFT_PER_S = 0.05, 0.05  # of readings; by which the light changes in a second
S_RAD, EPSILON_DEG = 0.2, 30.0  # s of (8), epsilon of (9): the paper has no values
UP = np.array([0.0, 0.0, 1.0])
RHO = np.where(WHITE, PAPER, INK)
FREE = (
    "the length of (6)'s vector is free, and 1/b' changes with it: dividing (2) by g gives"
    " b' = b/g"
)
PEAKS = (
    "M is irradiance, light blurred by a cosine of 180 degrees: its peaks are no lamps."
    " Corrected: lamps are fitted to it"
)
NO_VALUE = "the paper names it and states no value"


def rows(work: Work) -> Iterator[Item]:
    yield from equation_1()
    yield from equation_2(work.scaled(60, 10))
    yield from equation_4()
    yield from equations_5_6(work.scaled(60, 12))
    yield from equation_7()
    yield from equation_8()
    yield from equation_9(work.scaled(12, 3))
    yield from section_2_3()


def section_2_3() -> Iterator[Item]:
    """Phong's model, and shadows."""
    v, d = normalise(np.array([[-0.6, 0, 0.8]])), np.array([0.6, 0, 0.8])
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
    dark = np.empty_like(light)
    shade(
        light,
        np.full((1, 1, 1), 0.5, np.float32),
        np.float32(1),
        np.zeros(3, np.float32),
        dark,
    )
    coded = 255 * SRGB.encode(dark.astype(float))[0, 0, 0]
    yield row(
        "section 2.3, half of the light on coded 200",
        None,
        (coded, coded),
        "of 255",
        "the paper does not say what a shadow takes. Here, by both formulas: a share of the"
        " light, in linear light",
    )


def equation_1() -> Iterator[Item]:
    """Light of a surface."""
    d = normalise(np.array([[0.5, 0.2, 0.8], [-0.6, 0.1, 0.7]]))
    omega = np.array([[0.6, 0.5, 0.4], [0.2, 0.3, 0.4]])
    n = np.concatenate([hemisphere(3), -hemisphere(3)])
    x = np.maximum(n @ d.T, 0) @ omega
    shared = Light(
        (0.0,) * 3,
        tuple(
            DirectionalLight(triple(a), triple(b)) for a, b in zip(d, omega, strict=True)
        ),
    )
    found = LightFit(
        MEASURED,
        "",
        np.zeros((1, 3)),
        np.zeros((1, 3)),
        tuple(FittedLight(a, b[None], 1.0) for a, b in zip(d, omega, strict=True)),
    )
    off = tuple(np.abs(e - x).max() for e in (shared.radiance(n), found.irradiance(n)))
    yield row(
        "equation (1), two lights: largest difference from the sum",
        "x = Σ max(n·d, 0) Ω",
        off,
        "",
        "",
        max(off) < 1e-12,
    )


def clip(seed: int, frames: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """(grey (t, 8) of ink and paper, 0..1, light (t,) of 255), without noise."""
    y = np.random.default_rng(seed).uniform(60, 230, frames)
    return (RHO * y[:, None] + BIAS) / 255, y


def three(grey: np.ndarray) -> np.ndarray:
    return np.repeat(grey[..., None], 3, 2)


def equation_2(seeds: int) -> Iterator[Item]:
    """Albedos out of a picture."""
    why = (
        "brightness is affine in the albedo, not linear: what is found depends on the light"
        " of the picture that it is taken from. Corrected: known albedos of ink and paper"
    )
    found: list[list[float]] = []
    for seed in range(seeds):
        grey, y = clip(seed)
        printed = gain_and_bias(three(grey), albedo=brightness(three(grey)))
        corrected = solve(three(grey), None, RHO)
        ratio = y / y[0]
        off = (
            100 * float(np.abs(p.y[:, 0] / p.y[0, 0] / ratio - 1).max())
            for p in (printed, corrected)
        )
        found.append([255 * printed.bias[0], 255 * corrected.bias[0], *off])
    table = np.array(found)
    by, bc, ey, ec = (float(m) for m in np.median(table, 0))
    yield row(
        "equation (2), ρ as mean brightness: bias, true 12 of 255",
        f"{BIAS:.0f}",
        (by, bc),
        "of 255",
        why + f" (10 to 90 % of clips: {np.percentile(table[:, 0], 10):.1f} to"
        f" {np.percentile(table[:, 0], 90):.1f})",
    )
    yield row(
        "equation (2), ρ as mean brightness: largest error of the light's ratios",
        "0",
        (ey, ec),
        "%",
        why,
    )


def equation_4() -> Iterator[Item]:
    """Gain and bias as reciprocals."""
    for frames in (10, 40):
        grey, _ = clip(0, frames)
        b = {
            p: 255 * float(gain_and_bias(three(grey), RHO, printed_bias=p).bias[0])
            for p in (True, False)
        }
        corrected = 255 * float(solve(three(grey), None, RHO).bias[0])
        yield row(
            f"equation (4), b = 1/b', {frames} frames, true 12 of 255",
            f"{BIAS:.0f}",
            (b[True], corrected),
            "of 255",
            FREE,
        )
    yield row(
        "equation (4), b = b'/g', 40 frames, true 12 of 255",
        f"{BIAS:.0f}",
        (b[False], corrected),
        "of 255",
        tolerance=1e-6,
    )


def equations_5_6(seeds: int) -> Iterator[Item]:
    """The homogeneous system: solutions beside one another, and under noise."""
    grey, _ = clip(0)
    flat = RHO * np.full((25, 1), 120.0) + BIAS
    cases = {
        "equation (5), one patch, 25 frames": (grey[:, :1], RHO[:1]),
        "equation (5), four patches of one albedo, 25 frames": (grey[:, :4], RHO[:4]),
        "equation (6), ink and paper, 25 frames": (grey, RHO),
        "equation (6), ink and paper, one frame": (grey[:1], RHO),
        "equation (6), ink and paper, constant light": (flat / 255, RHO),
    }
    for item, (seen, rho) in cases.items():
        one = solve(three(seen), None, rho, tolerances=EXACT).verdict == MEASURED
        nullity = eq6_smallest_vector(seen, rho).nullity
        yield row(
            f"{item}: solutions",
            "1",
            (nullity, 1 if one else "refused"),
            "dimensions",
            "whatever the light does, a patch of one albedo cannot tell g, b and x apart."
            " Corrected: it is said, and b = 0 assumed",
        )
    exact = 255 * eq6_smallest_vector(grey, RHO).bias
    corrected = 255 * float(solve(three(grey), None, RHO).bias[0])
    yield row(
        "equation (6), bias without noise, true 12 of 255",
        f"{BIAS:.0f}",
        (exact, corrected),
        "of 255",
        tolerance=1e-6,
    )
    rho = np.linspace(0.45, 0.55, 8)
    found: dict[str, list[float]] = {"255": [], "1": [], "corrected": []}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        noisy = rho * rng.uniform(100, 200, (6, 1)) + BIAS + rng.normal(0, 2, (6, 8))
        found["255"].append(eq6_smallest_vector(noisy, rho).bias)
        found["1"].append(255 * eq6_smallest_vector(noisy / 255, rho).bias)
        solved = solve(three(noisy), None, rho, tolerances=EXACT)
        found["corrected"] += [float(solved.bias[0])] * (solved.verdict == MEASURED)
    b = {k: float(np.median(v)) for k, v in found.items()}
    for unit in ("255", "1"):
        yield row(
            "equation (6), bias with noise of 2, true 12 of 255, albedos .45 to .55, I up"
            f" to {unit}",
            f"{BIAS:.0f}",
            (b[unit], b["corrected"]),
            "of 255",
            "the noise is in the I column alone, so the vector is biased, and by the unit of"
            " I. Corrected: g = 1, robust least squares, refused in"
            f" {seeds - len(found['corrected'])} of {seeds} clips of 6 frames",
        )


def equation_7() -> Iterator[Item]:
    """The update of the map."""

    def seen(values: np.ndarray) -> np.ndarray:
        """(t, 2) printed and corrected map at a normal that shows these values (t,), one
        after the other.
        """
        printed, corrected, variance, out = LightMap(3, S_RAD), 0.0, np.inf, []
        at = int((printed.n @ UP).argmax())
        for x in values:
            printed.add(UP, np.full(3, x))
            variance += (DRIFT_PER_S * corrected) ** 2 / 30  # what it may have changed by
            gain = 1 - NOISE**2 / (NOISE**2 + variance)
            corrected, variance = corrected + gain * (x - corrected), gain * NOISE**2
            out.append((printed.M[at, 0], corrected))
        return np.array(out)

    last = tuple((seen(np.full(1000, 0.7))[-1] / 0.7).tolist())
    noisy = seen(0.7 + NOISE * np.random.default_rng(0).normal(size=400))
    yield row(
        "equation (7), constant light after 1,000 updates",
        "1",
        last,
        "of the light",
        tolerance=1e-6,
    )
    left = tuple(100 * float(s) / NOISE for s in np.std(noisy[50:], axis=0))
    yield row(
        "equation (7), noise of one normal that is left",
        "M ← (1 − f) M + f x",
        left,
        "%",
        "f = 1 at the normal itself: the newest reading replaces all older ones. Corrected:"
        " an update by precision",
    )
    newest = tuple(
        100 * float(np.mean(f(hemisphere(4) @ UP) >= 0.5))
        for f in (printed_weight, corrected_weight)
    )
    yield row(
        "section 2.2, normals that one frame renews by half or more",
        "one",
        newest,
        "% of the hemisphere",
        "as section 2.2 says, light that changes at once is not renewed at once; and (8)"
        " lacks its square: see there",
    )


def printed_weight(cosine: np.ndarray) -> np.ndarray:
    return eq8_weight(cosine, S_RAD)


def corrected_weight(cosine: np.ndarray) -> np.ndarray:
    return squared_weight(cosine, S_RAD)


def equation_8() -> Iterator[Item]:
    """The weight of a normal."""
    yield row("equation (8), s", "a blur constant", (S_RAD, S_RAD), "rad", NO_VALUE)
    for angle_deg in (0, 1, 5, 10, 20, 30):
        cosine = np.cos(np.radians([angle_deg]))
        f = tuple(weight(cosine)[0] for weight in (printed_weight, corrected_weight))
        yield row(
            f"equation (8), weight at {angle_deg} degrees",
            "exp(−θ / (2 s²))",
            f,
            "",
            "the square of a Gaussian is missing in print: the weight has a cusp at 0",
            abs(f[0] - f[1]) < 1e-6,
        )
    # nothing of the sphere is left out by cos(cos θ) > 0, half of it by cos θ > 0
    away = np.cos(np.radians([91.0, 120, 150, 180]))
    out = tuple(
        100 * float(np.mean(f == 0))
        for f in (eq8_weight(away, 2.0), corrected_weight(away))
    )
    yield row(
        "equation (8), condition cos(n·n') > 0: directions behind that it excludes",
        "all",
        out,
        "%",
        "the cosine of a cosine is never negative: the condition excludes nothing."
        " Corrected: n·n' > 0",
    )
    angles_deg = np.linspace(0, 40, 161)
    cosines = np.cos(np.radians(angles_deg))
    yield curves(
        "equation (8), weight at 10 degrees",
        "weight of a reading over the angle to its normal",
        (
            "angle between a normal and the one that was seen, degrees",
            f"weight, s = {S_RAD} rad",
        ),
        angles_deg,
        {"printed": printed_weight(cosines), "corrected": corrected_weight(cosines)},
    )


def lit(n: np.ndarray, lamps: np.ndarray, ambient: float) -> np.ndarray:
    """(k, 3) irradiance of lamps of strength 1 in directions (l, 3)."""
    return np.repeat((ambient + np.maximum(n @ lamps.T, 0).sum(1))[:, None], 3, 1)


def cap(span_deg: float, count: int, seed: int = 0) -> np.ndarray:
    """(count, 3) normals within span_deg of UP."""
    rng = np.random.default_rng(seed)
    z = 1 - rng.random(count) * (1 - np.cos(np.radians(span_deg)))
    phi = 2 * np.pi * rng.random(count)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def equation_9(seeds: int) -> Iterator[Item]:
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
    candidates, n = hemisphere(4), cap(75, 220)
    for apart_deg in (30, 60, 80):
        half = np.radians(apart_deg / 2)
        lamps = np.array(
            [[np.sin(half), 0, np.cos(half)], [-np.sin(half), 0, np.cos(half)]]
        )
        peaks = candidates[
            eq9_lights(lit(candidates, lamps, 0.2), candidates, 0.0, EPSILON_DEG)
        ]
        found = fit(n, lit(n, lamps, 0.2))
        fitted = np.array(
            [
                li.direction
                for li in found.lights
                if not li.dome and li.confidence_deg < 90
            ]
        ).reshape(-1, 3)
        what = f"equation (9), two equal lamps {apart_deg} degrees apart"
        yield row(
            f"{what}: lights", "2", (len(peaks), len(fitted) or "refused"), "", PEAKS
        )
        off = [off_deg(directions, lamps) for directions in (peaks, fitted)]
        yield row(
            f"{what}: direction off",
            "0",
            (off[0], "refused" if off[1] is None else off[1]),
            "degrees",
            PEAKS,
        )
    clips = [one_lamp(seed, params) for seed in range(seeds)]
    median = tuple(
        np.median([o for o in column if o is not None])
        for column in zip(*clips, strict=True)
    )
    yield row(
        "equation (9), one lamp with ambient light, median: direction off",
        "0",
        median,
        "degrees",
        PEAKS,
    )
    normals = normalise(np.random.default_rng(0).normal(size=(50, 3)))
    single = [
        lights_of([reading(normal, 0.6)], params)[0][0].lights for normal in normals
    ]
    claimed = [
        fit(np.repeat(normal[None], 20, 0), np.full((20, 3), 0.6)).verdict == MEASURED
        for normal in normals[:5]
    ]
    count = tuple((sum(map(len, single)), sum(claimed)))
    yield row(
        "equation (9), a marker at rest, 50 normals: lights",
        "at a peak",
        count,
        "",
        "from one normal no direction can be known: the peak is the normal itself."
        " Corrected: refused, another cue is taken",
    )
    five = np.concatenate(
        [UP[None], normalise(np.array([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1.0]]))]
    )
    kept = len(lights_of([reading(five, 0.6)], PrintedLightParams(peak=0.3))[0][0].lights)
    yield row(
        "equation (9), five peaks: lights",
        "5",
        (kept, LightParams().most_lights),
        "",
        "corrected: two lamps at most",
    )


def reading(n: np.ndarray, level: float) -> Observation:
    normals = np.atleast_2d(n)
    return Observation(
        normals, np.full(normals.shape, level), np.full(normals.shape, 1e-6)
    )


def off_deg(found: np.ndarray, lamps: np.ndarray) -> float | None:
    """Largest angle from a found direction to the nearest lamp; None where none is found."""
    if not len(found):
        return None
    return max(float(np.degrees(angle_between(d, lamps).min())) for d in found)


def one_lamp(seed: int, params: PrintedLightParams) -> tuple[float | None, float | None]:
    """Degrees off by the printed and the corrected method, None where nothing is claimed: a
    marker turned through 100 normals.
    """
    rng = np.random.default_rng(seed)
    tilt, azimuth = np.radians(rng.uniform(10, 45)), rng.uniform(0, 2 * np.pi)
    lamp = np.array(
        [[np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)]]
    )
    n = cap(75, 100, seed)
    x = lit(n, lamp, 0.4) * (1 + 0.005 * rng.normal(size=(100, 1)))
    lights = lights_of(
        [
            Observation(a[None], b[None], np.full((1, 3), 1e-5))
            for a, b in zip(n, x, strict=True)
        ],
        params,
    )
    found = fit(n, x, np.full(x.shape, 1e-5))
    return off_deg(lights[0][-1].lights[0].unit[None], lamp), off_deg(
        np.array([li.direction for li in found.lights[:1]]), lamp
    )
