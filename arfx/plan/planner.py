"""Decide what one frame needs: which stages, at which level, on which pixels. Pure; touches
no pixel.

1. demand: each stage says what it would change, or why it does not run; where the object is
   not visible, only those that can
2. unread: walking backwards from the image, a stage that writes nothing anyone reads is dropped
3. rectangles: the same walk carries one growing rectangle of wanted pixels"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from functools import reduce

from arfx.core.cost import Prices
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer
from arfx.core.plan import FramePlan, Skip, Step
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, blamed

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
    prices, new : what work costs here, and the terms (`new_terms`) of light that was not met before
    """
    chosen: list[tuple[Stage, Demand]] = []
    skipped: list[Skip] = []
    for stage in stages:
        demand = _demand(stage, facts, scene, frame, skip)
        if demand.rect.empty:
            skipped.append(Skip(stage.name, demand.reason))
        else:
            chosen.append((stage, demand))
    live, want, read, written = {Layer.IMAGE}, _changed(chosen), EMPTY, EMPTY
    steps: list[Step] = []
    for at in range(len(chosen) - 1, -1, -1):
        stage, demand = chosen[at]
        if not stage.writes & live:
            skipped.append(Skip(stage.name, UNREAD))
            continue
        out = want.clip(_changed(chosen[:at]) if demand.within_earlier else demand.rect)
        if out.empty:
            skipped.append(Skip(stage.name, NOTHING_BEFORE))
            continue
        level = levels[stage.name]
        need = stage.needs(out, facts, scene, level).union(out).clip(frame)
        cost = prices.predict(f"{stage.name}/{level}", terms_of(need, facts, scene, new))
        seconds, between = (
            (None, None) if cost is None else (cost.seconds, (cost.low_s, cost.high_s))
        )
        steps.append(Step(stage.name, level, out, need, demand.reason, seconds, between))
        read = read.union(need)
        want = want.union(need)
        live |= stage.reads
        if Layer.IMAGE in stage.writes:
            written = written.union(out)
    if not any(Layer.IMAGE in s.writes for s, _ in chosen):
        return FramePlan(facts.index, EMPTY, EMPTY, (), tuple(skipped))
    return FramePlan(facts.index, read, written, tuple(reversed(steps)), tuple(skipped))


def _changed(chosen: Sequence[tuple[Stage, Demand]]) -> Rect:
    """What the stages change by themselves."""
    return reduce(
        Rect.union,
        (demand.rect for _, demand in chosen if not demand.within_earlier),
        EMPTY,
    )


def _demand(
    stage: Stage, facts: FrameFacts, scene: Scene, frame: Rect, skip: bool
) -> Demand:
    if not (facts.present or stage.without_object):
        return Demand(EMPTY, ABSENT)
    with blamed(stage, f"when frame {facts.index} is planned"):
        demand = stage.demand(facts, scene, frame)
    return (
        demand
        if skip or not facts.present
        else Demand(frame, FORCED, demand.within_earlier)
    )


def terms_of(
    need: Rect, facts: FrameFacts, scene: Scene, new: frozenset[str] = frozenset()
) -> dict[str, float]:
    """Work of a step in the terms of the price list (core/cost.py).

    new : of `new_terms`, those of the frame
    """
    lamps = float(sum(any(c > 0 for c in li.rgb) for li in scene.light_of(facts).lights))
    object_mpx = facts.model_box.clip(need).area / 1e6 if facts.visible else 0.0
    return {
        "frames": 1.0,
        "mpx": need.area / 1e6,
        "object_mpx": object_mpx,
        "lamps": lamps,
        "lamp_mpx": lamps * object_mpx,
        "depth_mpx": 0.0 if facts.real_depth is None else need.area / 1e6,
        "mfaces": scene.model.face_count / 1e6,
        **{name: 1.0 for name in sorted(new)},
    }


def new_terms(
    stages: Iterable[Stage], facts: Iterable[FrameFacts]
) -> Iterator[frozenset[str]]:
    """Of each frame, in order: the terms (`Stage.once`) whose work has not been done yet,
    because its light is new.
    """
    every: list[Stage] = list(stages)
    done: set[tuple[str, Hashable]] = set()
    for f in facts:
        new = (
            {item for stage in every for item in stage.once(f).items()} - done
            if f.visible
            else set()
        )
        done |= new
        yield frozenset(name for name, _ in new)
