"""The configured prints in every frame: found, their corners refined; and what else was
there.
"""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.markers.coded import CodedPrints
from arfx.analyse.markers.corners import (
    CODE,
    LIGHT,
    chosen_transfer,
    refine_found,
    symmetric_in_light,
)
from arfx.analyse.markers.detect import Candidate, Detection, Record
from arfx.analyse.markers.legible import SCANS, likeliest, scan
from arfx.analyse.markers.pattern import PatternPicture, coded_luma
from arfx.analyse.markers.pictured import PicturedPrints
from arfx.analyse.markers.tracker import Tracker
from arfx.analyse.pose.shots import thumbnail
from arfx.core.camera import Camera
from arfx.core.marker import Marker, MarkerSpec
from arfx.core.stage import Check
from arfx.errors import ConfigError, InputError, NothingToDoError

MOST_MISFIT_PX = 1.0  # of a flat print from its picture; blur of 2.5 px makes as much
# in place of a transfer: of prints that are symmetric in light, or found in the picture itself
ANY = ""


class FrameRow(NamedTuple):
    """A frame. whole : all of it was searched;  thumbnail : (18, 32) uint8"""

    frame: int
    time_s: float
    width: int
    height: int
    whole: bool
    thumbnail: ndarray


class Sighting(NamedTuple):
    """A print in one frame, refined in LIGHT, in CODE, or as in ANY. skew : as of `Corners`
    duplicate : a further one of the same key"""

    frame: int
    transfer: str
    duplicate: bool
    skew: float
    print: Detection


class OtherPrint(NamedTuple):
    """A print that is not configured. scanned : found by a search for all families, else one
    of a family that is;  key : "" = that search found nothing"""

    frame: int
    scanned: bool
    key: str


class MarkerSearch:
    """The prints in every frame of a part of the clip.

    Raises ConfigError for no marker, the same one twice, or a map that lacks one."""

    tables: ClassVar[Mapping[str, type]] = {
        "frames": FrameRow,
        "prints": Sighting,
        "others": OtherPrint,
    }

    def __init__(self, job: AnalysisJob) -> None:
        _check_markers(job)
        self.frames: list[FrameRow] = []
        self.prints: list[Sighting] = []
        self.others: list[OtherPrint] = []
        self._camera = job.camera
        coded = [m.key for m in job.markers if isinstance(m, MarkerSpec)]
        ink, paper = job.light.ink, job.light.paper
        pictures = [
            PatternPicture(key, coded_luma(picture, ink, paper))
            for key, picture in job.prints.items()
        ]
        self._coded = Tracker(CodedPrints(coded, job.params.detect_inverted))
        self._pictured = Tracker(PicturedPrints(pictures, job.camera))

    def step(self, frame: AnalysisFrame) -> list[Sighting]:
        """What is seen in the next frame. Raises InputError for luma of another type or size,
        and for frames out of order."""
        index, time_s, luma = frame.index, frame.time_s, frame.luma
        if luma.ndim != 2 or luma.dtype != np.uint8:
            raise InputError(
                f"frame {index}: luma is {luma.dtype} of shape {luma.shape}",
                "uint8 of shape (height, width)",
            )
        height, width = luma.shape
        if self.frames:
            last = self.frames[-1]
            _require_size(index, (width, height), (last.width, last.height))
            if index != last.frame + 1 or time_s <= last.time_s:
                raise InputError(
                    f"frame {index} at {time_s:g} s comes after frame {last.frame} at"
                    f" {last.time_s:g} s"
                )
        camera = self._camera.scaled_to(width, height)
        found, pictured = self._coded.search(frame), self._pictured.search(frame)
        every = found.sightings + found.duplicates
        shown = _refined(index, luma, every, len(found.sightings), camera)
        shown += [Sighting(index, ANY, False, np.nan, s) for s in pictured.sightings]
        self.prints += shown
        if not self.prints:
            self.others += [OtherPrint(index, False, key) for key in found.others]
            scanned = ("", *sorted(scan(luma))) if index in SCANS else ()
            self.others += [OtherPrint(index, True, key) for key in scanned]
        whole = found.whole or pictured.whole
        self.frames.append(
            FrameRow(index, time_s, width, height, whole, thumbnail(luma))
        )
        return shown


def detections(shown: Sequence[Sighting]) -> list[Detection]:
    """Of one frame, in light, without duplicates."""
    return [s.print for s in shown if s.transfer != CODE and not s.duplicate]


def _check_markers(job: AnalysisJob) -> None:
    if not job.markers:
        raise ConfigError(
            "no marker is configured",
            "for example --marker 36h11:3:165mm, or --pattern poster.png:20cm",
        )
    twice = [k for k, n in Counter(m.key for m in job.markers).items() if n > 1]
    if twice:
        raise ConfigError(f"marker {twice[0]} is configured twice")
    if job.marker_map is not None and not any(
        m.key in job.marker_map for m in job.markers
    ):
        raise ConfigError(
            "the marker map holds none of the configured markers",
            f"it holds {', '.join(job.marker_map)}",
        )


