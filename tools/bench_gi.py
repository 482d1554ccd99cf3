"""Cost of `gi` where exactly a given share of the picture is affected.

    python tools/bench_gi.py [--share 0.3] [--size 640x480 --size 1280x720] [--runs 9]

Affected is a pixel that the object covers, or whose plane changes by half a grey level or
more. The benchmark's ball is brought as near as that takes. Times are medians of turns with
the yardstick of `arfx bench` (one Gaussian blur, float32, 3 channels, sigma 5, of the whole
picture), at a light that stands still (what bounces is kept), and for a light never seen
before."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from arfx.core.layers import Layer, Layers
from arfx.core.stage import ReadyStage, level_named
from arfx.measure.bench_scene import BenchScene, bench_scene
from arfx.plan.planner import plan_frame
from arfx.run.frame import FrameLayers
from arfx.stages import STAGES
from arfx.stages.gi import Gi
from arfx.stages.light.planes import SHOWS
from arfx.stages.lightmap import Lightmap
from arfx.stages.raster import Raster


def layers_of(at: BenchScene) -> Layers:
    """What gi reads, over all that it needs."""
    lit = Lightmap()
    lit.soft = False
    stages: list[Any] = [
        Raster(),
        lit,
        Gi(),
        STAGES["composite"](),
    ]
    levels = {s.name: level_named(s.levels, "standard") for s in stages}
    plan = plan_frame(stages, levels, at.facts, at.scene, at.scene.camera.rect)
    layers = FrameLayers(at.plate, at.scene.camera.rect)
    steps = {step.stage: step for step in plan.steps}
    for s in stages[:2]:
        step = steps[s.name]
        made = ReadyStage.of(s, at.scene, levels[s.name]).run(
            layers.view(step.need), at.facts
        )
        for layer, array in made.items():
            layers.put(layer, array, step.need, step.out)
    return layers.view(steps["gi"].need)


def affected(before: Layers, made: Any, size: tuple[int, int]) -> float:
    shadow = Layers(before.rect, {Layer.SHADOW: made[Layer.SHADOW]})[Layer.SHADOW]
    change = np.abs(shadow - before[Layer.SHADOW]).max(-1) >= SHOWS
    return float(((before[Layer.COVERAGE] > 0) | change).sum() / (size[0] * size[1]))


def scene_with(share: float, size: tuple[int, int]) -> tuple[BenchScene, float]:
    """The bench scene with `share` of the picture affected at level standard, by bisection
    of how much the ball covers.
    """
    low, high = 0.01, 0.6
    for _ in range(12):
        covered = (low + high) / 2
        at = bench_scene(*size, covered)
        got = affected(layers_of(at), once(at, "standard")[0](), size)
        low, high = (covered, high) if got < share else (low, covered)
        if abs(got - share) < 0.002:
            break
    return at, got


def once(at: BenchScene, level: str) -> tuple[Any, Any]:
    """(a call that runs the stage, one that runs it under a light it has not seen)."""
    now = layers_of(at)
    stage = Gi()
    ready = ReadyStage.of(stage, at.scene, level_named(stage.levels, level))
    count = [0]

    def go(facts: Any = at.facts) -> Any:
        return ready.run(now, facts)

    def other() -> Any:
        count[0] += 1
        return go(
            replace(
                at.facts,
                light=at.scene.light.scaled(np.full(3, 1.1 ** (count[0] % 40))),
            )
        )

    return go, other


def timed(share: float, size: tuple[int, int], levels: list[str], runs: int) -> None:
    at, got = scene_with(share, size)
    picture = np.random.default_rng(1).random((size[1], size[0], 3), np.float32)
    for level in levels:
        go, other = once(at, level)
        go()
        other()
        seconds = np.empty((runs, 3))
        for k in range(runs):
            for i, call in enumerate(
                (go, other, lambda: cv2.GaussianBlur(picture, (0, 0), 5))
            ):
                start = time.perf_counter()
                call()
                seconds[k, i] = time.perf_counter() - start
        still, new, yard = np.median(seconds, 0)
        print(
            f"{size[0]}x{size[1]} {level}: {100 * got:.1f} % affected, {still / yard:.1f}"
            f" yardsticks, {new / yard:.1f} under a new light ({1e3 * still:.0f} ms,"
            f" yardstick {1e3 * yard:.1f} ms)",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--share", type=float, default=0.3)
    parser.add_argument("--size", action="append", metavar="WxH")
    parser.add_argument("--level", action="append")
    parser.add_argument("--runs", type=int, default=9)
    given = parser.parse_args()
    for size in given.size or ["640x480", "1280x720"]:
        width, height = (int(v) for v in size.split("x"))
        timed(
            given.share,
            (width, height),
            given.level or ["draft", "standard"],
            given.runs,
        )


if __name__ == "__main__":
    main()
