"""Rows of Tan, Chen, Sun 2009 that take no picture: equations (1), (2) and (4) to (9), on
readings made here.
"""

import numpy as np
from numpy import ndarray

from arfx.analyse.light.fit import fit
from arfx.analyse.light.hypotheses import MEASURED
from arfx.analyse.light.patches import WHITE
from arfx.analyse.light.photometry import EXACT, INK, PAPER, Photometry, solve
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import angle_between, direction_of, normalise
from arfx.papers.s1_gain import brightness, eq6_smallest_vector, gain_and_bias
from arfx.papers.s1_light import (
    LightMap,
    eq8_weight,
    eq9_lights,
    hemisphere,
    squared_weight,
)
from arfx.papers.s1_lightmap import phong
from arfx.reproduce.rows import Items, row
from arfx.reproduce.work import Work

BIAS = 12.0  # of 255, in all clips of this module
NOISE = 0.05  # of readings
S_RAD, EPSILON_DEG = 0.2, 30.0  # s of (8), epsilon of (9): the paper has no values
APART_DEG = 60  # two lamps
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


def rows(work: Work) -> Items:
    yield from equation_1()
    yield from equation_2(work.scaled(60, 10))
    yield from equation_4()
    yield from equations_5_6()
    yield from equation_7()
    yield from equation_8()
    yield from equation_9()
    mirrored = phong(
        UP[None], np.array([[-0.6, 0, 0.8]]), np.array([0.6, 0, 0.8]), np.array([0.3])
    )
    yield row(
        "section 2.3, Phong's highlight in the mirrored direction",
        "brightest",
        mirrored[0],
        "",
        "",
        abs(mirrored[0] - 1) < 1e-9,
    )


def equation_1() -> Items:
    """Light of a surface."""
    d = normalise(np.array([[0.5, 0.2, 0.8], [-0.6, 0.1, 0.7]]))
    omega = np.array([[0.6, 0.5, 0.4], [0.2, 0.3, 0.4]])
    n = np.concatenate([hemisphere(3), -hemisphere(3)])
    lamps = (
        DirectionalLight(triple(a), triple(b)) for a, b in zip(d, omega, strict=True)
    )
    seen = Light((0.0,) * 3, tuple(lamps)).radiance(n)
    off = np.abs(seen - np.maximum(n @ d.T, 0) @ omega).max()
    yield row(
        "equation (1), two lights: largest difference from the sum",
        "x = Σ max(n·d, 0) Ω",
        (off, off),
        "",
        "",
        below=1e-12,
    )


def clip(seed: int, frames: int = 25) -> tuple[ndarray, ndarray]:
    """(grey (t, 8) of ink and paper, 0..1, light (t,) of 255), without noise."""
    y = np.random.default_rng(seed).uniform(60, 230, frames)
    return (RHO * y[:, None] + BIAS) / 255, y


def three(grey: ndarray) -> ndarray:
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
    grey = three(clip(0, 40)[0])
    corrected = bias_of(solve(grey, None, RHO))
    for words, as_printed, tolerance in (
        ("b = 1/b'", True, None),
        ("b = b'/g'", False, 1e-6),
    ):
        found = gain_and_bias(grey, RHO, printed_bias=as_printed)
        yield row(
            f"equation (4), {words}, 40 frames, true 12 of 255",
            "12",
            (bias_of(found), corrected),
            "of 255",
            FREE,
            tolerance=tolerance,
        )


def equations_5_6() -> Items:
    """The homogeneous system: its solutions."""
    grey, _ = clip(0)
    for item, patches in (
        ("equation (5), one patch", 1),
        ("equation (6), ink and paper", 8),
    ):
        seen, rho = grey[:, :patches], RHO[:patches]
        one = solve(three(seen), None, rho, tolerances=EXACT).verdict == MEASURED
        yield row(
            f"{item}, 25 frames: solutions",
            "1",
            (eq6_smallest_vector(seen, rho).nullity, 1 if one else "refused"),
            "dimensions",
            "whatever the light does, a patch of one albedo cannot tell g, b and x apart."
            " Corrected: it is said, and b = 0 assumed",
        )


