"""Rows of Yao, Tao, Wu 2018: environment map from the one camera and delta voxel cone tracing.

In the order of the paper's four steps; pictures are in `s4_pictures`. The paper prints no
table and few numbers: measured is what its statements claim."""

import numpy as np

from arfx.analyse.depth.planes import cloud_of, find_planes, scene_planes
from arfx.analyse.light.surroundings import cube_from_picture
from arfx.core.camera import Camera
from arfx.core.cube import CubeMap
from arfx.core.numerics import angle_between, direction_of
from arfx.core.pose import Pose, rotation_from_euler_deg
from arfx.core.sampling import GOLDEN_RAD
from arfx.papers.s4_cones import six_cones
from arfx.papers.s4_environment import (
    FACE_PX,
    mip_level,
    step3_environment,
    step3_mipmap,
)
from arfx.papers.s4_plane import step1_mesh
from arfx.papers.s4_shadow_maps import step2_radiance
from arfx.papers.s4_volumes import octree_of, step2_volumes
from arfx.papers.s4_voxels import Volume
from arfx.reproduce.rows import Items, Row, row
from arfx.reproduce.s4_pictures import on_the_plane, pictures
from arfx.reproduce.s4_scenes import flat_with
from arfx.reproduce.work import Work
from arfx.stages.gi.health import seam_ratio
from arfx.stages.gi.reference_scene import RayScene

ALBEDO = 0.5  # of the plane
TOWARDS, RGB = np.array([0.6, 0.0, 0.8]), np.array([0.5, 0.4, 0.3])  # the light
CHANNELS = 4 + 3 * 3  # of V_eta, V_rho, V_mu and V_delta
N = 16  # voxels a side of a small volume
SIDE = 16  # texels of an environment's face
FOLDED = step3_environment, cube_from_picture


def rows(work: Work) -> Items:
    yield from plane()
    yield from light(work)
    yield from filtering()
    yield memory(work)
    yield from on_the_plane(work)
    yield from environment()
    yield covered()
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
    yield row(
        "step 1, the likeliest plane: its normal",
        "normals of points, checked against k neighbours",
        (angle, angle),
        "degrees off",
        "the plane that was found is not the table",
        below=0.5,
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


def light(work: Work) -> Items:
    """A red cube on a grey plane under one light."""
    scene = flat_with(work, "red-cube", "8cm")
    mesh = step1_mesh(scene, ALBEDO)
    real = RayScene(mesh)
    virtual = RayScene(scene)
    made = step2_volumes(mesh, scene, 64)
    lowest = made.rows_of(0)
    fields = step2_radiance(made, real, virtual, [(TOWARDS, RGB)])
    V_rho, V_mu, V_delta = (field[lowest] for field in fields)
    shadow = V_delta[made.leaf_of(np.array([[-0.05, 0.0, 1e-6]]))[0], 0]
    yield row(
        "step 2, split injection: V_Δ in the object's shadow",
        "light of R_ρ positive, of R_μ negative",
        shadow,
        "red, radiance",
        "not positive",
        shadow > 0,
    )
    wrong = (np.abs(V_delta - (V_rho - V_mu)).max(1) > 1e-6).mean()
    yield row(
        "equation V_Δ = V_ρ - V_μ: voxels in which it does not hold",
        "V_Δ = V_ρ - V_μ",
        wrong,
        "of 1",
        "points of light in one voxel overwrite each other, and split injection overwrites"
        " others than the two volumes do; the corrected method adds light up by area and"
        " has no such volumes",
        wrong == 0,
    )


def filtering() -> Items:
    wall = np.argwhere(np.ones((1, N, N))) + np.array([7, 0, 0])
    cube = Volume(N, (0.0, 0.0, 0.0), 1.0)
    volumes = octree_of(cube, wall, np.zeros(wall.shape), np.ones(len(wall)))
    passes = len(volumes.starts)
    yield row(
        "step 2, filter steps of an octree of 5 levels",
        "n - 1",
        passes,
        "",
        "not 4",
        passes == 4,
    )
    yield row(
        "step 2, opacity of a wall of one voxel at level 1",
        "mean of the children",
        volumes.tree.eta[volumes.rows_of(1), 3].mean(),
        "",
        "a mean of eight children lets light through a wall",
    )


def memory(work: Work) -> Row:
    """Of all volumes of a teapot and the plane under it, beside arrays."""
    scene = flat_with(work, "red-teapot", "12cm")
    made = step2_volumes(step1_mesh(scene, ALBEDO), scene, 64)
    printed, dense = (size / 2**20 for size in made.memory_bytes(CHANNELS))
    return row(
        "step 2, memory of the volumes at 64³ voxels",
        "empty voxels are not stored",
        printed,
        f"MB; arrays of all voxels {dense:.4g}",
        "as much as arrays of all voxels",
        printed < 0.2 * dense,
    )


def environment() -> Items:
    """Step 3: each third of a picture of nine colours on its face, no change of a constant
    one, seams, levels.
    """
    colours = np.random.default_rng(3).uniform(0.1, 0.9, (3, 3, 3))
    image = np.kron(colours, np.ones((40, 60, 1)))
    folded = [fold(image, SIDE) for fold in FOLDED]
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
    y, x = np.mgrid[0:180, 0:240] / 40
    smooth = np.stack([np.sin(x + y), np.cos(y), np.sin(x)], -1) / 3 + 0.5
    yield row(
        "step 3, seams of the environment",
        "acceptable for the whole surroundings",
        [seam_ratio(fold(smooth, SIDE)) for fold in FOLDED],
        "steps across edges of the cube / within faces",
        "sides that were cut out of the picture do not meet the mirrored back; the"
        " corrected fold is continuous",
        below=1.5,
    )
    half_deg = 30
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


def covered() -> Row:
    """By the six wide cones of step 4."""
    directions, _, tan_half = six_cones()
    k = np.arange(100_000)
    hemisphere = direction_of(k * GOLDEN_RAD, np.arcsin((k + 0.5) / len(k)))
    within = (hemisphere @ directions.T).max(1) > 1 / np.hypot(1, tan_half)
    share = within.mean()
    return row(
        "step 4, share of the hemisphere within the wide cones",
        "cover the whole hemisphere",
        (share, share),
        "of 1",
        "cones of 60° that cover it would overlap; these are tilted and weighted so that"
        " they leave as much of coarse and fine light as a cosine does",
        share > 0.99,
    )
