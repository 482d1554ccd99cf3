"""Real depth to the facts, with one factor for the whole clip, from the markers: their
distance is known in metres.

Source: docs/methods/calibration.md#depth."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.job import Analysis, AnalysisJob
from arfx.core.camera import Camera
from arfx.core.codec import Document
from arfx.core.facts import MEASURED, FrameFacts
from arfx.core.machine import usable_cores
from arfx.core.numerics import divide
from arfx.core.pose import Pose
from arfx.core.real_depth import TYPICAL_NOISE, RealDepth, tile_ranges
from arfx.core.stage import Check
from arfx.errors import InputError

FEWEST_PX = 24  # measured pixels on a print
FEWEST_FRAMES = 3  # or all of a shorter clip
MOST_SPREAD = 0.1  # robust standard deviation of a frame's factor, relative
_INNER = 0.9  # of the print's square, so that no pixel of its edge counts
_SIGMA = 1.4826  # of a normal distribution, by its median absolute deviation


@dataclass(frozen=True, slots=True)
class DepthScale(Document):
    """known : whether the markers tell;  scale : metres of a map to true ones, 1 where not
    known;  reason : in words

    spread : robust standard deviation of a frame's factor, relative;  residual : median
    over the prints' pixels of how
    much a scaled map misses the marker's plane, relative;  frames : that tell"""

    known: bool
    reason: str
    scale: float = 1.0
    spread: float | None = None
    residual: float | None = None
    frames: int = 0

    @property
    def noise(self) -> float:
        """Standard deviation of a pixel, share of its distance."""
        return TYPICAL_NOISE if self.residual is None else _SIGMA * self.residual


def depth_checks(summary: Mapping[str, Any]) -> Iterator[Check]:
    """How well the scale of real depth fits the markers' planes."""
    depth = summary.get("depth")
    if depth is None:
        return
    missed = "as stated" if depth["residual"] is None else depth["residual"]
    yield Check(
        "real depth: miss of the markers' planes",
        missed if depth["known"] else depth["reason"],
        0.1,
        depth["known"],
        "not used: the real scene is the markers' planes",
    )
    if depth["known"]:
        without = depth["frames_without"]
        yield Check(
            "frames without real depth",
            without,
            0,
            without == 0,
            "markers' planes there",
        )


def print_ratios(
    depth_m: ndarray,
    facts: FrameFacts,
    world_from_marker: Mapping[str, Pose],
    camera: Camera,
) -> ndarray:
    """(n,) known over measured distance of the pixels on the prints that the frame shows; n
    = 0 where none is usable.

    depth_m : (h, w) metres, 0 = unknown, any size of the frame's shape"""
    pose = facts.camera_from_world
    out = [np.zeros(0)]
    if pose is None or facts.status != MEASURED:
        return out[0]
    h, w = depth_m.shape
    own, scale = camera.scaled_to(w, h), [w / camera.width, h / camera.height]
    for seen in facts.markers:
        if seen.key not in world_from_marker:
            continue
        corners = np.asarray(seen.corners_px, float)
        middle = corners.mean(0)
        inner = (middle + _INNER * (corners - middle) + 0.5) * scale - 0.5
        mask = np.zeros((h, w), np.uint8)
        cv2.fillConvexPoly(mask, np.rint(inner).astype(np.int32), (1,))
        y, x = np.nonzero((mask > 0) & (depth_m > 0))
        if len(y) < FEWEST_PX:
            continue
        here = pose @ world_from_marker[seen.key]
        normal = here.rotation[:, 2]
        rays = own.directions(np.stack([x, y], -1).astype(float))
        # the plane's z along each pixel's ray, over the measured one
        ratio = divide(normal @ here.translation_m, rays @ normal * depth_m[y, x])
        out.append(ratio[ratio > 0])
    return np.concatenate(out)


