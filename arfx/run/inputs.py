"""Everything that a job reads, opened and checked before any work starts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy import ndarray

from arfx.analyse.markers.pattern import check_turned, coded_luma
from arfx.config.sections import JobConfig, PatternSection
from arfx.core.camera import Camera
from arfx.core.colour import Transfer
from arfx.core.light import Light
from arfx.core.marker import MarkerSpec, anchor_marker
from arfx.core.model import Model
from arfx.core.opener import parse_json, parse_toml, read_text, regular
from arfx.core.pose import Pose, rotation_from_euler_deg, rotation_from_quaternion
from arfx.core.real_depth import RealPlane
from arfx.core.scene import Placement, Scene
from arfx.core.units import MAX_LENGTH_M, length_m
from arfx.core.waiting import Progress, wait_for
from arfx.errors import ConfigError, InputError
from arfx.media.cameras import (
    calibration_claims,
    camera_warnings,
    load_camera,
)
from arfx.media.clip import ClipInfo, probe
from arfx.media.depth_maps import DepthMaps, open_depth
from arfx.media.images import load_image, load_print
from arfx.media.models import load_model
from arfx.media.output import OutputPlan, OutputSettings, plan_output
from arfx.media.pose_files import CameraPath, load_poses
from arfx.run.parameters import quality_notices, with_machine_settings

CARD = 0.17  # of the print's side: what a sheet that is held in the hand has beyond it, at least


@dataclass(frozen=True, eq=False)
class Inputs:
    """prints : pictures of the job's patterns by key, (h, w, 3) linear"""

    config: JobConfig
    info: ClipInfo
    camera: Camera
    model: Model
    marker_map: Mapping[str, Pose] | None
    output: OutputPlan
    notices: tuple[str, ...]
    panorama: ndarray | None
    depth: DepthMaps | None
    poses: CameraPath | None
    prints: Mapping[str, ndarray]


def open_inputs(config: JobConfig, progress: Progress = lambda *_: None) -> Inputs:
    """Probe, load and check. progress : as of `wait_for`, while the model is read
    Raises ConfigError for what is missing, InputError for what cannot be read."""
    check_complete(config)
    clip, camera, notices = open_clip(config)
    assert config.output.path is not None
    settings = OutputSettings(
        config.output.codec,
        config.output.crf,
        config.output.preset,
        config.output.pixel_format,
    )
    output = plan_output(clip, config.output.path, settings)
    config, prints = job_prints(config)
    model = wait_for("model", lambda: job_model(config), progress)
    Scene(
        camera, model, placement(config).world_from_model(model, config.model.up)
    ).check_extent()
    maps = job_depth(config)
    if (
        maps is not None
    ):  # an error in all of them is reported before the clip is analysed
        maps.load(0, clip.width, clip.height)
    return Inputs(
        with_machine_settings(config),
        clip,
        camera,
        model,
        marker_map(config),
        output,
        (*notices, *model.notices, *output.notices, *quality_notices(config)),
        panorama(config),
        maps,
        None if config.input.poses is None else load_poses(config.input.poses),
        prints,
    )


def check_complete(config: JobConfig) -> None:
    """What has to be named is. Raises ConfigError; reads nothing."""
    if config.input.clip is None:
        raise ConfigError("no clip is named", "arfx process CLIP …")
    if config.model.anchor == "plane":
        if config.input.depth is None:
            raise ConfigError(
                "--anchor plane needs the depth that shows the plane",
                "--depth DIR|FILE",
            )
    elif not config.markers:
        raise ConfigError(
            "no marker is named",
            "--marker FAMILY:ID:SIZE, or --pattern IMAGE:SIZE; `arfx inspect CLIP` finds"
            " out which marker is there",
        )
    keys = [m.key for m in config.markers]
    if twice := [k for k in keys if keys.count(k) > 1]:
        pattern = any(p.key == twice[0] for p in config.patterns)
        once = (
            "each picture once, and no two of one name"
            if pattern
            else "each family and id once"
        )
        raise ConfigError(
            f"{'pattern' if pattern else 'marker'} {twice[0]} is named twice", once
        )
    if config.model.file is None:
        raise ConfigError(
            "no model is named", "--model FILE: glTF/GLB, OBJ, PLY, STL …"
        )
    if config.output.path is None:
        raise ConfigError("no output is named", "-o out.mp4")


