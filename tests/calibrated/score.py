"""What was claimed, against the truth: rows of clips, their table, the goals, the plot."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from arfx.analyse.job import Analysis
from tests.calibrated.scenes import Clip

REFUSED, MEASURED, LIKELY = "refused", "measured", "likely"
FALSE_DEG, FALSE_CONES, MOST_OFF_DEG = (
    3.0,
    3.0,
    90.0,
)  # a claim is false that is farther off than both, or than the third
LEAST_LIGHT = 0.05  # of a frame's mean light: less is no claim
MOSTLY = 75  # percentile of a claim's frames


@dataclass(frozen=True)
class Claim:
    """A direction that is used in frames.
    error_deg : from the nearest lamp or the middle of the sky's brighter side, 180 = there is none
    mean_deg : from the lamps' mean direction, by their brightness: what looks like one lamp
    where all normals face both
    far_deg : from the farthest lamp;  alone : no other direction is claimed beside it"""

    verdict: str
    error_deg: float
    mean_deg: float
    far_deg: float
    alone: bool
    cone_deg: float
    frames: int

    @property
    def off_deg(self) -> float:
        """What the cone has to hold: the nearest true lamp."""
        return self.error_deg

    @property
    def held(self) -> bool:
        return self.off_deg <= self.cone_deg

    @property
    def false(self) -> bool:
        return self.off_deg > min(
            max(FALSE_DEG, FALSE_CONES * self.cone_deg), MOST_OFF_DEG
        )


@dataclass(frozen=True)
class Row:
    """One clip. alone_deg : error where one lamp is said to be all there is, None = not
    asked or refused
    """

    part: str
    case: str
    seed: int
    lamps: int
    owed: bool
    never: bool
    verdict: str
    reason: str
    claims: tuple[Claim, ...]
    alone_deg: float | None
    seconds: float

    @property
    def main(self) -> Claim | None:
        """The claim of most frames."""
        return max(self.claims, key=lambda c: c.frames, default=None)


def to_json(row: Row) -> dict[str, Any]:
    return asdict(row)


def from_json(tree: dict[str, Any]) -> Row:
    return Row(**(tree | {"claims": tuple(Claim(**c) for c in tree["claims"])}))


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def claims_of(clip: Clip, found: Analysis) -> list[Claim]:
    """Lights of all frames, those of one direction and verdict together."""
    report = found.summary["light"]
    groups: dict[tuple[Any, ...], list[tuple[float, float, float]]] = {}
    first_s = found.facts[0].time_s
    for f in found.facts:
        if (
            f.light is None
            or f.camera_from_world is None
            or f.light.source not in ("marker", "markers")
        ):
            continue
        verdict = _verdict_at(report, f.time_s)
        total = float(np.mean(f.light.mean_radiance))
        rest = f.camera_from_world.rotation if clip.camera_rests else np.eye(3)
        frame = min(
            round((f.time_s - first_s) / (clip.times_s[1] - clip.times_s[0])),
            len(clip.times_s) - 1,
        )
        lamps = [lamp for lamp in clip.lamps if lamp.on[frame] > 0]
        weight = np.array([lamp.rgb.mean() for lamp in lamps])
        mean = sum(
            (w * lamp.direction for w, lamp in zip(weight, lamps, strict=True)),
            np.zeros(3),
        )
        truths = [
            *(lamp.direction for lamp in lamps),
            *([] if clip.bright_side is None else [clip.bright_side]),
        ]
        used = [
            li
            for li in f.light.lights
            if np.mean(li.rgb) / 4 >= LEAST_LIGHT * total and li.confidence_deg < 180
        ]
        for i, li in enumerate(used):
            d = rest @ li.unit
            off = [angle_deg(d, truth) for truth in truths] or [180.0]
            of_mean = angle_deg(d, mean) if lamps and len(used) == 1 else min(off)
            far = max(off[: len(lamps)], default=180.0)
            key = (
                verdict,
                i,
                len(used) == 1,
                round(li.confidence_deg, 3),
                *np.round(100 * d).astype(int).tolist(),
            )
            groups.setdefault(key, []).append((min(off), of_mean, far))
    return [
        Claim(
            key[0],
            *(float(v) for v in np.percentile(rows, MOSTLY, axis=0)),
            key[2],
            float(key[3]),
            len(rows),
        )
        for key, rows in groups.items()
        if len(rows) > 1
    ]


def _verdict_at(report: dict[str, Any], time_s: float) -> str:
    for span in report.get("spans") or ():
        if span["start_s"] <= time_s <= span["end_s"]:
            return str(span["verdict"])
    return str(report["verdict"])


@dataclass(frozen=True)
class Goal:
    name: str
    found: str
    holds: bool


def goals(rows: Sequence[Row]) -> list[Goal]:
    """What has to hold of the rows that there are."""
    false = [r for r in rows if any(c.false for c in r.claims)]
    out = [
        Goal(
            "false confidences: none",
            f"{len(false)} of {len(rows)} clips{_named(false)}",
            not false,
        )
    ]
    inside = [c for r in rows if r.lamps for c in r.claims]
    if inside:
        shares = {
            v: [c.held for c in inside if c.verdict == v] for v in (MEASURED, LIKELY)
        }
        text = ", ".join(
            f"{v} {np.mean(held):.1%} of {len(held)}"
            for v, held in shares.items()
            if held
        )
        out.append(
            Goal(
                "stated cones hold the nearest lamp in 95 of 100",
                text,
                np.mean([c.held for c in inside]) >= 0.95,
            )
        )
    owed = [r for r in rows if r.owed]
    if owed:
        claimed = [r for r in owed if r.main is not None]
        share = len(claimed) / len(owed)
        out.append(
            Goal(
                "owed directions claimed in 95 % or more",
                f"{len(claimed)} of {len(owed)}",
                share >= 0.95,
            )
        )
        if errors := [r.main.off_deg for r in claimed if r.main]:
            middle = float(np.median(errors))
            out.append(
                Goal(
                    "owed directions: median error 1° at most",
                    f"{middle:.2f}°",
                    middle <= 1,
                )
            )
        beyond = [
            r
            for r in claimed
            if any(c.off_deg > FALSE_CONES * c.cone_deg for c in r.claims)
        ]
        out.append(
            Goal(
                "owed directions: none beyond three cones",
                f"{len(beyond)}{_named(beyond)}",
                not beyond,
            )
        )
    never = [r for r in rows if r.never]
    if never:
        wrong = [r for r in never if r.claims or r.verdict != REFUSED]
        text = f"{len(never) - len(wrong)} of {len(never)}{_named(wrong)}"
        out.append(
            Goal("one print at rest, and no lamp, always refused", text, not wrong)
        )
    return out


def _named(rows: Sequence[Row]) -> str:
    return "".join(f"; {r.part}: {r.case} {r.seed}" for r in rows[:8])


HEAD = ("case", "clips", "measured", "likely", "refused", "error median", "90 %", "cone median", "held", "false",
        "refused, one lamp within 1°")  # fmt: skip


def table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """A line of each case, then of all clips that were fed alike."""
    lines = [
        _line(case, [r for r in rows if r.case == case])
        for case in dict.fromkeys(r.case for r in rows)
    ]
    parts = dict.fromkeys(r.part for r in rows)
    return [
        *lines,
        *(
            _line(f"all, {part}", [r for r in rows if r.part == part])
            for part in parts
        ),
    ]


def _line(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    main = [r.main for r in rows if r.main is not None]
    every = [c for r in rows for c in r.claims]
    missed = sum(
        r.main is None and r.alone_deg is not None and r.alone_deg <= 1 for r in rows
    )
    numbers = (
        f"{np.median([c.off_deg for c in main]):.2f}°", f"{np.percentile([c.off_deg for c in main], 90):.2f}°",
        f"{np.median([c.cone_deg for c in main]):.2f}°", f"{sum(c.held for c in every)} of {len(every)}",
    ) if main else ("", "", "", "")  # fmt: skip
    verdicts = [r.main.verdict if r.main is not None else REFUSED for r in rows]
    false = sum(any(c.false for c in r.claims) for r in rows)
    counts = (str(verdicts.count(v)) for v in (MEASURED, LIKELY, REFUSED))
    return name, str(len(rows)), *counts, *numbers, str(false), str(missed)


def pairs(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Where two lamps are lit and one direction is claimed: verdict, claims, how many cones
    hold their mean, one, both.
    """
    out = []
    for verdict in (MEASURED, LIKELY):
        mine = [
            c
            for r in rows
            if r.lamps == 2
            for c in r.claims
            if c.alone and c.verdict == verdict
        ]
        inside = [
            [at <= c.cone_deg for at in (c.mean_deg, c.error_deg, c.far_deg)]
            for c in mine
        ]
        out.append(
            (
                verdict,
                str(len(mine)),
                *(str(n) for n in np.sum(inside, 0, dtype=int).tolist() or [0, 0, 0]),
            )
        )
    return out


