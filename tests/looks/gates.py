"""What has to hold of a telephone's clips, measured on the facts: a fixed set of white and
of coloured surfaces under each frame's light, as the picture would store them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from arfx.analyse.job import Analysis
from arfx.core.colour import Transfer, yuv_from_rgb
from arfx.core.light import Light
from tests.calibrated import clips
from tests.calibrated.scenes import CASES
from tests.looks import film
from tests.looks.film import Look, Phone, dim, ramps, steps

ALBEDOS = np.array([[0.7, 0.7, 0.7], [0.55, 0.25, 0.2]])
NORMALS = 24  # over the half of the sphere that faces up from the desk
MOST_LUMA, MOST_CHROMA = 0.005, 0.5  # per frame: share; grey levels
MOST_BEHIND = 0.02  # of a change of the exposure
MOST_UNDER_HAND = 0.03  # coded luma
MOSTLY = 99  # percentile of a clip's frames
FADE_S = 0.15
HELD = 0.95
SHADED = LIT = 0.9  # share of the frames


class Finding(NamedTuple):
    """look : of which clip;  gate : what is measured;  value, most : it must not exceed"""

    look: str
    gate: str
    value: float
    most: float

    @property
    def holds(self) -> bool:
        return self.value <= self.most


@dataclass(frozen=True)
class Shown:
    """The surfaces in every frame. luma : (frames,) mean stored luma, grey levels;  chroma :
    (frames, 4) mean Cb, Cr of each albedo
    """

    luma: np.ndarray
    chroma: np.ndarray


def normals() -> np.ndarray:
    """(NORMALS, 3) unit, room axes."""
    k = np.arange(NORMALS) + 0.5
    z, turn = k / NORMALS, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def shown(
    lights: Sequence[Light], black: Sequence[np.ndarray], n: np.ndarray | None = None
) -> Shown:
    """black : (3,) of each frame;  n : (k, 3) normals, None = all"""
    n, encode = normals() if n is None else n, Transfer("srgb").encode
    light = np.array([one.radiance(n) for one in lights])
    linear = ALBEDOS[:, None] * light[:, None] + np.array(black)[:, None, None]
    stored = 255 * encode(np.clip(linear, 0, 1)) @ yuv_from_rgb("bt709").T
    mean = stored.mean(2)
    return Shown(mean[..., 0].mean(1), mean[..., 1:].reshape(len(mean), -1))


@dataclass(frozen=True)
class Seen:
    """A clip that was filmed and analysed. darkest : (3,) linear light of its darkest
    hundredth;  own, truth : what the facts' light shows, and the true one
    """

    look: Look
    analysis: Analysis
    darkest: np.ndarray
    own: Shown
    truth: Shown


def seen(look: Look) -> Seen:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clip.mp4"
        darkest = film.film(look, path)
        found = film.analysed(look, path)
    lit = [f for f in found.facts if f.light is not None]
    truth = film.true_lights(look, of_object=True)
    own = shown(
        [f.light for f in lit if f.light], [np.array(f.bias_rgb) for f in lit]
    )
    exact = shown(
        [truth[f.index] for f in lit], [np.array(look.phone.black)] * len(lit)
    )
    return Seen(look, found, darkest, own, exact)


def luma_flicker(s: Seen) -> Finding:
    off = np.abs(np.diff(np.log(s.own.luma)) - np.diff(np.log(s.truth.luma)))
    return Finding(s.look.name, "luma, share a frame", _mostly(off), MOST_LUMA)


def chroma_flicker(s: Seen) -> Finding:
    off = np.abs(np.diff(s.own.chroma, axis=0) - np.diff(s.truth.chroma, axis=0))
    return Finding(
        s.look.name, "chroma, levels a frame", _mostly(off.max(1)), MOST_CHROMA
    )


def behind(s: Seen) -> Finding:
    """How far luma is from the truth of the frame, the one before and the one after, and
    all between them.
    """
    ratio = np.log(s.truth.luma)
    scale = np.median(np.log(s.own.luma) - ratio)
    near = np.stack([ratio[:-2], ratio[1:-1], ratio[2:]]) + scale
    own = np.log(s.own.luma)[1:-1]
    off = np.maximum(own - near.max(0), near.min(0) - own).clip(0)
    return Finding(
        s.look.name, "luma behind the exposure", float(off.max()), MOST_BEHIND
    )


def tint(s: Seen) -> Finding:
    """Chroma against the picture's, both over their means."""
    off = (s.own.chroma - s.own.chroma.mean(0)) - (
        s.truth.chroma - s.truth.chroma.mean(0)
    )
    return Finding(
        s.look.name, "chroma behind the picture", _mostly(np.abs(off).max(1)), 2.0
    )