def job_prints(config: JobConfig) -> tuple[JobConfig, dict[str, ndarray]]:
    """The job with the heights of its patterns, and their pictures by key.
    Raises InputError, and ConfigError for one that looks the same turned."""
    specs, prints, light = [], {}, config.params["light"]
    for spec in config.patterns:
        prints[spec.key], shape = load_print(spec.image)
        check_turned(spec.key, coded_luma(prints[spec.key], light.ink, light.paper))
        specs.append(
            spec if spec.height_m else replace(spec, height_m=spec.size_m * shape)
        )
    return (
        config.model_copy(
            update={"pattern": tuple(PatternSection(spec=s) for s in specs)}
        ),
        prints,
    )


def job_depth(config: JobConfig) -> DepthMaps | None:
    """The job's depth maps, listed; None where it has none. Raises InputError."""
    i = config.input
    return (
        None
        if i.depth is None
        else open_depth(i.depth, i.depth_scale, float(i.depth_start or 0.0))
    )


def panorama(config: JobConfig) -> ndarray | None:
    """(h, w, 3) linear radiance of the job's environment picture. Raises InputError."""
    path = config.params["light"].environment
    if path is None:
        return None
    picture = load_image(path)
    if not np.isfinite(picture).all() or picture.min() < 0:
        raise InputError(
            f"environment {path} holds values that are not finite and >= 0",
            "an HDR picture of radiance",
        )
    if abs(picture.shape[1] - 2 * picture.shape[0]) > 2:
        size = f"{picture.shape[1]}x{picture.shape[0]}"
        raise InputError(
            f"environment {path} is {size}, not twice as wide as high",
            "an equirectangular panorama",
        )
    return picture


def job_model(config: JobConfig) -> Model:
    """The job's model; read once in a process, unless the file changes.

    Raises as load_model does.
    """
    path = config.model.file
    assert path is not None
    stat = regular(path, "model").stat()
    # absolute, as in the frozen job: a worker of this process asks for the same file and
    # gets the same model
    return _model_of(path.absolute(), config.model.up, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=1)
def _model_of(path: Path, up: str | None, time_ns: int, size: int) -> Model:
    return load_model(path, up)


def open_clip(config: JobConfig) -> tuple[ClipInfo, Camera, list[str]]:
    """Clip and camera at the clip's size, with notices."""
    assert config.input.clip is not None
    info = probe(config.input.clip, Transfer(config.input.transfer))
    notices = list(info.notices)
    if config.input.camera is None:
        camera = Camera.guess(info.width, info.height, pixel_aspect=info.pixel_aspect)
        notices.append(
            f"no --camera: the focal length is a guess ({camera.fx:.0f} px,"
            f" {camera.source}); sizes and perspective may be off"
        )
    else:
        loaded = load_camera(config.input.camera)
        notices += camera_warnings(loaded, calibration_claims(config.input.camera))
        camera = loaded.scaled_to(info.width, info.height, info.pixel_aspect)
        if camera is not loaded:
            notices.append(
                f"camera calibration scaled from {loaded.width}x{loaded.height} to"
                f" {info.width}x{info.height}"
            )
    return info, camera, notices


def placement(config: JobConfig) -> Placement:
    m = config.model
    if m.fit is not None and m.fit <= 0:
        raise ConfigError(f"--fit must be above 0, is {m.fit:g} m")
    return Placement(m.scale, m.fit, m.rotate, m.offset)


