"""The configured prints in every frame: found, their corners refined; and what else was
there.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from arfx.analyse.job import AnalysisFrame, AnalysisJob
from arfx.analyse.markers.corners import (
    CODE,
    LIGHT,
    linear_table,
    refine_corners,
    side_blurs,
)
from arfx.analyse.markers.detect import Candidate, Detection, Record
from arfx.analyse.markers.inner_edges import misplaced_px
from arfx.analyse.markers.legible import SCANS, scan
from arfx.analyse.markers.pattern import PatternPicture, coded_luma
from arfx.analyse.markers.tracker import CodedPrints, PicturedPrints
from arfx.analyse.pose.shots import thumbnail
from arfx.core.marker import Marker, MarkerSpec
from arfx.core.marker_codes import cells_per_side
from arfx.core.stage import Check
from arfx.errors import NothingToDoError

MOST_MISFIT_PX = 1.0  # of a flat print from its picture; blur of 2.5 px makes as much
# in place of a transfer: of prints that are symmetric in light, or found in the picture itself
ANY = ""
SIGHTINGS = 12  # by fewer than that nothing is decided
# Measured: true linear blur gives skews up to .03 in light; camera-sharpened footage .19 in
# light and -.03 in code.
SKEWED = 0.07


class FrameRow(NamedTuple):
    """A frame. thumbnail : (18, 32) uint8"""

    frame: int
    time_s: float
    width: int
    height: int
    thumbnail: ndarray


class Sighting(NamedTuple):
    """A print in one frame, refined in LIGHT, in CODE, or as in ANY. skew : as of `Corners`"""

    frame: int
    transfer: str
    skew: float
    print: Detection


class OtherPrint(NamedTuple):
    """A print that is not followed: a further one of a configured key, or, while none of these
    is seen, one that a search for all families found."""

    frame: int
    key: str


class MarkerSearch:
    """The prints in every frame of a part of the clip. blurs : of their sides, too"""

    def __init__(self, job: AnalysisJob, blurs: bool = False) -> None:
        self.rows: list[Any] = []
        self._seen = False
        self._camera, self._blurs = job.camera, blurs
        coded = [m.key for m in job.markers if isinstance(m, MarkerSpec)]
        ink, paper = job.light.ink, job.light.paper
        pictures = [
            PatternPicture(key, coded_luma(picture, ink, paper))
            for key, picture in job.prints.items()
        ]
        self._coded = CodedPrints(coded, job.params.detect_inverted)
        self._pictured = PicturedPrints(pictures, job.camera)

    def step(self, frame: AnalysisFrame) -> list[Sighting]:
        """What is seen in the next frame."""
        index, luma = frame.index, frame.luma
        height, width = luma.shape
        coded, twice = self._coded.search(frame)
        pictured, _ = self._pictured.search(frame)
        shown = self.coded_sightings(frame, coded)
        shown += [Sighting(index, ANY, np.nan, s) for s in pictured]
        self._seen |= bool(shown)
        instead = [] if self._seen or index not in SCANS else scan(luma)
        self.rows += [
            FrameRow(index, frame.time_s, width, height, thumbnail(luma)),
            *shown,
            *(OtherPrint(index, key) for key in (*twice, *instead)),
        ]
        return shown

    def coded_sightings(
        self, frame: AnalysisFrame, found: Sequence[Candidate]
    ) -> list[Sighting]:
        """Prints that were found, refined in light, and in code where that may be better."""
        in_light = self.refined(LIGHT, frame, found)
        doubtful = [abs(s.skew) > SKEWED for s in in_light]
        in_code = self.refined(CODE, frame, [*compress(found, doubtful)])
        shown = [
            s if doubt else s._replace(transfer=ANY)
            for s, doubt in zip(in_light, doubtful, strict=True)
        ]
        return shown + in_code

    def refined(
        self, transfer: str, frame: AnalysisFrame, found: Sequence[Candidate]
    ) -> list[Sighting]:
        """transfer : LIGHT or CODE"""
        if not found:
            return []
        luma, table = frame.luma, linear_table(transfer)
        quads = np.stack([c.quad_px for c in found])
        cells = np.array([cells_per_side(c.family) for c in found])
        self._camera = self._camera.scaled_to(*luma.shape[::-1])
        r = refine_corners(luma, quads, cells, table, self._camera)
        numbers = (a.tolist() for a in (r.sigma_px, r.blur_px, r.inverted, r.skew))
        blurs = np.full((len(found), 4), np.nan)
        if self._blurs:
            blurs = side_blurs(luma, r.corners_px, cells, table)
        out = []
        for c, quad, sides, sigma, blur, inverted, skew in zip(
            found, r.corners_px, blurs, *numbers, strict=True
        ):
            off = misplaced_px(luma, quad, c.family, c.id, table)
            print_ = Detection(c.key, quad, sigma, blur, inverted, off, 0.0, sides)
            out.append(Sighting(frame.index, transfer, skew, print_))
        return out


def refined_in(transfer: str, prints: Iterable[Sighting]) -> list[Sighting]:
    """Those of LIGHT, or of CODE."""
    return [s for s in prints if s.transfer in (transfer, ANY)]


def choose_transfer(prints: Sequence[Sighting]) -> str:
    """In which values the clip's edges are symmetric: LIGHT or CODE."""
    in_light, in_code = (
        [s.skew for s in prints if (s.transfer == CODE) == code]
        for code in (False, True)
    )
    if np.isfinite(in_light).sum() < SIGHTINGS or not np.isfinite(in_code).any():
        return LIGHT
    skew, other = (abs(float(np.nanmedian(skews))) for skews in (in_light, in_code))
    return CODE if skew > SKEWED and other < 0.5 * skew else LIGHT


def records(
    frames: Sequence[FrameRow], prints: Iterable[Sighting], transfer: str
) -> list[Record]:
    """What is seen in every frame, by the sightings of one transfer."""
    shown: dict[int, list[Detection]] = {f.frame: [] for f in frames}
    for s in refined_in(transfer, prints):
        shown[s.frame].append(s.print)
    return [
        Record(f.frame, f.time_s, tuple(shown[f.frame]), f.thumbnail) for f in frames
    ]


def nothing_seen(
    markers: Sequence[Marker], frames: int, others: Sequence[OtherPrint]
) -> NothingToDoError:
    """Why no configured marker was seen, as far as it shows."""
    wanted = ", ".join(m.key for m in markers)
    message = f"no configured marker ({wanted}) in {frames} frames"
    coded = [m.family for m in markers if isinstance(m, MarkerSpec)]
    if not coded:
        return NothingToDoError(
            message,
            "is the print flat, sharp, at least 50 px wide, and its picture this one?",
        )
    message += f"; dictionaries tried: {', '.join(dict.fromkeys(coded))}"
    instead = Counter(o.key for o in others).most_common(6)
    if not instead:
        return NothingToDoError(
            f"{message}; no marker of any dictionary was seen",
            "is the marker sharp, evenly lit, at least 12 px wide and with a white margin?",
        )
    scans = sum(number < frames for number in SCANS)
    seen = ", ".join(f"{key} ({n} of {scans} sampled frames)" for key, n in instead)
    return NothingToDoError(
        f"{message}; seen instead: {seen}", f"perhaps --marker {instead[0][0]}:SIZE"
    )


def pattern_misfits(
    prints: Sequence[Sighting], keys: Iterable[str]
) -> dict[str, float]:
    """Median misfit, px, of every print among `keys` that was seen."""
    every = {k: [s.print.misfit_px for s in prints if s.print.key == k] for k in keys}
    return {key: float(np.median(values)) for key, values in every.items() if values}


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
