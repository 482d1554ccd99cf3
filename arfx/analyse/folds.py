"""The analysis of a clip: the folds that are wanted, and those that they need, over its stretches.

Cost per 720p frame: .5 to 2 ms with a marker tracked, about 3 ms without one; at the end
about .5 ms per frame more.
Memory: some hundred bytes per frame and marker, no pixels but one reduced image."""

from __future__ import annotations

from collections.abc import Collection
from functools import reduce

from arfx.analyse.depth.plane_pose import PlanePose, RealPlanes
from arfx.analyse.depth.scale import Depth
from arfx.analyse.fold import PLANE, Analysis, AnalysisFrame, AnalysisJob, Fold
from arfx.analyse.lens import FootageLens
from arfx.analyse.light.fold import Environment, LightOfMarkers, LightOnPlane
from arfx.analyse.markers.fold import Markers
from arfx.analyse.motion.advection import Advection
from arfx.analyse.pose.fold import MarkerPose
from arfx.analyse.pose.visibility import ModelBox
from arfx.analyse.tables import Tables, by_columns, rows_of

# Every fold behind those that it needs. On a plane there are no markers, nor what needs them.
FOLDS: dict[str, type[Fold]] = {
    kind.name: kind
    for kind in (
        Markers,
        MarkerPose,
        LightOfMarkers,
        Environment,
        Advection,
        FootageLens,
        ModelBox,
        Depth,
        RealPlanes,
    )
}
ON_PLANE: dict[str, type[Fold]] = {
    kind.name: kind
    for kind in (
        PlanePose,
        LightOnPlane,
        Environment,
        Advection,
        ModelBox,
        Depth,
        RealPlanes,
    )
}


class Analyser:
    """Feed frames in order with `step`, then call `finish`. wanted : names of folds; what
    this job cannot have is left out

    Or feed each stretch of a clip to an analyser of its own, and `add` the tables of these in
    order to one that saw no frame.

    Raises ConfigError for no marker, the same one twice, or a map that lacks one."""

    def __init__(self, job: AnalysisJob, wanted: Collection[str] = ("pose",)) -> None:
        table = ON_PLANE if job.anchor == PLANE else FOLDS
        kinds = table | {
            name: kind for name, kind in job.kinds.items() if {*kind.needs} <= table.keys()
        }
        names = {n for n in wanted if n in kinds}
        for kind in reversed(kinds.values()):
            names.update(kind.needs if kind.name in names else ())
        self.folds: dict[str, Fold] = {}
        for name, kind in kinds.items():
            if name in names:
                self.folds[name] = kind(job, *(self.folds[n] for n in kind.needs))

    def step(self, frame: AnalysisFrame) -> None:
        """Raises InputError for another size or order."""
        for fold in self.folds.values():
            fold.step(frame)

    def tables(self) -> Tables:
        """What the frames showed: the rows of every fold, by "fold/attribute"."""
        return {
            f"{fold.name}/{name}": by_columns(getattr(fold, name), kind)
            for fold in self.folds.values()
            for name, kind in fold.rows.items()
        }

    def add(self, tables: Tables, shift: int = 0) -> None:
        """Add what the next frames showed. shift : to be added to their numbers"""
        for fold in self.folds.values():
            for name, kind in fold.rows.items():
                rows = rows_of(tables[f"{fold.name}/{name}"], kind, shift)
                getattr(fold, name).extend(rows)

    def finish(self, clip: Analysis | None = None) -> Analysis:
        """clip : what is known of it beside the frames.

        Raises NothingToDoError where nothing was seen to stand on.
        """
        return reduce(
            lambda clip, fold: fold.finish(clip), self.folds.values(), clip or Analysis()
        )