def make_scene(
    config: JobConfig,
    camera: Camera,
    model: Model,
    world_from_marker: Mapping[str, Pose],
    anchor: str,
    static: str,
    real_planes: Sequence[RealPlane] = (),
) -> Scene:
    """The scene of a job. anchor : key of the marker under the model. The default light
    hangs above it.

    real_planes : of the real scene, measured
    static : what is at rest (Analysis.static). A marker that is moved before a camera at
    rest is a sheet or a card: its
    surface ends a little beyond the print."""
    world_from_anchor = world_from_marker.get(anchor, Pose.identity())
    corners_m = (
        anchor_marker(config.markers, (anchor,)).corners_m
        if config.markers
        else np.zeros((4, 3))
    )
    x, y, _ = ((1 + 2 * CARD) * corners_m.max(0)).tolist()
    world_from_model = world_from_anchor.matrix @ placement(config).world_from_model(
        model, config.model.up
    )
    return Scene(
        camera,
        model,
        world_from_model,
        config.markers,
        dict(world_from_marker),
        world_from_anchor,
        Light().turned(world_from_anchor.rotation),
        config.pipeline.seed,
        (-x, -y, x, y) if static == "camera" else None,
        tuple(real_planes),
    )


def marker_map(config: JobConfig) -> dict[str, Pose] | None:
    """World poses of the markers from --marker-map: TOML of [[marker]] tables, or a WPILib
    field layout (JSON).
    """
    path = config.input.marker_map
    if path is None:
        return None
    text = read_text(path, "marker map")
    try:
        poses = (
            _wpilib_layout(parse_json(text))
            if text.lstrip()[:1] == "{"
            else _toml_layout(parse_toml(text))
        )
    except (KeyError, TypeError, ValueError, AttributeError, ConfigError) as e:
        raise InputError(
            f"marker map {path} is not understood: {getattr(e, 'message', repr(e))[:300]}",
            '[[marker]] with spec = "36h11:3:165mm", position = ["0m", "0m", "0m"],'
            " rotate_deg = [0, 0, 0]; or WPILib JSON",
        ) from None
    for key, pose in poses.items():
        if (
            not (np.abs(pose.matrix) <= MAX_LENGTH_M).all()
            or np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max() > 1e-3
        ):
            raise InputError(
                f"marker map {path}: the pose of {key} is not a valid pose",
                "a unit quaternion, metres",
            )
    missing = [m.key for m in config.markers if m.key not in poses]
    if missing:
        raise InputError(
            f"marker map {path} does not hold {missing[0]}",
            "it holds " + ", ".join(poses),
        )
    return poses


def _toml_layout(document: dict) -> dict[str, Pose]:
    out = {}
    for row in document["marker"]:
        spec = str(row["spec"])
        key = (
            MarkerSpec.parse(spec if spec.count(":") == 2 else f"{spec}:1m").key
            if ":" in spec
            else spec
        )  # or a pattern's name
        position = np.array([length_m(str(v)) for v in row["position"]])
        with np.errstate(invalid="ignore"):
            rotation = rotation_from_euler_deg(*row.get("rotate_deg", (0, 0, 0)))
        out[key] = Pose(rotation, position)
    return out


def _wpilib_layout(document: dict) -> dict[str, Pose]:
    """WPILib: x out of the tag, z up the official print; here z out, and x, y those of
    OpenCV's AprilTag images.

    OpenCV's images of the AprilTag families are the official ones turned by 180 degrees, so
    marker axes are its (-y, -z, x)."""
    swap = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    out = {}
    for tag in document["tags"]:
        t, q = tag["pose"]["translation"], tag["pose"]["rotation"]["quaternion"]
        # what is not finite is refused with the other poses
        with np.errstate(invalid="ignore", over="ignore"):
            r = (
                rotation_from_quaternion(np.array([float(q[k]) for k in "WXYZ"]))
                @ swap
            )
        out[f"36h11:{int(tag['ID'])}"] = Pose(
            r, np.array([float(t[k]) for k in "xyz"])
        )
    return out
