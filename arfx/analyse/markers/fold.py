"""The configured prints in every frame: found, their corners refined; and what else was
there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob, Fold
from arfx.analyse.markers.coded import CodedPrints
from arfx.analyse.markers.corners import (
    CODE,
    LIGHT,
    chosen_transfer,
    linear_table,
    refine_found,
    symmetric_in_light,
)
from arfx.analyse.markers.detect import Candidate, Detection, Record
from arfx.analyse.markers.pattern import PatternPicture, coded_luma
from arfx.analyse.markers.pictured import PicturedPrints
from arfx.analyse.markers.scan import SCANS, likeliest, scan
from arfx.analyse.markers.tracker import Tracker
from arfx.analyse.pose.shots import thumbnail
from arfx.core.facts import FrameFacts
from arfx.core.marker import MarkerSpec
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
    thumbnail: np.ndarray


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


class Markers(Fold):
    """The prints in every frame.

    shown : in the last frame
    records : of every frame, at the end;  camera : at the clip's size"""

    name = "markers"
    rows: ClassVar[Mapping[str, type]] = {
        "frames": FrameRow,
        "prints": Sighting,
        "others": OtherPrint,
    }

    def __init__(self, job: AnalysisJob) -> None:
        super().__init__(job)
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
        self.camera = job.camera
        self.frames: list[FrameRow] = []
        self.prints: list[Sighting] = []
        self.others: list[OtherPrint] = []
        self.records: list[Record] = []
        self.shown: list[Sighting] = []
        coded = [m.key for m in job.markers if isinstance(m, MarkerSpec)]
        ink, paper = job.light.ink, job.light.paper
        prints = [
            PatternPicture(key, coded_luma(picture, ink, paper))
            for key, picture in job.prints.items()
        ]
        self._coded = Tracker(CodedPrints(coded, job.params.detect_inverted))
        self._pictured = Tracker(PicturedPrints(prints, job.camera))

    @property
    def detections(self) -> list[Detection]:
        """In the last frame, in light, without duplicates."""
        return [s.print for s in self.shown if s.transfer != CODE and not s.duplicate]

    def step(self, frame: AnalysisFrame) -> None:
        """Raises InputError for luma of another type or size, and for frames out of order."""
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
        self.camera = self.job.camera.scaled_to(width, height)
        found, pictured = self._coded.search(frame), self._pictured.search(frame)
        every = (*found.sightings, *found.duplicates)
        refined = self._refined(index, luma, every, len(found.sightings))
        refined += [Sighting(index, ANY, False, np.nan, s) for s in pictured.sightings]
        self.shown = refined
        self.prints += refined
        if not self.prints:
            self._look_for_others(index, luma, found.others)
        whole = found.whole or pictured.whole
        self.frames.append(FrameRow(index, time_s, width, height, whole, thumbnail(luma)))

    def _refined(
        self, index: int, luma: np.ndarray, found: Sequence[Candidate], first: int
    ) -> list[Sighting]:
        """first : so many of them are no duplicates"""
        prints, skews = refine_found(luma, found, linear_table(LIGHT), self.camera)
        doubtful = [k for k, skew in enumerate(skews) if not symmetric_in_light(skew)]
        again = [found[k] for k in doubtful]
        in_code = zip(
            *refine_found(luma, again, linear_table(CODE), self.camera), strict=True
        )
        out = []
        for k, (one, skew) in enumerate(zip(prints, skews, strict=True)):
            transfer = LIGHT if k in doubtful else ANY
            out.append(Sighting(index, transfer, k >= first, float(skew), one))
            if k in doubtful:
                other, skew_in_code = next(in_code)
                out.append(Sighting(index, CODE, k >= first, float(skew_in_code), other))
        return out

    def _look_for_others(self, index: int, luma: np.ndarray, ids: Iterable[str]) -> None:
        self.others += [OtherPrint(index, False, key) for key in ids]
        if index in SCANS:
            self.others += [
                OtherPrint(index, True, key) for key in ("", *sorted(scan(luma)))
            ]

    def finish(self, clip: Analysis) -> Analysis:
        """Raises NothingToDoError if no configured marker was ever seen, saying what was;
        InputError where frames differ in size."""
        if not self.frames:
            raise NothingToDoError(
                "the clip holds no frame",
                "is it empty, or does --start lie behind its end?",
            )
        size = self.frames[0].width, self.frames[0].height
        for row in self.frames:
            _require_size(row.frame, (row.width, row.height), size)
        self.camera = self.job.camera.scaled_to(*size)
        if not self.prints:
            raise self._nothing_seen()
        transfer = chosen_transfer(
            [s.skew for s in self.prints if s.transfer != CODE],
            [s.skew for s in self.prints if s.transfer == CODE],
        )
        self.records = self._records((transfer, ANY))
        return clip.adding(edge_transfer=transfer, pattern_misfit_px=self._misfits())

    def _records(self, transfers: Container[str]) -> list[Record]:
        shown: dict[int, tuple[list[Detection], list[Detection]]] = {}
        for s in self.prints:
            if s.transfer in transfers:
                shown.setdefault(s.frame, ([], []))[s.duplicate].append(s.print)
        out = []
        for f in self.frames:
            detections, duplicates = shown.get(f.frame, ([], []))
            out.append(
                Record(
                    f.frame,
                    f.time_s,
                    tuple(detections),
                    tuple(duplicates),
                    f.whole,
                    f.thumbnail,
                )
            )
        return out

    def _nothing_seen(self) -> NothingToDoError:
        wanted = ", ".join(m.key for m in self.job.markers)
        coded = [m.family for m in self.job.markers if isinstance(m, MarkerSpec)]
        families = ", ".join(dict.fromkeys(coded))
        message = f"no configured marker ({wanted}) in {len(self.frames)} frames"
        if not families:
            return NothingToDoError(
                message,
                "is the print flat, sharp, at least 50 px wide, and its picture this one?",
            )
        message += f"; dictionaries tried: {families}"
        counts = Counter(o.key for o in self.others if not o.scanned)
        ids = sorted(counts, key=lambda k: (-counts[k], k))[:6]
        scanned = Counter(o.key for o in self.others if o.scanned)
        scans = scanned.pop("", 0)
        strangers = likeliest(scanned)
        if ids:
            return NothingToDoError(
                f"{message}; ids of the same dictionary seen: {', '.join(ids)}",
                f"configure one of those: --marker {ids[0]}:SIZE",
            )
        if strangers:
            other = ", ".join(
                f"{key} ({scanned[key]} of {scans} sampled frames)" for key in strangers[:6]
            )
            return NothingToDoError(
                f"{message}; other dictionaries saw: {other}",
                f"perhaps --marker {strangers[0]}:SIZE",
            )
        return NothingToDoError(
            f"{message}; no marker of any dictionary was seen",
            "is the marker sharp, evenly lit, at least 12 px wide and with a white margin?",
        )

    def _misfits(self) -> dict[str, float]:
        """Median of every pictured print that was seen."""
        every = dict[str, list[float]]()
        for s in (s for r in self.records for s in r.detections):
            if s.key in self.job.prints:
                every.setdefault(s.key, []).append(s.misfit_px)
        return {key: float(np.median(values)) for key, values in every.items()}

    @staticmethod
    def health(facts: Sequence[FrameFacts], summary: Mapping[str, Any]) -> Iterator[Check]:
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
