"""Step 2 of Yao, Tao, Wu 2018: voxels, reflective shadow maps, split injection, the octree
and its filter.
"""

from __future__ import annotations

import numpy as np

from arfx.core.numerics import arccos
from arfx.papers.s4_plane import step1_mesh
from arfx.papers.s4_shadow_maps import shadow_maps, step2_radiance
from arfx.papers.s4_volumes import octree_of, step2_volumes
from arfx.papers.s4_voxels import Volume
from arfx.reproduce.rows import Items, Row, row
from arfx.reproduce.s4_scenes import flat_with
from arfx.reproduce.work import Work
from arfx.stages.gi.reference_scene import RayScene

ALBEDO = 0.5  # of the plane
TOWARDS, RGB = np.array([0.6, 0.0, 0.8]), np.array([0.5, 0.4, 0.3])  # the light
CHANNELS = 4 + 3 * 3  # of V_eta, V_rho, V_mu and V_delta
N = 16  # voxels a side of a small volume


def volumes(work: Work) -> Items:
    yield from light(work)
    yield from filtering()
    yield memory(work)


def light(work: Work) -> Items:
    """A red cube on a grey plane under one light."""
    scene = flat_with(work, "red-cube", "8cm")
    mesh = step1_mesh(scene, ALBEDO)
    real = RayScene(mesh)
    virtual = RayScene(scene)
    made = step2_volumes(mesh, scene, 64)
    lowest = made.rows_of(0)
    places = np.array([[0.06, 0.05, 1e-6], [-0.06, 0.05, 1e-6], [0.06, -0.05, 1e-6]])
    eta = made.tree.eta[lowest][made.leaf_of(places)]
    yield row(
        "step 2, V_η: normal of the plane's voxels",
        "voxels hold normals",
        np.degrees(arccos(eta[:, 2] / eta[:, 3])).max(),
        "degrees off",
        "they do not",
        below=1,
    )
    R_rho, _, _ = shadow_maps(real, virtual, made.volume, TOWARDS, RGB)
    plane = np.isfinite(R_rho.distance)
    expected = ALBEDO * RGB * TOWARDS[2]
    yield row(
        "step 2, R_ρ: light of the real scene's points",
        "light that meets the real scene",
        np.abs(R_rho.radiance[plane] / expected - 1).max(),
        "relative error",
        "not albedo x light x cosine",
        below=1e-4,
    )
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
