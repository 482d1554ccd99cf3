"""How two states of one job of `tools/freeze.py` differ: pictures, times, streams, facts,
plans, reports, text.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np

POSE_TOLERANCE = 1e-6  # radians and metres
LIGHT_TOLERANCE = 1e-4
PREDICTED_TOLERANCE = 0.03
PAPER_TOLERANCE = 1e-6
MEAN_LEVELS = 0.1  # of touched samples
LARGE_LEVELS = 1
LARGE_FRACTION = 0.001

# Places whose numbers depend on the moment or the machine: not compared.
_TIMES = re.compile(
    r"timing|measured_s|wall_s|prepare_s|encode_s|render_s|analyse_s|decode_s|plan_s|frames_per_s|rss|report\.version"
    r"|bytes|machine|cores|jobs\[\*\]\.seconds|rows\[\*\]\.(reason|seconds)|workers\[\*\]"
    # from a speed that the job measures
    r"|predicted\.(wall|share|phases\.(before|decode|prepare|edit|encode))"
)
_PREDICTED = re.compile(r"predict|between|\.seconds$|_s$")
_LIGHT = re.compile(r"light|bias|environment|ambient|gain|rgb|photometry")
_PAPER = re.compile(r"paper_formula")


@dataclass(frozen=True)
class Difference:
    """where : the place, list numbers as [*];  what : how much, in how many values, an example"""

    where: str
    what: str


def tolerance_of(where: str) -> tuple[float, float]:
    """(absolute, relative) tolerance of the numbers at a place."""
    if _PAPER.search(where):
        return PAPER_TOLERANCE, PAPER_TOLERANCE
    if _PREDICTED.search(where):
        return 1e-9, PREDICTED_TOLERANCE
    if _LIGHT.search(where):
        return LIGHT_TOLERANCE, LIGHT_TOLERANCE
    return POSE_TOLERANCE, POSE_TOLERANCE


def _leaves(value: Any, where: str) -> Iterator[tuple[str, Any]]:
    """(place with numbers, value) of everything in a JSON document."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{where}.{key}")
    elif isinstance(value, list):
        yield f"{where}.length", len(value)
        for number, item in enumerate(value):
            yield from _leaves(item, f"{where}[{number}]")
    else:
        yield where, value


def _apart(where: str, a: Any, b: Any) -> float | None:
    """By how much two values differ, None if they count as equal; inf where that has no amount."""
    numbers = (int, float)
    if (
        isinstance(a, numbers)
        and isinstance(b, numbers)
        and not isinstance(a, bool)
        and not isinstance(b, bool)
    ):
        if a == b or (a != a and b != b):
            return None
        absolute, relative = tolerance_of(where)
        apart = abs(a - b)
        if isinstance(a, int) and isinstance(b, int) and not _PREDICTED.search(where):
            return float(apart)
        return (
            None
            if apart <= absolute + relative * max(abs(a), abs(b))
            else float(apart)
        )
    return None if a == b else float("inf")


def compare_documents(a: Any, b: Any, name: str) -> list[Difference]:
    """Differences of two JSON documents, one row for each place whatever its list numbers."""
    old, new = dict(_leaves(a, name)), dict(_leaves(b, name))
    rows: dict[str, list[tuple[float, str]]] = {}
    for where in old.keys() | new.keys():
        general = re.sub(r"\[\d+\]", "[*]", where)
        if _TIMES.search(general):
            continue
        if where not in old or where not in new:
            rows.setdefault(general, []).append(
                (float("inf"), f"only in the {'old' if where in old else 'new'}")
            )
            continue
        apart = _apart(general, old[where], new[where])
        if apart is not None:
            rows.setdefault(general, []).append(
                (apart, f"{old[where]!r:.80} and {new[where]!r:.80}")
            )
    out = []
    for where, found in sorted(rows.items()):
        most, example = max(found)
        amount = "" if most == float("inf") else f"up to {most:.3g}, "
        out.append(Difference(where, f"{amount}{len(found)} values, {example}"))
    return out