def _refined(
    index: int,
    luma: ndarray,
    found: Sequence[Candidate],
    first: int,
    camera: Camera,
) -> list[Sighting]:
    """first : so many of them are no duplicates"""
    in_light = refine_found(luma, found, LIGHT, camera)
    doubtful = [
        k for k, (_, skew) in enumerate(in_light) if not symmetric_in_light(skew)
    ]
    in_code = refine_found(luma, [found[k] for k in doubtful], CODE, camera)
    rows = [(LIGHT if k in doubtful else ANY, k, *p) for k, p in enumerate(in_light)]
    rows += [(CODE, k, *p) for k, p in zip(doubtful, in_code, strict=True)]
    return [Sighting(index, kind, k >= first, skew, p) for kind, k, p, skew in rows]


def frame_size(frames: Sequence[FrameRow]) -> tuple[int, int]:
    """(width, height) of the clip. Raises NothingToDoError without a frame, InputError where
    frames differ."""
    if not frames:
        raise NothingToDoError(
            "the clip holds no frame",
            "is it empty, or does --start lie behind its end?",
        )
    size = frames[0].width, frames[0].height
    for row in frames:
        _require_size(row.frame, (row.width, row.height), size)
    return size


def choose_transfer(prints: Iterable[Sighting]) -> str:
    """In which values the clip's edges are symmetric: LIGHT or CODE."""
    prints = [*prints]
    return chosen_transfer(
        [s.skew for s in prints if s.transfer != CODE],
        [s.skew for s in prints if s.transfer == CODE],
    )


def records(
    frames: Sequence[FrameRow], prints: Iterable[Sighting], transfer: str
) -> list[Record]:
    """What is seen in every frame, by the sightings of one transfer."""
    shown: dict[int, tuple[list[Detection], list[Detection]]] = {}
    for s in prints:
        if s.transfer in (transfer, ANY):
            shown.setdefault(s.frame, ([], []))[s.duplicate].append(s.print)
    out = []
    for f in frames:
        seen, duplicates = map(tuple, shown.get(f.frame, ((), ())))
        out.append(Record(f.frame, f.time_s, seen, duplicates, f.whole, f.thumbnail))
    return out


def nothing_seen(
    markers: Sequence[Marker], frames: int, others: Sequence[OtherPrint]
) -> NothingToDoError:
    """Why no configured marker was seen, as far as it shows."""
    wanted = ", ".join(m.key for m in markers)
    coded = [m.family for m in markers if isinstance(m, MarkerSpec)]
    families = ", ".join(dict.fromkeys(coded))
    message = f"no configured marker ({wanted}) in {frames} frames"
    if not families:
        return NothingToDoError(
            message,
            "is the print flat, sharp, at least 50 px wide, and its picture this one?",
        )
    message += f"; dictionaries tried: {families}"
    counts = Counter(o.key for o in others if not o.scanned)
    ids = sorted(counts, key=lambda k: (-counts[k], k))[:6]
    scanned = Counter(o.key for o in others if o.scanned)
    scans = scanned.pop("", 0)
    strangers = likeliest(scanned)
    if ids:
        return NothingToDoError(
            f"{message}; ids of the same dictionary seen: {', '.join(ids)}",
            f"configure one of those: --marker {ids[0]}:SIZE",
        )
    if strangers:
        other = ", ".join(
            f"{key} ({scanned[key]} of {scans} sampled frames)"
            for key in strangers[:6]
        )
        return NothingToDoError(
            f"{message}; other dictionaries saw: {other}",
            f"perhaps --marker {strangers[0]}:SIZE",
        )
    return NothingToDoError(
        f"{message}; no marker of any dictionary was seen",
        "is the marker sharp, evenly lit, at least 12 px wide and with a white margin?",
    )


def pattern_misfits(
    records: Iterable[Record], keys: Container[str]
) -> dict[str, float]:
    """Median misfit, px, of every print among `keys` that was seen."""
    every = dict[str, list[float]]()
    for s in (s for r in records for s in r.detections):
        if s.key in keys:
            every.setdefault(s.key, []).append(s.misfit_px)
    return {key: float(np.median(values)) for key, values in every.items()}


def pattern_checks(summary: Mapping[str, Any]) -> Iterator[Check]:
    for key, value in summary.get("pattern_misfit_px", {}).items():
        yield Check(
            f"{key}: misfit of the picture (px)",
            round(value, 3),
            MOST_MISFIT_PX,
            value <= MOST_MISFIT_PX,
            "its corners are off by about as much: fix the print to something flat, and"
            " give the picture that was printed",
        )


def _require_size(index: int, size: tuple[int, int], before: tuple[int, int]) -> None:
    if size != before:
        raise InputError(
            f"frame {index} is {size[0]}x{size[1]}, the frames before it are not"
        )
