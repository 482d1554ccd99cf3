"""Load compiled code while the analysis runs: a throw-away frame goes through all stages in a second thread.

Loading the kernels takes most of a second, in which the analysis would leave a core idle. Nothing is kept of the frame.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

import numpy as np

from arfx.analyse.visibility import with_model
from arfx.config.sections import JobConfig
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.pose import Pose
from arfx.core.stage import level_named
from arfx.media.frames import ClipReader
from arfx.plan.planner import plan_frame
from arfx.run.frame import Plate, run_frame
from arfx.run.inputs import Inputs, make_scene
from arfx.run.parameters import make_stages

QUICK = ("draft", "standard")  # levels whose frame is made sooner than a clip is analysed; the others share most of their code


@contextlib.contextmanager
def warming(config: JobConfig, inputs: Inputs, wanted: bool) -> Iterator[None]:
    """Warm up while the body runs; the end waits for it, but one who stops the job does not. wanted : False = do nothing."""
    if not wanted:
        yield
        return
    thread = threading.Thread(target=_quietly, args=(config, inputs), name="warm-up", daemon=True)
    thread.start()
    try:
        yield
    except Exception:
        thread.join()
        raise
    thread.join()


def _quietly(config: JobConfig, inputs: Inputs) -> None:
    with contextlib.suppress(Exception):  # what is wrong shows, with its message, where it matters
        warm_up(config, inputs)


def warm_up(config: JobConfig, inputs: Inputs) -> None:
    """Run the clip's first frame with the model before the camera through every stage of the job."""
    stages = make_stages(config)
    key = config.markers[0].key if config.markers else config.model.anchor
    scene = make_scene(config, inputs.camera, inputs.model, {key: Pose.identity()}, key, config.pipeline.seed)
    corners = scene.model_corners_m
    away_m = 4 * float(np.ptp(corners, axis=0).max())
    above = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, away_m + float(corners[:, 2].max())]))
    facts = FrameFacts(0, 0.0, status=MEASURED, camera_from_world=above, raw_camera_from_world=above, opacity=1.0)
    (facts,) = with_model([facts], scene)
    quality = config.pipeline.quality if config.pipeline.quality in QUICK else QUICK[-1]
    levels = {name: level_named(s.levels, quality) for name, s in stages.items()}
    plan = plan_frame(list(stages.values()), levels, facts, scene, scene.camera.rect)
    prepared = {s.stage: stages[s.stage].prepare(scene, levels[s.stage]) for s in plan.steps}
    with ClipReader(inputs.info) as reader:
        frame = next(reader.frames())
        if plan.steps:
            made = run_frame(Plate(plan.rect, frame.linear), facts, plan, scene, stages, levels, prepared)
            made.onto(frame, plan.changed)
