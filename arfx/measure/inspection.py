"""What is in a clip: stream, times, light, and the markers of every family, from a sample
of its frames.

Markers are looked for with every dictionary in whole frames, so it costs about .2 s a
sampled frame at 1080p; the number of samples is fixed, and so is the cost for a long clip.
Nested dictionaries (4X4_50 is the beginning of 4X4_1000) are named by the smallest one that
holds the ids seen."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.markers.corners import linear_table, refine_corners, side_blurs
from arfx.analyse.markers.detect import SCANNED_FAMILIES, Candidate, MarkerDetector
from arfx.analyse.markers.legible import HOLDS_FRAMES, legible
from arfx.analyse.pose.planar import both_poses
from arfx.analyse.pose.shots import find_cuts, thumbnail, unlikeness
from arfx.core.camera import Camera
from arfx.core.marker import MarkerSpec, smallest_family
from arfx.core.marker_codes import UNIT_SQUARE, cells_per_side
from arfx.core.numerics import angle_between, divide
from arfx.core.pose import Pose
from arfx.measure.truth import quantiles
from arfx.media.clip import PHOTO, ClipInfo
from arfx.media.frames import ClipReader

MIN_SIDE_PX = 12.0  # smaller squares are found in any texture
_SQUARE = 0.1  # by which sides and diagonals of a square may differ
_SAME_SIZE = 0.06  # prints of one size are measured as different by less
# clips up to this many frames are read whole (cuts are found too); longer ones by seeking
READ_WHOLE = 900
FIGURES = "side_px", "blur_px", "tilt_deg"
Figures = dict[str, list[float]]


@dataclass
class Found:
    """One marker over the samples. figures : by name, one each per sample where measurable
    quads : all of its sightings, by sample;  counted : samples in which one counts;  sure :
    one is plain by itself;  same : a better one in its place
    """

    family: str
    id: int
    figures: Figures = field(default_factory=lambda: {n: [] for n in FIGURES})
    quads: dict[int, list[ndarray]] = field(default_factory=dict)
    counted: set[int] = field(default_factory=set)
    sure: bool = False
    same: Found | None = None
    why: str = ""

    @property
    def key(self) -> str:
        return f"{self.family}:{self.id}"

    def to_json(self, looked: int) -> dict[str, Any]:
        return {
            "marker": self.key,
            "family": self.family,
            "id": self.id,
            "frames": len(self.quads),
            "looked": looked,
            **{name: _spread(values) for name, values in self.figures.items()},
            "twice_in_a_frame": sum(len(quads) - 1 for quads in self.quads.values()),
            **({"why": self.why} if self.why else {}),
        }


def inspect(
    info: ClipInfo, camera: Camera | None = None, samples: int = 24
) -> dict[str, Any]:
    """Everything `arfx inspect` says, as one JSON-able document.

    camera : of the clip's picture size; with it the markers' tilt is reported;  samples :
    frames that are searched, >= 1
    Raises InputError where no frame can be decoded."""
    detector = MarkerDetector(SCANNED_FAMILIES, MIN_SIDE_PX)
    found: dict[str, Found] = {}
    light: dict[int, tuple[float, ...]] = {}  # of the frames that are searched
    thumbnails = []
    lowest, highest = (0, 255) if info.full_range else (16, 235)
    with ClipReader(info) as reader:
        times = reader.times()
        pts = times.pts if times else [frame.pts for frame in reader.frames()]
        whole, last = len(pts) <= READ_WHOLE, max(len(pts) - 1, 0)
        count = max(min(samples, len(pts)), 1)
        at = sorted({round(i) for i in np.linspace(0, last, count)})
        sampled = ((i, f) for i in at for f in islice(reader.frames(pts[i]), 1))
        for number, frame in enumerate(reader.frames()) if whole else sampled:
            luma = frame.luma()
            if whole:
                thumbnails.append(thumbnail(luma))
            if number in at:
                level = divide(float(luma.mean()) - lowest, highest - lowest)
                ends = (luma >= highest).mean(), (luma <= lowest).mean()
                light[number] = (float(level), *map(float, ends))
                _record(found, detector.search(luma), number, luma, camera)
        truncated = reader.truncated
    markers, left_out = confirmed(found)
    looked = len(light)
    levels, clipped, dark = np.reshape([*light.values()], (-1, 3)).T.tolist()
    one, two = (unlikeness(thumbnails, apart) for apart in (1, 2))
    return {
        "clip": {
            **info.to_json(),
            "frames": len(thumbnails) if whole else len(pts),
            **_times(pts or [info.start_pts], info),
            "truncated": truncated,
        },
        "samples": list(light),
        "markers": [
            {**m.to_json(looked), "size_of_first": relative_size(markers[0], m)}
            for m in markers
        ],
        "left_out": [m.to_json(looked) for m in left_out],
        "marker_coverage": len({i for m in markers for i in m.quads})
        / max(looked, 1),
        "light": {
            "mean_level": _spread(levels),
            "clipped_fraction": max(clipped, default=0.0),
            "black_fraction": max(dark, default=0.0),
            "level_change": max(levels, default=0.0) - min(levels, default=0.0),
        },
        "cuts": find_cuts(one, two, [False] * len(thumbnails)) if whole else None,
        "camera": None if camera is None else camera.source,
    }


def _times(pts: Sequence[int], info: ClipInfo) -> dict[str, Any]:
    steps = np.diff(np.array(pts, float)) * float(info.time_base)
    typical = float(np.median(steps)) if len(steps) else None
    uneven = bool(typical and (steps.max() - steps.min()) > 0.1 * typical)
    gaps = int((steps > 1.5 * typical).sum()) if typical else 0
    length = float((pts[-1] - pts[0]) * info.time_base) + (typical or 0.0)
    return {
        "seconds": length,
        "start_s": float(pts[0] * info.time_base),
        "vfr": uneven,
        "gaps": gaps,
        "longest_gap_s": float(steps.max()) if gaps else 0.0,
    }


def _record(
    found: dict[str, Found],
    seen: list[Candidate],
    index: int,
    luma: ndarray,
    camera: Camera | None,
) -> None:
    cells = np.array([cells_per_side(c.family) for c in seen])
    quads = np.reshape([c.quad_px for c in seen], (-1, 4, 2))
    refined = refine_corners(luma, quads, cells, linear_table()).corners_px
    blurred = side_blurs(luma, quads, cells, linear_table())
    for c, quad, blurs in zip(seen, refined, blurred, strict=True):
        m = found.setdefault(c.key, Found(c.family, c.id))
        counts, sure = legible(luma, c)
        m.counted |= {index} if counts else set()
        m.sure |= sure
        m.quads.setdefault(index, []).append(quad)
        if len(m.quads[index]) > 1:
            continue
        known = blurs[np.isfinite(blurs)]
        tilt = None if camera is None else tilt_deg(c.quad_px, camera)
        blur = float(np.median(known)) if len(known) else None
        for name, value in zip(FIGURES, (c.side_px, blur, tilt), strict=True):
            if value is not None:
                m.figures[name].append(value)


def tilt_deg(quad_px: ndarray, camera: Camera) -> float | None:
    """Angle in degrees between the marker's normal and the line of sight, of the better
    planar pose; None without one.
    """
    poses = both_poses(MarkerSpec("", 0, 1.0).corners_m, camera.normalised(quad_px))
    if not len(poses):
        return None
    better = Pose.from_rotvec(*poses[0])
    normal, towards = better.rotation[:, 2], -better.translation_m
    return float(np.degrees(angle_between(normal, towards)))


def confirmed(found: dict[str, Found]) -> tuple[list[Found], list[Found]]:
    """The markers to trust, most often seen first, under the smallest dictionary that holds
    them; and what is left out, with `why`: what lies in or around a better one, and what is
    neither plain by itself nor in HOLDS_FRAMES samples."""
    kept, left_out = list[Found](), list[Found]()
    for m in sorted(
        found.values(),
        key=lambda m: (-len(m.counted), not m.sure, -len(m.quads), m.family, m.id),
    ):
        m.same = next((k for k in kept if _same_place(m, k)), None)
        plain = m.sure or len(m.counted) >= HOLDS_FRAMES
        (kept if plain and m.same is None else left_out).append(m)
    for some in (kept, left_out):
        highest = {
            m.family: max(k.id for k in some if k.family == m.family) for m in some
        }
        for m in some:
            m.family = smallest_family(m.family, highest[m.family])
    for m in left_out:
        m.why = "not plain (white margin, clear cells), and in too few frames"
        if m.same is not None:
            m.why = f"read in the place of {m.same.key}"
    return kept, left_out


def _same_place(m: Found, better: Found) -> bool:
    """Whether most sightings of `m` lie in or around one of `better`: two dictionaries read
    one print, or what is in it.
    """
    on = [
        any(_inside(q, b) or _inside(b, q) for b in better.quads.get(i, ()))
        for i, quads in m.quads.items()
        for q in quads
    ]
    return 2 * sum(on) > len(on)


def _inside(quad: ndarray, other: ndarray) -> bool:
    middle = quad.mean(0).tolist()
    return cv2.pointPolygonTest(other.astype(np.float32), middle, False) >= 0


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    """Smallest, median and largest; None for nothing."""
    return quantiles(values, min=0, median=50, max=100) if values else None


def relative_size(first: Found, m: Found) -> float | None:
    """How large a print is in sides of the first one, of the frames that show both in one
    plane; None where there are none.

    There the homography that makes the first one's image a unit square makes the other's a
    square, too.
    """
    sizes, together = list[float](), first.quads.keys() & m.quads.keys()
    for i in together:
        ours, theirs = (q[i][0].astype(np.float32) for q in (first.quads, m.quads))
        flat = cv2.getPerspectiveTransform(ours, UNIT_SQUARE)
        quad = cv2.perspectiveTransform(theirs[None], flat)[0]
        sides = np.linalg.norm(quad - quad[[1, 2, 3, 0]], axis=1)
        across = np.linalg.norm(quad[:2] - quad[2:], axis=1) / np.sqrt(2)
        spans = np.append(sides, across)
        if spans.max() <= (1 + _SQUARE) * spans.min():
            sizes.append(float(spans.mean()))
    middle = float(np.median(sizes)) if sizes else 0.0
    alike = sum(abs(size - middle) <= _SAME_SIZE / 2 * middle for size in sizes)
    return middle if 2 * alike > len(together) else None


def size_names(markers: Sequence[dict[str, Any]]) -> list[str]:
    """A word for the size of each marker of `inspect`: SIZE, SIZE2 … for those that are known
    to be of other sizes.
    """
    groups, names = [1.0], list[str]()
    for m in markers:
        size = m["size_of_first"] or 1.0
        group = next((g for g in groups if abs(size / g - 1) <= _SAME_SIZE), size)
        groups += [] if group in groups else [group]
        k = groups.index(group)
        names.append(f"SIZE{k + 1}" if k else "SIZE")
    return names


def suggestion(document: dict[str, Any], clip: Path, camera: Path | None) -> str:
    """The `arfx process` command for the markers found; empty without one. SIZE is to be
    measured on the print, SIZE2 … on prints of other sizes.
    """
    found = document["markers"]
    if not found:
        return ""
    sizes = zip(found, size_names(found), strict=True)
    markers = [f"--marker {m['marker']}:{size}" for m, size in sizes]
    files = shlex.join([str(clip), "--camera", str(camera or "camera.yaml")])
    given = " ".join([files, *markers])
    out = "out.png" if document["clip"]["container"] == PHOTO else "out.mp4"
    return f"arfx process {given} --model MODEL.glb --fit 15cm -o {out}"