def equation_7() -> Items:
    """The update of the map, at a normal that is shown again and again."""
    map_ = LightMap(3, S_RAD)
    middle = (map_.n @ UP).argmax()
    seen = []
    for x in 0.7 + NOISE * np.random.default_rng(0).normal(size=400):
        map_.add(UP, np.full(3, x))
        seen.append(map_.M[middle, 0])
    yield row(
        "equation (7), noise of one normal that is left",
        "M ← (1 − f) M + f x",
        100 * np.std(seen[50:]) / NOISE,
        "%",
        "f = 1 at the normal itself: the newest reading replaces all older ones. Corrected:"
        " all readings are weighed together",
    )
    yield row(
        "section 2.2, normals that one frame renews by half or more",
        "one",
        [100 * np.mean(f >= 0.5) for f in weights(hemisphere(4) @ UP)],
        "% of the hemisphere",
        "as section 2.2 says, light that changes at once is not renewed at once; and (8)"
        " lacks its square: see there",
    )


def weights(cosine: ndarray) -> tuple[ndarray, ndarray]:
    """(8) as printed, and corrected."""
    return eq8_weight(cosine, S_RAD), squared_weight(cosine, S_RAD)


def equation_8() -> Items:
    """The weight of a normal."""
    yield row(
        "equation (8), weight at 10 degrees",
        "exp(−θ / (2 s²))",
        [f[0] for f in weights(np.cos(np.radians([10])))],
        "",
        "the square of a Gaussian is missing in print: the weight has a cusp at 0",
    )
    # nothing of the sphere is left out by cos(cos θ) > 0, half of it by cos θ > 0
    away = np.cos(np.radians([91.0, 120, 150, 180]))
    yield row(
        "equation (8), condition cos(n·n') > 0: directions behind that it excludes",
        "all",
        [
            100 * np.mean(f == 0)
            for f in (eq8_weight(away, 2.0), squared_weight(away, S_RAD))
        ],
        "%",
        "the cosine of a cosine is never negative: the condition excludes nothing."
        " Corrected: n·n' > 0",
    )


def lit(n: ndarray, lamps: ndarray) -> ndarray:
    """(k, 3) irradiance of lamps of strength 1 in directions (l, 3), and even light."""
    return np.repeat((0.2 + np.maximum(n @ lamps.T, 0).sum(1))[:, None], 3, 1)


def cap(count: int) -> ndarray:
    """(count, 3) normals within 75 degrees of UP."""
    rng = np.random.default_rng(0)
    z = 1 - rng.random(count) * (1 - np.cos(np.radians(75)))
    return direction_of(2 * np.pi * rng.random(count), np.arcsin(z))


def equation_9() -> Items:
    """Lights at the peaks of the map."""
    candidates = hemisphere(4)
    n = cap(220)
    half = np.radians(APART_DEG / 2)
    lamps = np.array([[s * np.sin(half), 0, np.cos(half)] for s in (1, -1)])
    peaks = candidates[
        eq9_lights(lit(candidates, lamps), candidates, 0.0, EPSILON_DEG)
    ]
    fitted = [
        li.direction
        for li in fit(n, lit(n, lamps)).lights
        if not li.dome and li.confidence_deg < 90
    ]
    found = peaks, np.array(fitted)
    what = f"equation (9), two equal lamps {APART_DEG} degrees apart"
    yield row(
        f"{what}: lights", "2", [len(own) or "refused" for own in found], "", PEAKS
    )
    yield row(
        f"{what}: direction off",
        "0",
        [off_deg(own, lamps) if len(own) else "refused" for own in found],
        "degrees",
        PEAKS,
    )


def off_deg(found: ndarray, lamps: ndarray) -> float:
    """Largest angle from a found direction (k, 3) to the nearest lamp."""
    return max(float(np.degrees(angle_between(d, lamps).min())) for d in found)
