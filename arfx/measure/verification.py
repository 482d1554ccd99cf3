"""Runs a synthetic scene through the whole job and holds it against its truth and the
bounds beside it.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from arfx.analyse.pose.planar import both_poses
from arfx.config.load import load
from arfx.core import interrupt
from arfx.core.camera import Camera
from arfx.core.facts import read_facts
from arfx.core.marker import MarkerSpec
from arfx.core.marker_codes import dictionary
from arfx.core.opener import parse_toml, read_text
from arfx.core.pose import Pose
from arfx.core.waiting import Notice, Progress
from arfx.errors import ConfigError, InputError, NothingToDoError
from arfx.measure.truth import compare, exceeded, world_key
from arfx.media.clip import probe
from arfx.media.frames import ClipReader
from arfx.run.folder import JobFolder
from arfx.run.job import Options, process
from arfx.run.parameters import parameters
from arfx.run.planned import ClipAnalysis
from arfx.synth.clip import make_clip
from arfx.synth.description import load_scene
from arfx.synth.truth import read_truth


@dataclass(frozen=True)
class Verified:
    """figures : see arfx.measure.truth.compare, and "times";  broken : sentences;  output :
    the processed clip
    """

    figures: dict[str, Any]
    broken: list[str]
    output: Path
    report: dict[str, Any]


def verify(
    folder: Path,
    work: Path,
    progress: Progress,
    notice: Notice,
    workers: int = 1,
) -> Verified:
    """Verify a folder made by `arfx synth`, or a scene folder (scene.toml), which is
    rendered first.

    folder : tolerance.toml in it gives the bounds (none: nothing is bounded)
    work : an existing folder for what is made on the way, a clip that is there is used
    Raises InputError if the folder holds neither truth nor scene."""
    made = folder
    if not (folder / "truth.jsonl").is_file():
        if not (folder / "scene.toml").is_file():
            raise InputError(
                f"{folder} holds neither truth.jsonl nor scene.toml",
                "a folder made by `arfx synth`, or one of sample_scenes/",
            )
        made = work / "synth"
        if not (made / "truth.jsonl").is_file():
            make_clip(
                load_scene(folder / "scene.toml"),
                made,
                folder,
                progress,
                overwrite=True,
                truth_pictures=False,
            )
    truth = read_truth(made / "truth.jsonl")
    if truth.world is None:
        why = "the scene has no configured marker, there is no pose to verify"
        raise NothingToDoError(f"{made}: {why}")
    bounds = read_tolerance(folder).get("truth", {})
    # lossless, so that what is judged does not depend on an encoder's settings
    output = {"path": str(work / "out.mkv"), "codec": "ffv1"}
    config = load(made / "job.toml", {"output": output}, parameters())
    job = JobFolder(work / "job")
    options = Options(
        job.path, overwrite=True, workers=workers, progress=progress, notice=notice
    )
    report = process(config, options)
    interrupt.resume()
    facts = list(read_facts(job.facts))
    if len(facts) != len(truth.frames):
        raise InputError(
            f"{made}: the clip has {len(facts)} frames, its truth {len(truth.frames)}",
            "make it again",
        )
    analysed = ClipAnalysis.read(job)
    key = world_key(analysed.world_from_marker, truth)
    family, number = key.split(":")
    assert config.input.clip is not None
    inputs = json.loads(job.inputs.read_text(encoding="utf-8"))
    plain = single_frame_poses(
        config.input.clip,
        Camera.from_json(inputs["camera"]),
        MarkerSpec(family, int(number), truth.header["markers"][key]),
    )
    figures = compare(facts, analysed.world_from_marker, truth, plain)
    figures["static"] = analysed.static
    figures["time_error_s"] = max(
        abs(f.time_s - t.time_s) for f, t in zip(facts, truth.frames, strict=True)
    )
    return Verified(figures, exceeded(figures, bounds), work / "out.mkv", report)


def read_tolerance(folder: Path) -> dict[str, Any]:
    """tolerance.toml of a scene, {} if there is none. Raises ConfigError if it is not TOML."""
    path = folder / "tolerance.toml"
    if not path.is_file():
        return {}
    try:
        return parse_toml(read_text(path, "scene"))
    except ValueError as e:
        raise ConfigError(f"{path} is not TOML: {e}") from None


def single_frame_poses(
    clip: Path, camera: Camera, marker: MarkerSpec
) -> list[Pose | None]:
    """What plain OpenCV finds, frame by frame: whole-frame detection with sub-pixel
    corners, IPPE, the better solution.

    camera_from_marker, None where the marker is not found."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(dictionary(marker.family), settings)
    out = list[Pose | None]()
    with ClipReader(probe(clip)) as reader:
        for frame in reader.frames():
            luma = np.ascontiguousarray(frame.luma())
            corners, ids, _ = detector.detectMarkers(luma)
            numbers = [] if ids is None else ids.ravel().tolist()
            poses = np.zeros((0, 2, 3))
            if marker.id in numbers:
                found = corners[numbers.index(marker.id)].reshape(4, 2).astype(float)
                poses = both_poses(marker.corners_m, camera.normalised(found))
            out.append(Pose.from_rotvec(*poses[0]) if len(poses) else None)
    return out
