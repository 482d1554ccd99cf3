"""The analysis of a clip, one frame after the other, then everything at once when its end is known.

Cost per 720p frame: .5 to 2 ms with a marker tracked, about 3 ms without one; at the end about .5 ms per frame more.
Memory: some hundred bytes per frame and marker, no pixels but one reduced image.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from arfx.analyse.fold import Fold
from arfx.analyse.lens import EdgeBlur, footage_lens
from arfx.analyse.light.fold import LightMeter, Picture, lighted
from arfx.analyse.markers.corners import EdgeRefiner
from arfx.analyse.markers.detect import Candidate, Survey
from arfx.analyse.markers.tracker import Found, Tracker
from arfx.analyse.motion.advection import with_anchors
from arfx.analyse.motion.flow import BackgroundMotion
from arfx.analyse.params import AnalyseParams, LightParams
from arfx.analyse.pose.at_rest import BackgroundFlow
from arfx.analyse.pose.fold import solve
from arfx.analyse.pose.presence import CutSignal
from arfx.analyse.records import Analysis, Record, Seen
from arfx.core.camera import Camera
from arfx.core.facts import ABSENT, FrameFacts
from arfx.core.marker import MarkerSpec, anchor_marker
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.errors import ConfigError, InputError, NothingToDoError

AROUND = 2.4  # sizes of the marker: so far its pose tells the motion of what is near it better than the flow

__all__ = ["AnalyseParams", "Analyser", "Analysis", "LightParams"]


class Analyser(Fold):
    """Feed frames in order with `step`, then call `finish`.

    markers : the configured ones, the first that is seen is the world;  camera : for the clip's size or the same aspect
    marker_map : world_from_marker of a known layout; None = mapped from the clip
    folds : what else is wanted: "flow" follows the background, for what is anchored to it (FrameFacts.advection),
        "environment" keeps the surroundings' picture, with the light, "lens" measures the footage's
        blur and the lens behind it
    light : read the light too, from the pictures that `step` then needs;  panorama : of LightParams.environment
    Raises ConfigError for no marker, the same one twice, or a map that lacks one.
    """

    given = frozenset({"markers", "params", "marker_map", "light", "panorama", "_folds"})

    def __init__(
        self,
        markers: tuple[MarkerSpec, ...],
        camera: Camera,
        params: AnalyseParams | None = None,
        marker_map: Mapping[str, Pose] | None = None,
        light: LightParams | None = None,
        panorama: np.ndarray | None = None,
        folds: frozenset[str] = frozenset(),
    ) -> None:
        if not markers:
            raise ConfigError("no marker is configured", "for example --marker 36h11:3:165mm")
        twice = [k for k, n in Counter(m.key for m in markers).items() if n > 1]
        if twice:
            raise ConfigError(f"marker {twice[0]} is configured twice")
        if marker_map is not None and not any(m.key in marker_map for m in markers):
            raise ConfigError("the marker map holds none of the configured markers", f"it holds {', '.join(marker_map)}")
        self.markers, self.camera = tuple(markers), camera
        self.params = params or AnalyseParams()
        self.marker_map = dict(marker_map) if marker_map else None
        self._tracker = Tracker([m.key for m in markers], self.params)
        self._refiner = EdgeRefiner(self.params.transfer)
        self._cut, self._flow, self._survey = CutSignal(), BackgroundFlow(), Survey()
        self.light, self.panorama = light, panorama
        self._meter = LightMeter(light.formula if light is not None else "corrected")
        self._motion = BackgroundMotion() if "flow" in folds else None
        self._edges = EdgeBlur() if "lens" in folds else None
        self._folds = folds
        self._records: list[Record] = []
        self._others: Counter[str] = Counter()
        self._ever_seen = False

    def step(
        self,
        index: int,
        time_s: float,
        luma: np.ndarray,
        picture: Picture | None = None,
        following: Callable[[], np.ndarray] | None = None,
    ) -> None:
        """Take the next frame. luma : (h, w) uint8, upright;  picture : its colours, for the light; None = it tells none
        following : luma of the frame after it; None = there is none, or it is not known

        Raises InputError for another size or order.
        """
        if luma.ndim != 2 or luma.dtype != np.uint8:
            raise InputError(f"frame {index}: luma is {luma.dtype} of shape {luma.shape}", "uint8 of shape (height, width)")
        if (luma.shape[1], luma.shape[0]) != (self.camera.width, self.camera.height):
            if self._records:
                raise InputError(f"frame {index} is {luma.shape[1]}x{luma.shape[0]}, the frames before it are not")
            self.camera = self.camera.scaled_to(luma.shape[1], luma.shape[0])
        if self._records and (index <= self._records[-1].index or time_s <= self._records[-1].time_s):
            last = self._records[-1]
            raise InputError(f"frame {index} at {time_s:g} s comes after frame {last.index} at {last.time_s:g} s")
        luma = np.ascontiguousarray(luma)
        found = self._tracker.step(time_s, luma, following)
        seen, rivals = self._refined(luma, found)
        self._others.update(found.others)
        self._ever_seen |= bool(seen)
        if self.params.survey and not self._ever_seen:
            self._survey.step(len(self._records), luma)
        if self.params.static == "auto":
            boxes = (Rect.around(s.corners_px) for s in (*seen, *rivals))  # rarely asked for
            self._flow.step(index, time_s, luma, boxes, bool(seen))
        if self._motion is not None:
            self._motion.step(index, time_s, luma)
        if self.light is not None and picture is not None:
            self._meter.step(len(self._records), time_s, seen, picture)
        if self._edges is not None:
            self._edges.step(len(self._records), luma, seen, self._refiner.table)
        self._records.append(Record(index, time_s, seen, rivals, found.whole, self._cut.step(luma)))
        for k, replaced in self._refiner.corrections():
            r = self._records[k]
            n = len(r.seen)
            self._records[k] = replace(r, seen=replaced[:n], rivals=replaced[n:])

    def _refined(self, luma: np.ndarray, found: Found) -> tuple[tuple[Seen, ...], tuple[Seen, ...]]:
        every: tuple[Candidate, ...] = (*found.sightings, *found.rivals)
        if not self.params.refine:
            out = tuple(Seen(c.key, c.quad_px, 1.0, float("nan"), False) for c in every)
        else:
            out = self._refiner.refine(len(self._records), luma, every, self.camera)
        n = len(found.sightings)
        return out[:n], out[n:]

    def finish(self) -> Analysis:
        """All facts. Raises NothingToDoError if no configured marker was ever seen, saying what was, or none has a pose."""
        if not self._records:
            raise NothingToDoError("the clip holds no frame", "is it empty, or does --start lie behind its end?")
        if not self._ever_seen:
            raise self._nothing()
        analysis = solve(self._records, self.markers, self.camera, self.params, self.marker_map, self._flow.samples)
        if all(f.status == ABSENT for f in analysis.facts):
            seen = sum(bool(r.seen) for r in self._records)
            raise NothingToDoError(
                f"markers were seen in {seen} of {len(self._records)} frames, but no pose fits, or none lasts for three frames",
                "are the marker's size and the camera calibration right, and of this clip?",
            )
        if self.light is not None:
            analysis = lighted(analysis, self._meter, self.markers, self.light, self.panorama, "environment" in self._folds)
        if self._motion is not None:
            analysis = replace(analysis, facts=self._anchored(analysis, self._motion))
        if self._edges is not None:
            analysis = self._with_lens(analysis, self._edges)
        return replace(analysis, summary={**analysis.summary, "edge_transfer": self._refiner.transfer})

    def _with_lens(self, analysis: Analysis, edges: EdgeBlur) -> Analysis:
        fit = footage_lens(analysis.facts, edges, self.markers, analysis.world_from_marker)
        notices = (
            analysis.notices if fit.known else (*analysis.notices, f"the lens cannot be measured from the footage: {fit.reason}")
        )
        summary = {**analysis.summary, "footage_lens": fit.to_json()}
        return replace(analysis, facts=tuple(f.with_(lens=fit) for f in analysis.facts), summary=summary, notices=notices)

    def _anchored(self, analysis: Analysis, motion: BackgroundMotion) -> tuple[FrameFacts, ...]:
        anchor = anchor_marker(self.markers, analysis.world_from_marker)
        stands = analysis.world_from_marker.get(anchor.key, Pose.identity())
        return with_anchors(analysis.facts, motion.steps, self.camera, stands, AROUND * anchor.size_m)

    def _nothing(self) -> NothingToDoError:
        wanted = ", ".join(m.key for m in self.markers)
        families = ", ".join(dict.fromkeys(m.family for m in self.markers))
        message = f"no configured marker ({wanted}) in {len(self._records)} frames; dictionaries tried: {families}"
        ids = sorted(self._others, key=lambda k: (-self._others[k], k))[:6]
        other = self._survey.text()
        if ids:
            return NothingToDoError(f"{message}; ids of the same dictionary seen: {', '.join(ids)}",
                                    f"configure one of those: --marker {ids[0]}:SIZE")  # fmt: skip
        if other:
            first = self._survey.likeliest()[0]
            return NothingToDoError(f"{message}; other dictionaries saw: {other}", f"perhaps --marker {first}:SIZE")
        return NothingToDoError(f"{message}; no marker of any dictionary was seen",
                                "is the marker sharp, evenly lit, at least 12 px wide and with a white margin?")  # fmt: skip
