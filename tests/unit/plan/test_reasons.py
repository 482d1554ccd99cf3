"""Every reason for which the code can leave a stage out is given in some scene, and the
list of them is complete.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from arfx.core.facts import FrameFacts
from arfx.core.lens import LensFit
from arfx.core.light import DirectionalLight, Light
from arfx.core.pose import Pose
from arfx.core.real_depth import RealDepth, tile_ranges
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Scene
from arfx.core.stage import level_named
from arfx.plan.planner import NOTHING_BEFORE, plan_frame
from arfx.stages import STAGES
from tests.scenes import camera, facts, look_at, scene

SCENE = scene(camera(320, 240))
SEEN = facts(SCENE)
ABSENT = SEEN.with_(camera_from_world=None, opacity=0.0, model_box=EMPTY)
STAGES_DIR = Path(__file__).parents[3] / "arfx" / "stages"


def beside(s: Scene, x_m: float = 4.0) -> FrameFacts:
    """The object stands far outside the picture."""
    pose = look_at()
    f = facts(s, Pose(pose.rotation, pose.translation_m + np.array([x_m, 0.0, 0.0])))
    return f.with_(model_box=EMPTY)


def below(s: Scene) -> FrameFacts:
    """The camera is under the plane, looking up past the object."""
    return facts(s, Pose(np.diag([1.0, 1.0, 1.0]), np.array([4.0, 0.0, 0.6]))).with_(
        model_box=EMPTY
    )


def lit(
    f: FrameFacts,
    ambient: float,
    *lamps: tuple[float, float, float],
    strength: float = 0.6,
) -> FrameFacts:
    lights = tuple(DirectionalLight(d, (strength,) * 3, 4.0) for d in lamps)
    return f.with_(light=Light(ambient_rgb=(ambient,) * 3, lights=lights))


def tiny() -> Scene:
    """An object of a millimetre high above its plane takes nothing of the plane's light."""
    s = scene(camera(320, 240), fit_m=0.001)
    lifted = s.world_from_model.copy()
    lifted[2, 3] += 5.0
    return replace(s, world_from_model=lifted)


def with_depth(f: FrameFacts, depth_m: float) -> FrameFacts:
    """All of the real scene at one depth."""
    return f.with_(
        real_depth=RealDepth.of(
            0, 1.0, "", tile_ranges(np.full((240, 320), depth_m), (320, 240))
        )
    )


FAINT_LAMP = (
    0.8 * STAGES["lightmap"].faint
)  # of the plane's light; two of them show, one alone does not
FOOTAGE = {"dof": {"lens": "footage", "scope": "virtual"}}
UNKNOWN = LensFit(False, "3 edges of known distance")
OUT_OF_FOCUS = {"dof": {"scope": "virtual", "focus": "5m", "fnumber": 1.4}}
CLOSED = {"dof": {"fnumber": "inf"}}

# reason as the code writes it, numbers as #: stage, scene, facts, settings
GIVEN = {
    ("raster", "marker not visible"): (SCENE, ABSENT, {}),
    ("raster", "model out of view"): (SCENE, beside(SCENE), {}),
    ("holdout", "marker not visible"): (SCENE, ABSENT, {}),
    ("holdout", "the real scene's depth is not known"): (SCENE, SEEN, {}),
    ("hide", "marker not visible"): (SCENE, ABSENT, {}),
    ("hide", "model out of view"): (SCENE, with_depth(beside(SCENE), 0.1), {}),
    ("hide", "the real scene's depth is not known"): (SCENE, SEEN, {}),
    ("hide", "nothing real is nearer than the object's # m"): (SCENE, with_depth(SEEN, 50.0), {}),
    ("composite", "marker not visible"): (SCENE, ABSENT, {}),
    ("composite", NOTHING_BEFORE): (SCENE, beside(SCENE), {}),
    ("lightmap", "marker not visible"): (SCENE, ABSENT, {}),
    ("lightmap", "model out of view; shadow out of view"): (SCENE, beside(SCENE), {}),
    ("lightmap", "model out of view; no shadow: plane seen from behind"): (SCENE, below(SCENE), {}),
    ("lightmap", "model out of view; no shadow: the object takes at most # % of the plane's light"): (
        SCENE, beside(SCENE), {"lightmap": {"shadow_strength": 0.001}}),
    ("lightmap", "model out of view; no shadow: nowhere does the object take # % of the plane's light"): (
        tiny(), lit(beside(tiny()), 1.0, (0.0, 0.0, 1.0), (0.0, 0.01, 1.0), strength=FAINT_LAMP), {}),
    ("gi", "marker not visible"): (SCENE, ABSENT, {}),
    ("gi", "model out of view; planes left alone"): (SCENE, beside(SCENE), {"gi": {"strength": 0.0}}),
    ("gi", "model out of view; no indirect light on the plane"): (SCENE, lit(beside(SCENE), 0.0), {}),
    ("gi", "model out of view; plane out of view or seen from behind"): (SCENE, below(SCENE), {}),
    ("dof", "marker not visible"): (SCENE, ABSENT, {}),
    ("dof", "the lens of the footage was not measured"): (SCENE, SEEN, FOOTAGE),
    ("dof", "the lens cannot be measured from the footage: # edges of known distance"): (
        SCENE, SEEN.with_(lens=UNKNOWN), FOOTAGE),
    ("dof", "largest blur circle # px < # px"): (SCENE, SEEN, CLOSED),
    ("dof", "blur circles up to # px, but out of view"): (SCENE, SEEN.with_(model_box=Rect(4000, 0, 4100, 90)), OUT_OF_FOCUS),
}  # fmt: skip


def reason(name: str, s: Scene, f: FrameFacts, settings: dict) -> str | None:
    """Why the planner leaves the stage out in this frame, numbers as #."""
    lit = ("raster", "lightmap", "composite")
    deep = ("raster", "lightmap", "holdout", "hide", "composite")
    effects = {
        "gi": (*lit[:2], "gi", "composite"),
        "dof": (*lit, "dof"),
        "holdout": deep,
        "hide": deep,
    }.get(name, lit)
    stages = [STAGES[n](STAGES[n].Params(**settings.get(n, {}))) for n in effects]
    levels = {st.name: level_named(st.levels, "standard") for st in stages}
    plan = plan_frame(stages, levels, f, s, s.camera.rect)
    said = next((skip.reason for skip in plan.skipped if skip.stage == name), None)
    return None if said is None else re.sub(r"(?<![\w.])\d+(?:\.\d+)?", "#", said)


@pytest.mark.parametrize(
    ("name", "words"), GIVEN, ids=[f"{n}: {w}" for n, w in GIVEN]
)
def test_the_reason_is_given(name: str, words: str) -> None:
    assert reason(name, *GIVEN[name, words]) == words


def test_no_reason_in_the_code_is_missing_here() -> None:
    """Every text beside an EMPTY rectangle in a stage is part of some reason above."""
    known = " | ".join(words for _, words in GIVEN)
    written = []
    for path in STAGES_DIR.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        written += re.findall(r'(?:Demand\(|return )\s*EMPTY,\s*f?"([^"]+)"', text)
    assert len(written) >= 10
    for text in written:
        parts = [
            re.sub(r"\d+", "#", p.strip(" ;:%")) for p in re.split(r"\{[^}]*\}", text)
        ]
        assert all(p in known for p in parts if p), text
