"""Decide what one frame needs: which stages, at which level, on which pixels. Pure; touches
no pixel. Each stage says what it would change, or why it does not run, and what it reads for
that; where the object is not visible, only those that can run are asked."""

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence

from arfx.core.cost import Prices
from arfx.core.facts import FrameFacts
from arfx.core.plan import FramePlan, Skip, Step
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import Demand, Stage, blamed

ABSENT = "marker not visible"
FORCED = "forced (no skipping)"
NOTHING_BEFORE = "nothing before it changes a pixel"
NO_PRICES = Prices({})


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
    read = changed = EMPTY
    steps = list[Step]()
    skipped = list[Skip]()
    for stage in stages:
        demand = _demand(stage, facts, scene, frame, skip)
        out = changed if demand.rect is None else demand.rect
        if out.empty:
            reason = NOTHING_BEFORE if demand.rect is None else demand.reason
            skipped.append(Skip(stage.name, reason))
            continue
        level = levels[stage.name]
        need = stage.needs(out, facts, scene, level).union(out).clip(frame)
        cost = prices.predict(
            f"{stage.name}/{level}", terms_of(need, facts, scene, new)
        )
        steps.append(Step(stage.name, level, out, need, demand.reason, cost))
        read, changed = read.union(need), changed.union(out)
    return FramePlan(facts.index, read, changed, tuple(steps), tuple(skipped))


def _demand(
    stage: Stage, facts: FrameFacts, scene: Scene, frame: Rect, skip: bool
) -> Demand:
    if not (facts.present or stage.without_object):
        return Demand(EMPTY, ABSENT)
    if facts.present and not skip:
        return Demand(frame, FORCED)
    with blamed(stage, f"when frame {facts.index} is planned"):
        demand = stage.demand(facts, scene, frame)
        if not isinstance(demand, Demand):
            raise TypeError(
                f"its demand is a {type(demand).__name__}; it must be a Demand(rect, reason)"
            )
        return demand


def terms_of(
    need: Rect, facts: FrameFacts, scene: Scene, new: frozenset[str] = frozenset()
) -> dict[str, float]:
    """Work of a step in the terms of the price list (core/cost.py).

    new : of `new_terms`, those of the frame
    """
    lamps = float(
        sum(any(c > 0 for c in li.rgb) for li in scene.light_of(facts).lights)
    )
    object_mpx = facts.model_box.clip(need).area / 1e6 if facts.visible else 0.0
    return {
        "frames": 1.0,
        "mpx": need.area / 1e6,
        "object_mpx": object_mpx,
        "texture_mpx": scene.model.textures_per_face * object_mpx,
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