def darkened(s: Seen) -> Finding:
    """Luma against the truth, by which a hand's shadow shows: of the object, or where it lies
    on the print that the object stands on of what faces up as the plane does.
    """
    up = np.array([[0.0, 0, 1]]) if s.look.hand == 0 else None
    lit = [f for f in s.analysis.facts if f.light is not None]
    own = shown([f.light for f in lit if f.light], [np.zeros(3)] * len(lit), up).luma
    true = film.true_lights(s.look, of_object=True)
    exact = shown([true[f.index] for f in lit], [np.zeros(3)] * len(lit), up).luma
    off = np.log(own) - np.log(exact)
    near = np.stack([off[:-2], off[1:-1], off[2:]]) - np.median(off)
    least = np.abs(near).min(0)
    return Finding(
        s.look.name, "luma under a hand", float(least.max()), MOST_UNDER_HAND
    )


def black(s: Seen) -> Finding:
    """Above the clip's darkest hundredth, linear light, in the worst channel."""
    bias = np.array([f.bias_rgb for f in s.analysis.facts])
    return Finding(
        s.look.name, "black level too high", float((bias - s.darkest).max()), 0.0
    )


def half_lit(s: Seen) -> Finding:
    """Share of the frames under the hand in which the print's shadow is not told."""
    under = film.hand(s.look) > 0.9
    told = [f.plane_shadow is not None for f in s.analysis.facts]
    missed = 1 - float(np.mean(np.array(told)[under]))
    return Finding(s.look.name, "half in shadow, not told", missed, 1 - SHADED)


def not_half(s: Seen) -> Finding:
    """Share of the frames under a hand that covers all of the print, as a darker room would,
    in which a part is taken for lit.
    """
    told = [f.plane_shadow is not None for f in s.analysis.facts]
    under = np.array(told)[film.hand(s.look) > 0.9]
    return Finding(
        s.look.name, "dark, taken for half in shadow", float(under.mean()), 0.1
    )


def edge(s: Seen) -> Finding:
    """Degrees by which the true lamp is outside of what a shadow's edge says of its side."""
    clue = s.analysis.summary["light"]["shadow_edge"]
    lamp = film.true_lights(s.look, of_object=False)[0].lights[0].unit
    true_deg = np.degrees(np.arctan2(lamp[1], lamp[0]))
    off = 180.0
    if clue is not None:
        off = (
            abs((clue["azimuth_deg"] - true_deg + 180) % 360 - 180)
            - clue["within_deg"]
        )
    return Finding(
        s.look.name, "lamp's side by the shadow's edge", max(off, 0.0), 0.0
    )


def not_shaded(s: Seen) -> Finding:
    told = [f.plane_shadow is not None for f in s.analysis.facts]
    return Finding(s.look.name, "taken for a shadow", float(np.mean(told)), 1 - LIT)


def fading(s: Seen) -> Finding:
    """Seconds of the longer of the two fades around an absence, beyond FADE_S by a frame."""
    opacity = np.array([f.opacity for f in s.analysis.facts])
    partly = np.flatnonzero((opacity > 0) & (opacity < 1))
    runs = np.split(partly, np.flatnonzero(np.diff(partly) > 1) + 1)
    longest = max((len(r) for r in runs), default=0) + 1
    off = abs(longest / s.look.fps - FADE_S)
    return Finding(s.look.name, f"fading, seconds off {FADE_S}", off, 1 / s.look.fps)


def _mostly(values: np.ndarray) -> float:
    return float(np.percentile(values, MOSTLY))


