"""What the rows of a whole clip mean: its analysis, step by step.

Cost: about .5 ms per frame. Source: docs/methods/."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.analyse.depth.plane_pose import plane_poses, with_real_planes
from arfx.analyse.depth.scale import depth_checks, with_depth
from arfx.analyse.job import PLANE, Analysis, AnalysisJob
from arfx.analyse.lens import with_lens
from arfx.analyse.light.frames import Reading, with_light
from arfx.analyse.light.observe import (
    BackgroundChange,
    environment_samples,
    light_checks,
)
from arfx.analyse.light.seen import Snapshot, given_everywhere, with_seen
from arfx.analyse.light.surroundings import EnvironmentSample, with_environment
from arfx.analyse.markers.search import (
    FrameRow,
    OtherPrint,
    Sighting,
    choose_transfer,
    nothing_seen,
    pattern_checks,
    pattern_misfits,
    records,
)
from arfx.analyse.motion.advection import AROUND, with_advection
from arfx.analyse.motion.flow import KeyPicture, MotionStep, joined_steps
from arfx.analyse.observe import ClipRows
from arfx.analyse.pose.at_rest import FlowSample, RestPicture
from arfx.analyse.pose.figures import pose_checks
from arfx.analyse.pose.solve import solve_poses
from arfx.analyse.pose.visibility import with_model
from arfx.core.facts import FrameFacts
from arfx.core.stage import Check


def analyse(
    rows: ClipRows,
    job: AnalysisJob,
    wanted: Collection[str] = (),
    frame_span: tuple[list[float], int, bool] = ([], 0, True),
) -> Analysis:
    """rows : of `observe.Observation`, of all parts of the clip, in order;  wanted : facts, by
    name, beside the poses;  frame_span : as of Analysis

    Raises NothingToDoError where nothing was seen to stand on."""
    whole = Analysis(frame_span=frame_span)
    on_plane = job.anchor == PLANE
    clip = (
        plane_poses(whole, job, rows[RestPicture])
        if on_plane
        else marker_poses(whole, rows, job)
    )
    if {"light", "environment"} & {*wanted}:
        snapshots = rows[Snapshot]
        samples = environment_samples(snapshots, clip, job.camera)
        clip = lit(clip, rows, samples, job)
        if "environment" in wanted:
            clip = surrounded(clip, snapshots, samples, job)
    if "flow" in wanted:
        clip = moved(clip, rows, job)
    if "lens" in wanted and not on_plane:
        clip = with_lens(clip, rows[Sighting], job.markers)
    if job.scene is not None and "object" in wanted:
        clip = clip.adding(with_model(clip.facts, job.scene(clip)))
    if job.depth is not None and {"depth", "planes"} & {*wanted}:
        clip = with_depth(clip, job, job.depth, job.depth.of_frames(*clip.frame_span))
    if "planes" in wanted:
        clip = with_real_planes(clip, job)
    return clip


def marker_poses(clip: Analysis, rows: ClipRows, job: AnalysisJob) -> Analysis:
    """The camera's path over the markers.

    Raises NothingToDoError if no configured marker was ever seen, saying what was."""
    frames, prints, others = rows[FrameRow], rows[Sighting], rows[OtherPrint]
    camera = job.camera.scaled_to(frames[0].width, frames[0].height)
    if not prints:
        raise nothing_seen(job.markers, len(frames), others)
    transfer = choose_transfer(prints)
    seen = records(frames, prints, transfer)
    background = rows[FlowSample]
    found = solve_poses(
        seen, job.markers, camera, job.params, job.marker_map, background
    )
    shown = {(s.frame, s.print.key) for s in prints}
    twice = [o.key for o in others if (o.frame, o.key) in shown]
    notice = (
        f"two prints of the same id in a frame ({', '.join(sorted({*twice}))},"
        f" {len(twice)} times): the one that moves on from the frame before is followed"
    )
    found = found.adding(
        notice=notice if twice else None,
        edge_transfer=transfer,
        pattern_misfit_px=pattern_misfits(prints, job.prints),
    )
    return replace(found, frame_span=clip.frame_span)


def lit(
    clip: Analysis,
    rows: ClipRows,
    samples: Sequence[EnvironmentSample],
    job: AnalysisJob,
) -> Analysis:
    """Every frame's light: read on the prints, guessed from the surroundings, or given."""
    readings = rows[Reading]
    if job.light_method is not None:
        return job.light_method(clip, readings, samples, job.light, job.panorama)
    return with_light(
        clip,
        readings,
        samples,
        job.light,
        job.panorama,
        changes=dict(rows[BackgroundChange]),
        place_m=lambda: object_place_m(clip, job),
    )


def object_place_m(clip: Analysis, job: AnalysisJob) -> ndarray:
    """(2,) middle of the object, anchor axes."""
    if job.scene is None:
        return np.zeros(2)
    scene = job.scene(clip)
    points = scene.world_from_anchor.inverse().apply(scene.model_points_m)
    return np.asarray(points.min(0) + points.max(0))[:2] / 2


def surrounded(
    clip: Analysis,
    snapshots: Sequence[Snapshot],
    samples: Sequence[EnvironmentSample],
    job: AnalysisJob,
) -> Analysis:
    """The surroundings, for reflections: a guess of all of them, and what was seen of them."""
    anchor, still_camera = clip.world_from_anchor, clip.static == "camera"
    if job.panorama is not None:
        facts, maps = given_everywhere(clip.facts, job.panorama, anchor.rotation)
    else:
        facts, maps = with_seen(
            with_environment(clip.facts, samples, still_camera),
            snapshots,
            job.camera,
            still_camera,
            anchor.translation_m,
            anchor.rotation[:, 2],
        )
    return replace(clip.adding(facts), environment_maps=maps)


def moved(clip: Analysis, rows: ClipRows, job: AnalysisJob) -> Analysis:
    """How the background moves, for what is to lie still on it."""
    pictures = rows[KeyPicture]
    camera = job.camera.scaled_to(pictures[0].width, pictures[0].height)
    steps = joined_steps(rows[MotionStep], pictures)
    reach_m = AROUND * clip.anchor.size_m
    return clip.adding(
        with_advection(clip.facts, steps, camera, clip.world_from_anchor, reach_m)
    )


def checks(
    facts: Sequence[FrameFacts], summary: Mapping[str, Any]
) -> Iterator[Check]:
    """The health of all estimates, from what they left in the clip."""
    yield from pattern_checks(summary)
    yield from pose_checks(facts, summary)
    yield from light_checks(summary)
    yield from depth_checks(summary)