def depth_scale(ratios: Sequence[ndarray]) -> DepthScale:
    """From the `print_ratios` of every frame that has a map."""
    telling = [r for r in ratios if len(r) >= FEWEST_PX]
    wanted = min(FEWEST_FRAMES, max(len(ratios), 1))
    if len(telling) < wanted:
        return DepthScale(
            False,
            f"{len(telling)} frames have depth on a marker's print, at least {wanted} are"
            " needed",
            frames=len(telling),
        )
    middles = np.log([np.median(r) for r in telling])
    scale = float(np.exp(np.median(middles)))
    spread = float(_SIGMA * np.median(np.abs(middles - np.median(middles))))
    residual = float(np.median([np.median(np.abs(r / scale - 1)) for r in telling]))
    if spread > MOST_SPREAD or residual > MOST_SPREAD:
        return DepthScale(
            False,
            f"depth on the markers is {100 * max(spread, residual):.0f} % off any one"
            " scale: not proportional to distance",
            1.0,
            spread,
            residual,
            len(telling),
        )
    words = (
        f"scale {scale:.4g}, {100 * spread:.1f} % from frame to frame, from {len(telling)}"
        " frames"
    )
    return DepthScale(True, words, scale, spread, residual, len(telling))


def with_depth(
    clip: Analysis, job: AnalysisJob, maps: Any, of_frames: Sequence[int | None]
) -> Analysis:
    """The facts with `real_depth`, and a summary for the report.

    of_frames : number of each frame's map
    Raises InputError for a map that cannot be read, and where no map holds a valid pixel.
    """
    frames_of: dict[int, list[int]] = {}
    for n, k in enumerate(of_frames):
        if k is not None:
            frames_of.setdefault(k, []).append(n)
    used = sorted(frames_of)
    if not used:
        raise InputError(
            f"depth {maps.path}: no map was taken near the time of any frame",
            "--set input.depth_start shifts them",
        )
    facts, camera = clip.facts, job.camera
    size = camera.width, camera.height

    def read(number: int) -> tuple[str, ndarray | None, float, list[ndarray]]:
        """Of one map its digest, `tile_ranges` before scaling (None = nothing was
        measured), share of holes, `print_ratios`.
        """
        depth = maps.load(number, *size)
        known = float((depth > 0).mean())
        tiles = tile_ranges(depth, size) if known > 0 else None
        ratios = [
            print_ratios(depth, facts[n], clip.world_from_marker, camera)
            for n in frames_of[number]
        ]
        return maps.digest(number), tiles, 1 - known, ratios

    readings = []
    with ThreadPoolExecutor(min(usable_cores(), 4)) as pool:
        for reading in pool.map(read, used):
            readings.append(reading)
            job.progress("depth", len(readings), len(used))
    if all(tiles is None for _, tiles, _, _ in readings):
        raise InputError(
            f"depth {maps.path} holds no valid pixel: all are 0, not finite or the largest"
            " value",
            "is it depth?",
        )
    scale = (
        depth_scale([r for *_, ratios in readings for r in ratios])
        if job.align
        else DepthScale(True, "taken as stated")
    )
    out = list(facts)
    for number, (digest, tiles, _, _) in zip(used, readings, strict=True):
        if scale.known and tiles is not None:
            tiles = (tiles / scale.scale).astype(np.float32)
            depth = RealDepth.of(number, scale.scale, digest, tiles, scale.noise)
            for n in frames_of[number]:
                out[n] = out[n].with_(real_depth=depth)
    got = sum(f.real_depth is not None for f in out)
    paired = (
        "one map for all"
        if maps.still
        else "order"
        if maps.times_s is None
        else "time"
    )
    holes = float(np.mean([reading[2] for reading in readings]))
    summary = {
        "path": str(maps.path),
        "maps": maps.count,
        "paired_by": paired,
        "frames_with": got,
        "frames_without": len(facts) - got,
        "holes": holes,
        **scale.to_json(),
    }
    notice = None if scale.known else f"the real depth is not used: {scale.reason}"
    return clip.adding(out, notice, depth=summary)