def markdown(rows: Sequence[Row]) -> str:
    """All that was found, as tables."""
    of_pairs = (
        "two lamps, one direction claimed",
        "claims",
        "cone holds the lamps' mean",
        "a lamp",
        "both lamps",
    )
    held = [(g.name, g.found, "holds" if g.holds else "missed") for g in goals(rows)]
    return "\n".join(
        (
            _lines(HEAD, table(rows)),
            _lines(of_pairs, pairs(rows)),
            _lines(("goal", "found", ""), held),
        )
    )


def _lines(head: tuple[str, ...], lines: Sequence[tuple[str, ...]]) -> str:
    return (
        "\n".join(
            f"| {' | '.join(line)} |" for line in (head, ("---",) * len(head), *lines)
        )
        + "\n"
    )


def plot(rows: Sequence[Row]) -> bytes:
    """Error against stated cone, both logarithmic; left one lamp, right two. PNG bytes."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(11, 5), layout="constrained")
    colours = {MEASURED: "#2f81f7", LIKELY: "#d9822b"}
    for axis, many, title in zip(
        fig.subplots(1, 2, sharex=True, sharey=True),
        (False, True),
        ("one lamp or none", "two lamps"),
        strict=True,
    ):
        for part, sign in (("readings", "o"), ("pixels", "s")):
            for verdict, colour in colours.items():
                mine = [
                    c
                    for r in rows
                    if r.part == part and (r.lamps > 1) == many
                    for c in r.claims
                    if c.verdict == verdict
                ]
                if mine:
                    error = [max(c.off_deg, 0.01) for c in mine]
                    axis.loglog([c.cone_deg for c in mine], error, sign, ms=4, alpha=0.7, mew=0, color=colour,
                                label=f"{verdict}, {part}: {len(mine)}")  # fmt: skip
        x = np.geomspace(0.3, 60.0, 50)
        axis.plot(x, x, "-", color="#8b949e", lw=0.8)
        axis.plot(
            x,
            np.clip(FALSE_CONES * x, FALSE_DEG, MOST_OFF_DEG),
            "--",
            color="#cf222e",
            lw=0.8,
        )
        axis.set_title(title, fontsize=9, loc="left")
        axis.set_xlabel("stated 95 % cone, degrees")
        if axis.lines[:-2]:
            axis.legend(fontsize=7, frameon=False)
    fig.axes[0].set_ylabel("error, degrees")
    fig.suptitle("grey: error = cone; red: above it a claim is false", fontsize=8)
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=110)
    return out.getvalue()