Measure = Callable[[Seen], Finding]
STEADY: tuple[Measure, ...] = (luma_flicker, chroma_flicker, black)
SIX: dict[str, Any] = {"prints": 6, "side_m": 0.05, "distance_m": 0.45}
TILTED: dict[str, Any] = SIX | {"tilt_deg": 40.0, "side_m": 0.055}
HUNTING = Phone(hunting=0.03, rolling_s=0.02)
SMALL: dict[str, Any] = {"prints": 6, "side_m": 0.022, "distance_m": 0.45}
DIM: dict[str, Any] = SMALL | {"side_m": 0.028}
PURPLE, BLUE = (0.06, 0.03, 0.09), (0.05, 0.08, 0.25)
LOOKS: tuple[tuple[Look, tuple[Measure, ...]], ...] = (
    (Look("constant, one print"), (*STEADY, not_shaded)),
    (Look("constant, six prints", **SIX), STEADY),
    (Look("constant, six tilted prints", **TILTED), STEADY),
    (Look("small print", side_m=0.025), STEADY),
    (Look("noise of 4 levels", Phone(noise_grey=4.0)), STEADY),
    (Look("sharpened", Phone(halo=0.8)), STEADY),
    (Look("sharpened, tilted prints", Phone(halo=0.8), **TILTED), STEADY),
    (Look("black level .02", Phone(black=(0.02, 0.02, 0.02))), STEADY),
    (Look("purple ink", ink=PURPLE), STEADY),
    (Look("purple ink, glossy, tilted", ink=PURPLE, gloss=0.1, **TILTED), STEADY),
    (Look("blue ink", ink=BLUE), STEADY),
    (Look("glossy", gloss=0.1), STEADY),
    (Look("six small prints", **SMALL), STEADY),
    (Look("dim, six small prints", Phone(dim, noise_grey=2.0), **SMALL), STEADY),
    (
        Look("dim, glossy, small", Phone(dim, noise_grey=1.5), gloss=0.2, **DIM),
        STEADY,
    ),
    (
        Look("dim, blue ink, small", Phone(dim, noise_grey=2.0), ink=BLUE, **SMALL),
        STEADY,
    ),
    (Look("ramps of 1 stop/s", Phone(ramps, rolling_s=0.02)), (behind, black)),
    (
        Look("ramps, tilted prints", Phone(ramps, rolling_s=0.02), **TILTED),
        (behind, black),
    ),
    (Look("steps of 20 %", Phone(steps)), (behind, not_shaded)),
    (Look("steps, tilted prints", Phone(steps), **TILTED), (behind, not_shaded)),
    (Look("white balance hunts", HUNTING), (tint, luma_flicker)),
    (Look("white balance hunts, tilted", HUNTING, **TILTED), (tint, luma_flicker)),
    (Look("hand over one of six", hand=2, **SIX), (darkened,)),
    (Look("hand over one of six tilted", hand=2, **TILTED), (darkened,)),
    (Look("hand over its own print", hand=0), (darkened, not_half)),
    (Look("hand over its own, of six", hand=0, **SIX), (darkened,)),
    (
        Look("hand over half the print", hand=0, hand_at_m=(0.05, 0.0)),
        (half_lit, darkened, edge),
    ),
    (
        Look("print covered, 60 fps", fps=60.0, frames=90, hidden_s=(0.3, 1.2)),
        (fading,),
    ),
)


def findings(look: Look, measures: Sequence[Measure]) -> list[Finding]:
    s = seen(look)
    return [measure(s) for measure in measures]


def cones(clips_each: int) -> Finding:
    """Stated cones that do not hold a true lamp, of random readings of two lamps."""
    asked = [
        (clips.READINGS, i, seed)
        for i, case in enumerate(CASES)
        if case.lamps == 2
        for seed in range(min(case.clips, clips_each))
    ]
    claims = [c for one in asked for c in clips.row(one).claims]
    missed = float(np.mean([not c.held for c in claims])) if claims else 1.0
    return Finding(
        f"two lamps, {len(asked)} clips", "cones that miss", missed, 1 - HELD
    )
