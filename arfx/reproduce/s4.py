"""Rows of Yao, Tao, Wu 2018: environment map from the one camera and delta voxel cone tracing.

In the order of the paper's four steps. It prints no table and few numbers: measured is what each statement claims.
Pictures and rates are in `s4_pictures`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from arfx.analyse.depth.planes import cloud_of, find_planes, scene_planes
from arfx.analyse.light.surroundings import fold
from arfx.core.camera import Camera
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.papers.s4_gi import step2_mean, step3_environment
from arfx.reproduce.rows import Item, Row, bars, compared
from arfx.reproduce.s4_pictures import PAPER, flat_scene, pictures, said
from arfx.reproduce.work import Work
from arfx.stages.gi.cones import six_cones, trace_many
from arfx.stages.gi.health import seam_ratio
from arfx.stages.gi.pyramid import Downsample, atlas_of, front_to_back, levels_of, structure_of
from arfx.stages.gi.voxelise import voxelise

SIDE = 16  # texels of an environment's face, and voxels of the small volumes


def rows(work: Work) -> Iterator[Item]:
    yield from plane()
    yield from filtering()
    yield from memory(work)
    yield from environment()
    yield from cones()
    yield from pictures(work)


def plane() -> Iterator[Row]:
    """Step 1, on a table of 1.2 m x 0.8 m with a box on it, measured with 3 mm of noise."""
    camera = Camera(160, 120, np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]))
    pose = Pose(rotation_from_euler_deg(180, 0, 0) @ rotation_from_euler_deg(-35, 0, 0), np.array([0.0, 0.0, 1.5]))
    y, x = np.mgrid[0:120, 0:160]
    rays = camera.directions(np.stack([x, y], -1).astype(float))
    eye, world = pose.inverse().translation_m, rays @ pose.rotation
    depth = np.full(x.shape, np.inf)
    for height, low, high in ((0.0, (-0.6, -0.4), (0.6, 0.4)), (0.12, (-0.45, 0.0), (-0.25, 0.2))):
        t = (height - eye[2]) / world[..., 2]
        at = eye[:2] + t[..., None] * world[..., :2]
        depth = np.where(((at > low) & (at < high)).all(-1), t * rays[..., 2], depth)
    depth += np.random.default_rng(4).normal(0, 0.003, depth.shape)
    cloud = cloud_of(depth, camera)
    assert cloud is not None
    table = find_planes(cloud)[0]
    up = pose.rotation[:, 2]
    angle = float(np.degrees(np.arccos(min(float(table.normal @ up), 1.0))))
    lower = float(np.abs(table.offset_m - up @ pose.translation_m)) * 1e3
    marker = (
        "with a marker the plane is the marker's; measured depth gives several planes, found with thresholds in units of noise"
    )
    yield said(
        "step 1, the dominant plane: its normal", "normals of points, checked against k neighbours", (angle, angle),
        angle < 0.5, marker, "degrees off",
    )  # fmt: skip
    yield said("step 1, the dominant plane: its height", "the likeliest plane", (lower, lower), lower < 3, marker, "mm off")
    away = np.abs(cloud.points[table.inliers] @ table.normal - table.offset_m)
    moved = cloud.points[table.inliers] - np.outer(cloud.points[table.inliers] @ table.normal - table.offset_m, table.normal)
    after = float(np.abs(moved @ table.normal - table.offset_m).max()) * 1e3
    yield said(
        "step 1, points moved onto the plane", "points are moved towards the plane and joined to a mesh",
        (after, after), after < 1e-6 < float(away.max()), "points stayed off the plane", "mm off it, at most",
    )  # fmt: skip
    found = scene_planes([(depth, pose)], camera)[0].real_plane()
    centre = float(np.linalg.norm(found.world_from_plane.translation_m[:2])) * 1e2
    yield said(
        "step 1, where the object stands", "in the middle of the plane", (centre, centre), centre < 8,
        "the middle of what is seen is taken where it is well inside, so that the object stands on nothing's edge",
        "cm from the table's middle",
    )  # fmt: skip


def wall(downsample: Downsample) -> list[float]:
    """Opacity along its normal of a wall one voxel thick, by level."""
    cells = np.argwhere(np.ones((1, SIDE, SIDE))) + np.array([8, 0, 0])
    values = np.zeros((len(cells), 4), np.float32)
    values[:, 3] = 1
    return [float(v[:, 0, 3].mean()) for v in levels_of(structure_of(cells, SIDE, downsample), values)[:4]]


def filtering() -> Iterator[Row]:
    layers = structure_of(np.zeros((1, 3), int), 64).layers
    yield compared(PAPER, "step 2, filter steps of an octree of 7 levels", "6", float(len(layers) - 1), float(len(layers) - 1))
    leaks = (
        "a mean of the children lets light through a wall; in six directions children first hide each other, then are averaged"
    )
    for level, (printed, corrected) in enumerate(zip(wall(step2_mean), wall(front_to_back), strict=True)):
        yield said(
            f"step 2, opacity of a wall of one voxel at level {level}", "mean of the children", (printed, corrected),
            printed == corrected, leaks,
        )  # fmt: skip


def memory(work: Work) -> Iterator[Item]:
    """The sparse octree of a teapot beside arrays of all voxels."""
    clip = flat_scene(work)
    scene = work.planned(clip, settings={"model": {"file": work.model("teapot"), "fit": "12cm"}}).scene
    sides = (64, 128, 256)
    sparse, dense = [], []
    for n in sides:
        structure = structure_of(voxelise(scene, n).cells, n)
        sparse.append((4 * structure.floats + structure.brick_of.nbytes) / 2**20)
        dense.append(sum(4 * (4 if k == 0 else 24) * layer.n**3 for k, layer in enumerate(structure.layers)) / 2**20)
        yield said(
            f"step 2, memory of an octree of {n}³ voxels", "empty voxels are not stored", (sparse[-1],) * 2,
            sparse[-1] < dense[-1], "as much as an array of all voxels", f"MB; an array of all {dense[-1]:.4g}",
        )  # fmt: skip
    yield bars(
        PAPER, "step 2, memory of an octree of 256³ voxels", "a teapot in voxels, all levels", "MB", [f"{n}³" for n in sides],
        {"array of all voxels": dense, "printed method": sparse, "corrected": sparse},
    )  # fmt: skip


def environment() -> Iterator[Row]:
    """Step 3: each third of a picture of nine colours on its face, no change of a constant one, seams."""
    colours = np.random.default_rng(3).uniform(0.1, 0.9, (3, 3, 3))
    image = np.kron(colours, np.ones((40, 60, 1)))
    printed, corrected = step3_environment(image, SIDE), fold(image, SIDE)
    why = (
        "the angle from the line of sight is the distance from the picture's middle, so that no edge of the cube shows as a seam"
    )
    faces = (
        ("(31), right of the picture on +x", 0, (1, 2)), ("(31), left of the picture on -x", 1, (1, 0)),
        ("(32), bottom of the picture on -y", 2, (2, 1)), ("(32), top of the picture on +y", 3, (0, 1)),
        ("(33), middle of the picture on -z", 4, (1, 1)), ("(34), middle of the picture, mirrored, on +z", 5, (1, 1)),
    )  # fmt: skip
    for words, face, part in faces:
        off = [float(np.abs(f[face] - colours[part]).max()) for f in (printed, corrected)]
        yield said(f"step 3 {words}", "that part of the picture, and no other", off, max(off) < 1e-6, why, "at most off, of 1")
    flat = [float(np.ptp(f(np.full((90, 120, 3), 0.4), SIDE))) for f in (step3_environment, fold)]
    yield said(
        "step 3, environment of a constant picture",
        "follows: constant",
        flat,
        max(flat) < 1e-6,
        "",
        "largest difference",
    )
    y, x = np.mgrid[0:180, 0:240] / 40
    smooth = np.stack([np.sin(x + y) / 3 + 0.5, np.cos(y) / 3 + 0.5, np.sin(x) / 3 + 0.5], -1)
    seam = [float(seam_ratio(f(smooth, SIDE))) for f in (step3_environment, fold)]
    yield said(
        "step 3, seams of the environment", "acceptable for the whole surroundings", seam, max(seam) < 1.5,
        "sides that were cut out of the picture do not meet the mirrored back; the corrected fold is continuous",
        "steps across edges of the cube / within faces",
    )  # fmt: skip


def block(alpha: float, exponents: list[float]) -> float:
    """What voxels of an opacity, all around, take of a ray whose samples are so long, in voxels."""
    cells = np.argwhere(np.ones((8, 8, 8)))
    values = np.zeros((len(cells), 4), np.float32)
    values[:, 3] = alpha
    steps = np.array([[1.0 + k, 0, e] for k, e in enumerate(exponents)], np.float32)
    ray = np.array([[[1.0, 0, 0]]], np.float32)
    start, normal = np.array([[1.0, 4, 4]], np.float32), np.zeros((1, 3), np.float32)
    return float(1 - trace_many(atlas_of(structure_of(cells, 8), values), steps, start, ray, normal, np.float32(0), False)[0, 3])


def cones() -> Iterator[Row]:
    """Step 4."""
    directions, weights, tangent = six_cones()
    total, half_deg = float(weights.sum()), float(np.degrees(np.arctan(tangent)))
    yield compared(PAPER, "step 4, weights of the wide cones together", "1", total, total, tolerance=1e-6)
    z = (np.arange(200_000) + 0.5) / 200_000
    turn = np.arange(200_000) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z**2)
    hemisphere = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], -1)
    covered = float(((hemisphere @ directions.T).max(1) > np.cos(np.radians(half_deg))).mean())
    yield said(
        "step 4, share of the hemisphere within the wide cones", "cover the whole hemisphere", (covered, covered), covered > 0.99,
        "cones of 60 degrees that cover it would overlap; these are tilted and weighted so that they leave as much of coarse and "
        "fine light as a cosine does", "of 1",
    )  # fmt: skip
    half, two = block(0.5, [0.5]), block(0.5, [0.5, 0.5])
    why = "the length of a step is not spoken of in print"
    yield said(
        "step 4, half a step through an opacity of a half", "weighted by what the cone hides", (half, half),
        abs(half - 0.29289) < 1e-4, why,
    )  # fmt: skip
    yield said("step 4, two such half steps", "weighted by what the cone hides", (two, two), abs(two - 0.5) < 1e-5, why)
