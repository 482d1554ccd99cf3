"""Rows of Yao, Tao, Wu 2018: environment map from the one camera and delta voxel cone tracing.

In the order of the paper's four steps: 1 and 3 here, 2 in `s4_volumes`, 4 in `s4_cones`;
pictures and rates are in `s4_pictures`. The paper prints no table and few numbers: measured
is what each of its statements claims."""

from __future__ import annotations

import numpy as np

from arfx.analyse.depth.planes import cloud_of, find_planes, scene_planes
from arfx.analyse.light.surroundings import cube_from_picture
from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.cube import CubeMap, look_up
from arfx.core.numerics import angle_between, direction_of
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.papers.s4_environment import (
    FACE_PX,
    mip_level,
    step3_environment,
    step3_mipmap,
)
from arfx.reproduce.rows import BEFORE, CORRECTED, PRINTED, Figure, Items, row
from arfx.reproduce.s4_cones import cones
from arfx.reproduce.s4_pictures import on_the_plane, pictures
from arfx.reproduce.s4_scenes import LAMP, methods, room
from arfx.reproduce.s4_volumes import volumes
from arfx.reproduce.work import Work
from arfx.stages.gi.health import seam_ratio

SIDE = 16  # texels of an environment's face
FOLDED = {PRINTED: step3_environment, CORRECTED: cube_from_picture}


def rows(work: Work) -> Items:
    yield from plane()
    yield from volumes(work)
    yield from on_the_plane(work)
    yield from environment()
    yield panoramas(work)
    yield from cones(work)
    yield from pictures(work)


def plane() -> Items:
    """Step 1, on a table of 1.2 m x 0.8 m with a box on it, measured with 3 mm of noise."""
    camera = Camera(160, 120, np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]))
    turn = rotation_from_euler_deg(180, 0, 0) @ rotation_from_euler_deg(-35, 0, 0)
    pose = Pose(turn, np.array([0.0, 0.0, 1.5]))
    x, y = np.meshgrid(np.arange(160.0), np.arange(120.0))
    rays = camera.directions(np.stack([x, y], -1))
    eye = pose.inverse().translation_m
    world = rays @ turn
    depth = np.full(x.shape, np.inf)
    for height, low, high in (
        (0.0, (-0.6, -0.4), (0.6, 0.4)),
        (0.12, (-0.45, 0.0), (-0.25, 0.2)),
    ):
        t = (height - eye[2]) / world[..., 2]
        at = eye[:2] + t[..., None] * world[..., :2]
        depth = np.where(((at > low) & (at < high)).all(-1), t * rays[..., 2], depth)
    depth += np.random.default_rng(4).normal(0, 0.003, depth.shape)
    cloud = cloud_of(depth, camera)
    assert cloud is not None
    table = find_planes(cloud)[0]
    up = turn[:, 2]
    angle = np.degrees(angle_between(table.normal, up))
    lower = 1e3 * abs(table.offset_m - up @ pose.translation_m)
    off = "the plane that was found is not the table"
    yield row(
        "step 1, the likeliest plane: its normal",
        "normals of points, checked against k neighbours",
        (angle, angle),
        "degrees off",
        off,
        below=0.5,
    )
    yield row(
        "step 1, the likeliest plane: its height",
        "the likeliest plane",
        (lower, lower),
        "mm off",
        off,
        below=3,
    )
    points = cloud.points[table.inliers]
    normal = table.normal
    away = points @ normal - table.offset_m
    after = (points - np.outer(away, normal)) @ normal - table.offset_m
    moved, before = (1e3 * np.abs(d).max() for d in (after, away))
    yield row(
        "step 1, points moved onto the plane and joined to a mesh",
        "moved towards the plane",
        (moved, moved),
        f"mm off it at most; {before:.3g} before",
        "points stayed off the plane",
        moved < 1e-6 < before,
    )
    found = scene_planes([(depth, pose)], camera)[0].real_plane()
    centre = 1e2 * np.linalg.norm(found.world_from_plane.translation_m[:2])
    yield row(
        "step 1, where the object stands",
        "in the middle of the plane",
        (centre, centre),
        "cm from the table's middle",
        "the middle of what is seen, moved to where it is well inside",
        below=8,
    )


