"""Decide what one frame needs: which stages, at which level, on which pixels. Pure; touches no pixel.

1. demand: each stage says what it would change, or why it does not run; where the object is not visible, only those that can
2. unread: walking backwards from the image, a stage that writes nothing anyone reads is dropped
3. rectangles: the same walk carries one growing rectangle of wanted pixels
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from arfx.core.cost import Prices
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Skip, Step
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage
from arfx.plan.work import terms_of

ABSENT = "marker not visible"
UNREAD = "nobody reads what it writes"
FORCED = "forced (no skipping)"
NOTHING_BEFORE = "nothing before it changes a pixel"
NO_PRICES = Prices()


def plan_frame(
    stages: Sequence[Stage],
    levels: Mapping[str, str],
    facts: FrameFacts,
    scene: Scene,
    frame: Rect,
    skip: bool = True,
    prices: Prices = NO_PRICES,
    new: frozenset[str] = frozenset(),
) -> FramePlan:
    """The plan of one frame.

    stages : in the order in which they run;  levels : by stage name;  frame : the whole picture
    skip : False forces every stage onto the whole frame wherever a pose is known
    prices, new : what work costs here, and what of the frame's light was not met before (plan/work.py)
    """
    chosen: list[tuple[Stage, Demand]] = []
    skipped: list[Skip] = []
    for stage in stages:
        demand = _demand(stage, facts, scene, frame, skip)
        if demand.rect.empty:
            skipped.append(Skip(stage.name, demand.reason))
        else:
            chosen.append((stage, demand))
    changed = EMPTY
    for _, demand in chosen:
        if not demand.within_earlier:
            changed = changed.union(demand.rect)
    live, want, read = {Layer.IMAGE}, changed, EMPTY
    steps: list[Step] = []
    for at in range(len(chosen) - 1, -1, -1):
        stage, demand = chosen[at]
        if not stage.writes & live:
            skipped.append(Skip(stage.name, UNREAD))
            continue
        reachable = demand.rect
        if demand.within_earlier:
            reachable = EMPTY
            for _, earlier in chosen[:at]:
                if not earlier.within_earlier:
                    reachable = reachable.union(earlier.rect)
        out = want.clip(reachable)
        if out.empty:
            skipped.append(Skip(stage.name, NOTHING_BEFORE))
            continue
        level = levels[stage.name]
        need = stage.needs(out, facts, scene, level).union(out).clip(frame)
        cost = prices.predict(f"{stage.name}/{level}", terms_of(need, facts, scene, new))
        seconds, between = (None, None) if cost is None else (cost.seconds, (cost.low_s, cost.high_s))
        steps.append(Step(stage.name, level, out, need, demand.reason, seconds, between))
        read = read.union(need)
        want = want.union(need)
        live |= stage.reads
    if not any(Layer.IMAGE in s.writes for s, _ in chosen):
        return FramePlan(facts.index, EMPTY, EMPTY, (), tuple(skipped))
    written = EMPTY
    by_name = {s.name: s for s, _ in chosen}
    for step in steps:
        if Layer.IMAGE in by_name[step.stage].writes:
            written = written.union(step.out)
    return FramePlan(facts.index, read, written, tuple(reversed(steps)), tuple(skipped))


def _demand(stage: Stage, facts: FrameFacts, scene: Scene, frame: Rect, skip: bool) -> Demand:
    if not (facts.present or stage.without_object):
        return Demand(EMPTY, ABSENT)
    demand = stage.demand(facts, scene, frame)
    return demand if skip or not facts.present else Demand(frame, FORCED, demand.within_earlier)