def _samples(frame: av.VideoFrame) -> list[np.ndarray]:
    """The planes of a frame as stored, without padding."""
    kind = (
        np.uint8 if max(c.bits for c in frame.format.components) <= 8 else np.uint16
    )
    out = []
    for plane in frame.planes:
        rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
        row = plane.width * np.dtype(kind).itemsize
        whole = row * (plane.line_size // row) if len(frame.planes) == 1 else row
        out.append(rows[:, :whole].reshape(-1).view(kind).reshape(plane.height, -1))
    return out


def _frames(path: Path) -> Iterator[av.VideoFrame]:
    with av.open(str(path)) as container:
        yield from container.decode(video=0)


def _streams(path: Path) -> dict[str, Any]:
    """Streams, tags and audio packets of a file."""
    out: dict[str, Any] = {"streams": []}
    with av.open(str(path)) as container:
        out["tags"] = {
            k: v for k, v in container.metadata.items() if k.upper() != "ENCODER"
        }
        for s in container.streams:
            tags = {
                k: v
                for k, v in s.metadata.items()
                if k.upper() not in ("ENCODER", "DURATION")
            }
            out["streams"].append(
                {"kind": s.type, "codec": s.codec_context.name, "tags": tags}
            )
        audio = [s for s in container.streams if s.type == "audio"]
        out["audio"] = (
            [[p.pts, hash(bytes(p))] for p in container.demux(audio) if p.size]
            if audio
            else []
        )
    return out


def compare_pictures(
    old: Path, new: Path, source: Path | None, rectangles: list[list[int]] | None
) -> list[Difference]:
    """Differences of two losslessly coded clips.

    source : the clip they were made from, whose first frames are theirs; None = every
    sample counts as touched
    rectangles : of every frame, x0 y0 x1 y1 outside of which the old one left the source alone
    """
    touched = large = count = outside = 0
    total = 0.0
    most, worst, frames = 0, -1, 0
    apart_s: list[float] = []
    sources: Iterator[av.VideoFrame | None] = (
        _frames(source) if source else itertools.repeat(None)
    )
    for number, (a, b, s) in enumerate(
        itertools.zip_longest(_frames(old), _frames(new), _until(sources, old))
    ):
        if a is None or b is None:
            return [Difference("frames", f"one ends after {number}")]
        frames += 1
        if a.format.name != b.format.name or (a.width, a.height) != (
            b.width,
            b.height,
        ):
            return [Difference("format", f"{a} and {b}")]
        apart_s += [abs(a.time - b.time)] if a.time != b.time else []
        given = (
            _samples(s) if s is not None and s.format.name == a.format.name else None
        )
        for k, (p, q) in enumerate(zip(_samples(a), _samples(b), strict=True)):
            d = np.abs(p.astype(np.int32) - q)
            where = (
                np.ones(p.shape, bool)
                if given is None
                else (p != given[k]) | (q != given[k])
            )
            touched += int(where.sum())
            total += float(d[where].sum())
            large += int((d > LARGE_LEVELS).sum())
            count += int((d > 0).sum())
            if int(d.max()) > most:
                most, worst = int(d.max()), number
            if k == 0 and given is not None and rectangles is not None:
                x0, y0, x1, y1 = (
                    rectangles[number] if number < len(rectangles) else (0, 0, 0, 0)
                )
                changed = d > 0
                changed[y0:y1, x0:x1] = False
                outside += int(changed.sum())
    out = []
    if apart_s:
        out.append(
            Difference(
                "times",
                f"{len(apart_s)} of {frames} frames, up to {max(apart_s):.6f} s",
            )
        )
    if outside:
        out.append(
            Difference(
                "pixels.untouched", f"{outside} differ where nothing is changed"
            )
        )
    mean = total / max(touched, 1)
    if mean > MEAN_LEVELS or large > LARGE_FRACTION * touched:
        what = (
            f"mean {mean:.3f} of {touched} touched, {count} differ, {large} by more than"
            f" {LARGE_LEVELS}"
        )
        out.append(
            Difference("pixels.touched", f"{what}, up to {most} in frame {worst}")
        )
    return out


def _until(
    sources: Iterator[av.VideoFrame | None], old: Path
) -> Iterator[av.VideoFrame | None]:
    """As many frames of the source as the old output has."""
    with av.open(str(old)) as container:
        count = sum(p.size > 0 for p in container.demux(video=0))
    return itertools.islice(sources, count)


def _lines(path: Path) -> list[Any]:
    return [
        json.loads(line) for line in path.read_text().splitlines() if line.strip()
    ]


def _document(path: Path) -> Any:
    return _lines(path) if path.suffix == ".jsonl" else json.loads(path.read_text())


def _call(path: Path) -> dict[str, Any]:
    """Exit code and output; JSON output as a document, other output by lines."""
    call = json.loads(path.read_text())
    try:
        call["output"] = json.loads(call["output"])
    except ValueError:
        call["output"] = call["output"].splitlines()
    return call


def _source_of(report: Path) -> Path | None:
    """The clip that a job was made from, if it is still there."""
    if not report.is_file():
        return None
    path = Path(json.loads(report.read_text())["input"]["path"])
    return path if path.is_absolute() and path.is_file() else None


def _rectangles(job: Path) -> list[list[int]] | None:
    """Of every frame the rectangle that its plan changes, where stored and upright pictures
    are the same.
    """
    plan, report = job / "plan.jsonl", job / "report.json"
    if (
        not (plan.is_file() and report.is_file())
        or json.loads(report.read_text())["input"]["rotation"]
    ):
        return None
    return [frame.get("changed") or [0, 0, 0, 0] for frame in _lines(plan)]


def compare_jobs(old: Path, new: Path) -> list[Difference]:
    """All differences of two folders of one job."""
    out = compare_documents(
        _call(old / "call.json"), _call(new / "call.json"), "call"
    )
    names = {p.name for folder in (old, new) for p in folder.glob("[!.]*.json*")} - {
        "call.json"
    }
    for name in sorted(names):
        if not ((old / name).is_file() and (new / name).is_file()):
            out.append(Difference(name, "is there in one only"))
            continue
        stem = name.partition(".")[0]
        out += compare_documents(_document(old / name), _document(new / name), stem)
    clips = sorted({p.name for folder in (old, new) for p in folder.glob("*.mkv")})
    for name in clips:
        if not ((old / name).is_file() and (new / name).is_file()):
            out.append(Difference(name, "is there in one only"))
            continue
        out += compare_documents(_streams(old / name), _streams(new / name), "file")
        out += compare_pictures(
            old / name, new / name, _source_of(old / "report.json"), _rectangles(old)
        )
    return out
