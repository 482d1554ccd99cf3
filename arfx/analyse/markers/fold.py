"""The configured prints in every frame: found, their corners refined, cuts between shots
noticed; and what else was there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from arfx.analyse.fold import Analysis, AnalysisFrame, AnalysisJob, Fold, shifted
from arfx.analyse.markers.coded import CodedPrints
from arfx.analyse.markers.corners import EdgeRefiner
from arfx.analyse.markers.detect import Detection, Record
from arfx.analyse.markers.pattern import PatternPicture, coded_luma
from arfx.analyse.markers.pictured import PicturedPrints
from arfx.analyse.markers.scan import DictionaryScan
from arfx.analyse.markers.tracker import Tracker
from arfx.analyse.pose.visibility import ShotDetector
from arfx.core.facts import FrameFacts
from arfx.core.marker import MarkerSpec
from arfx.core.stage import Check
from arfx.errors import ConfigError, InputError, NothingToDoError

MOST_MISFIT_PX = 1.0  # of a flat print from its picture; blur of 2.5 px makes as much


class Markers(Fold):
    """records : of every frame;  camera : at the clip's size

    detections : in the last frame, as it was refined at once;  prints : these and their duplicates
    """

    name = "markers"
    given = frozenset({"job"})
    carried = frozenset({"detections", "prints", "_coded", "_pictured"})

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
        self.records: list[Record] = []
        self.detections: tuple[Detection, ...] = ()
        self.prints: tuple[Detection, ...] = ()
        coded = [m.key for m in job.markers if isinstance(m, MarkerSpec)]
        ink, paper = job.light.ink, job.light.paper
        prints = [
            PatternPicture(key, coded_luma(picture, ink, paper))
            for key, picture in job.prints.items()
        ]
        self._coded = Tracker(CodedPrints(coded, job.params.detect_inverted))
        self._pictured = Tracker(PicturedPrints(prints, job.camera))
        self._refiner = EdgeRefiner()
        self._cut, self._survey = ShotDetector(), DictionaryScan()
        self._others: Counter[str] = Counter()
        self._ever_seen = False

    @property
    def table(self) -> np.ndarray:
        """(256,) coded luma to linear light, as decided so far."""
        return self._refiner.table

    def step(self, frame: AnalysisFrame) -> None:
        """Raises InputError for luma of another type or size, and for frames out of order."""
        index, time_s, luma, records = frame.index, frame.time_s, frame.luma, self.records
        if luma.ndim != 2 or luma.dtype != np.uint8:
            raise InputError(
                f"frame {index}: luma is {luma.dtype} of shape {luma.shape}",
                "uint8 of shape (height, width)",
            )
        if (luma.shape[1], luma.shape[0]) != (self.camera.width, self.camera.height):
            if records:
                raise InputError(
                    f"frame {index} is {luma.shape[1]}x{luma.shape[0]}, the frames before"
                    " it are not"
                )
            self.camera = self.camera.scaled_to(luma.shape[1], luma.shape[0])
        if records and (index != records[-1].index + 1 or time_s <= records[-1].time_s):
            raise InputError(
                f"frame {index} at {time_s:g} s comes after frame {records[-1].index} at"
                f" {records[-1].time_s:g} s"
            )
        found, pictured = self._coded.search(frame), self._pictured.search(frame)
        refined = self._refiner.refine(
            frame.index, luma, (*found.sightings, *found.duplicates), self.camera
        )
        coded, duplicates = refined[: len(found.sightings)], refined[len(found.sightings) :]
        self.detections, self.prints = (
            (*coded, *pictured.sightings),
            (*refined, *pictured.sightings),
        )
        self._others.update(found.others)
        self._ever_seen |= bool(self.detections)
        if not self._ever_seen:
            self._survey.step(frame.index, luma)
        whole = found.whole or pictured.whole
        self.records.append(
            Record(
                frame.index,
                frame.time_s,
                self.detections,
                duplicates,
                whole,
                self._cut.step(luma),
            )
        )
        self._correct()

    def _correct(self) -> None:
        first = self.records[0].index if self.records else 0
        for index, replaced in self._refiner.corrections():
            was = self.records[index - first]
            n = len(replaced) - len(was.duplicates)
            self.records[index - first] = replace(
                was,
                detections=(*replaced[:n], *was.detections[n:]),
                duplicates=replaced[n:],
            )

    def join(self, later: Self, shift: int) -> None:
        """Raises InputError where the frames have another size."""
        mine, others = ((c.width, c.height) for c in (self.camera, later.camera))
        if later.records:
            if self.records and mine != others:
                raise InputError(
                    f"frame {len(self.records)} is {others[0]}x{others[1]}, the frames"
                    " before it are not"
                )
            self.camera = later.camera
        records, unlike = shifted(later.records, shift), self._cut.join(later._cut)
        records[: len(unlike)] = [
            replace(r, dissimilarity=d) for r, d in zip(records, unlike, strict=False)
        ]
        self.records += records
        self._refiner.join(later._refiner, shift)
        self._correct()
        self._others.update(later._others)
        if not self._ever_seen:
            self._survey.join(later._survey)
        self._ever_seen |= later._ever_seen

    def finish(self, clip: Analysis) -> Analysis:
        """Raises NothingToDoError if no configured marker was ever seen, saying what was."""
        if not self.records:
            raise NothingToDoError(
                "the clip holds no frame",
                "is it empty, or does --start lie behind its end?",
            )
        if self._ever_seen:
            return clip.adding(
                edge_transfer=self._refiner.transfer, pattern_misfit_px=self._misfits()
            )
        wanted = ", ".join(m.key for m in self.job.markers)
        coded = [m.family for m in self.job.markers if isinstance(m, MarkerSpec)]
        families = ", ".join(dict.fromkeys(coded))
        message = f"no configured marker ({wanted}) in {len(self.records)} frames"
        if not families:
            raise NothingToDoError(
                message,
                "is the print flat, sharp, at least 50 px wide, and its picture this one?",
            )
        message += f"; dictionaries tried: {families}"
        ids = sorted(self._others, key=lambda k: (-self._others[k], k))[:6]
        other = self._survey.text()
        if ids:
            raise NothingToDoError(
                f"{message}; ids of the same dictionary seen: {', '.join(ids)}",
                f"configure one of those: --marker {ids[0]}:SIZE",
            )
        if other:
            first = self._survey.likeliest()[0]
            raise NothingToDoError(
                f"{message}; other dictionaries saw: {other}",
                f"perhaps --marker {first}:SIZE",
            )
        raise NothingToDoError(
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