def panoramas(work: Work) -> Figure:
    """The environments of one picture, all around: its middle column is straight ahead."""
    settings = methods(work, "cube", "8cm", LAMP)[CORRECTED]
    frame = work.shot(room(work), settings).renderer
    degrees = np.meshgrid(np.linspace(-180, 180, 240), np.linspace(-90, 90, 120))
    z, x, y = np.moveaxis(direction_of(*np.radians(degrees)), -1, 0)
    around = np.stack([x, y, z], -1).reshape(-1, 3)
    pictures = {BEFORE: frame.original()}
    for name, folded in FOLDED.items():
        radiance = look_up(folded(frame.plate, 64), around).reshape(*x.shape, 3)
        pictures[name] = SRGB.encode(np.clip(radiance, 0, 1))
    return Figure(
        "step 3, seams of the environment",
        "all that is around, out of one picture",
        pictures,
    )


def environment() -> Items:
    """Step 3: each third of a picture of nine colours on its face, no change of a constant
    one, seams, levels.
    """
    colours = np.random.default_rng(3).uniform(0.1, 0.9, (3, 3, 3))
    image = np.kron(colours, np.ones((40, 60, 1)))
    folded = [fold(image, SIDE) for fold in FOLDED.values()]
    faces = (
        ("(31), right of the picture on +x", 0, (1, 2)),
        ("(31), left of the picture on -x", 1, (1, 0)),
        ("(32), bottom of the picture on -y", 2, (2, 1)),
        ("(32), top of the picture on +y", 3, (0, 1)),
        ("(33), middle of the picture on -z", 4, (1, 1)),
        ("(34), middle of the picture, mirrored, on +z", 5, (1, 1)),
    )
    for words, face, part in faces:
        yield row(
            f"step 3 {words}",
            "that part of the picture",
            [np.abs(f[face] - colours[part]).max() for f in folded],
            "at most off, of 1",
            "the angle from the line of sight is the distance from the picture's middle, so"
            " that no edge of the cube shows as a seam",
            below=1e-6,
        )
    mipmap = step3_mipmap(step3_environment(image, FACE_PX))
    formats = [
        f"{a.shape[-1]} x {a.dtype.itemsize * 8} bit {a.dtype.kind}"
        for a in (mipmap[0], CubeMap.of(folded[1]).faces())
    ]
    yield row(
        "step 3, format of the cube",
        "RGBA16",
        formats,
        "",
        "alpha is always 1; floating point holds what is brighter than white",
        formats[0] == "4 x 16 bit u" == formats[1],
    )
    even = np.full((90, 120, 3), 0.4)
    yield row(
        "step 3, environment of a constant picture",
        "constant, as follows",
        [np.ptp(fold(even, SIDE)) for fold in FOLDED.values()],
        "largest difference",
        "it is not",
        below=1e-6,
    )
    y, x = np.mgrid[0:180, 0:240] / 40
    smooth = np.stack([np.sin(x + y), np.cos(y), np.sin(x)], -1) / 3 + 0.5
    yield row(
        "step 3, seams of the environment",
        "acceptable for the whole surroundings",
        [seam_ratio(fold(smooth, SIDE)) for fold in FOLDED.values()],
        "steps across edges of the cube / within faces",
        "sides that were cut out of the picture do not meet the mirrored back; the"
        " corrected fold is continuous",
        below=1.5,
    )
    yield row(
        f"step 3, levels of the mip chain of {FACE_PX}² texels a face",
        "several",
        len(mipmap),
        "",
        "some are missing",
        len(mipmap) == 8,
    )
    for half_deg in (1, 5, 15, 30):
        level = mip_level(half_deg, FACE_PX)
        texel = 4**level * 4 * np.pi / (6 * FACE_PX**2)
        cone = 2 * np.pi * (1 - np.cos(np.radians(half_deg)))
        yield row(
            f"step 4, mip level of a cone of half-angle {half_deg}° at {FACE_PX}² texels",
            "by the aperture of the cone",
            level,
            "",
            "a texel of that level is not as large as the cone",
            abs(texel / cone - 1) < 1e-9,
        )
