"""Step 2 of Yao, Tao, Wu 2018: voxels, reflective shadow maps, split injection, the octree
and its filter.
"""

from __future__ import annotations

import numpy as np

from arfx.core.numerics import arccos
from arfx.measure.difference import level_difference
from arfx.papers.s4_cones import cone_trace
from arfx.papers.s4_plane import step1_mesh
from arfx.papers.s4_shadow_maps import shadow_maps, step2_radiance
from arfx.papers.s4_volumes import Volumes, octree_of, step2_volumes
from arfx.papers.s4_voxels import Volume
from arfx.reproduce.rows import Bars, Items, Row, row
from arfx.reproduce.s4_scenes import flat_scene, flat_with, methods
from arfx.reproduce.work import Work, shot_of
from arfx.stages.gi.reference_scene import RayScene

ALBEDO = 0.5  # of the plane
TOWARDS, RGB = np.array([0.6, 0.0, 0.8]), np.array([0.5, 0.4, 0.3])  # the light
CHANNELS = 4 + 3 * 3  # of V_eta, V_rho, V_mu and V_delta
N = 16  # voxels a side of a small volume


def volumes(work: Work) -> Items:
    yield from light(work)
    yield from filtering()
    yield from memory(work)
    yield empty(work)


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
    R_rho, R_mu, shows = shadow_maps(real, virtual, made.volume, TOWARDS, RGB)
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
    apart = np.abs(R_mu.radiance - R_rho.radiance).max(-1) > 0
    yield row(
        "step 2, R_μ: texels that differ from R_ρ and do not show the object",
        "with the virtual object added",
        (apart & ~shows).mean(),
        "of 1",
        "others changed",
        not (apart & ~shows).any() and apart.any(),
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
    yield row(
        "step 2, split injection: V_Δ on the lit object",
        "light of R_ρ positive, of R_μ negative",
        V_delta[:, 0].min(),
        "red, radiance",
        "not negative",
        below=0,
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


def small(cells: np.ndarray, alpha: float = 1.0, stored: bool = False) -> Volumes:
    """An octree of voxels of one opacity, N a side, seen from everywhere.

    stored : of `step2_mean`
    """
    cube = Volume(N, (0.0, 0.0, 0.0), 1.0)
    none = np.zeros((len(cells), 3))
    opacity = np.full(len(cells), alpha)
    return octree_of(cube, cells, none, opacity, stored)


def ray(
    alpha: float, cells: np.ndarray, steps: list[list[float]]
) -> list[np.ndarray]:
    """(4,) radiance and what is left behind a ray along x through voxels that glow as
    bright as they are opaque: as printed, and with means of stored children and radiance in
    proportion to a step's opacity."""
    taken = np.array(steps, np.float32)
    start = np.array([[2.0, 8, 8]])
    along = np.array([[[1.0, 0, 0]]])
    made = []
    for better in (False, True):
        volumes = small(cells, alpha, better)
        V = np.repeat(volumes.tree.eta[:, 3:], 3, 1)
        made.append(cone_trace(volumes, V, taken, start, along, better)[0, 0])
    return made


def filtering() -> Items:
    passes = len(small(np.zeros((1, 3), int)).starts)
    yield row(
        "step 2, filter steps of an octree of 5 levels",
        "n - 1",
        passes,
        "",
        "not 4",
        passes == 4.0,
    )
    wall = np.argwhere(np.ones((1, N, N))) + np.array([7, 0, 0])
    leaks = (
        "a mean of eight children lets light through a wall; one of those that are stored"
        " does not, but all grow with the level"
    )
    for level in range(4):
        made = [small(wall, stored=stored) for stored in (False, True)]
        opacity = [m.tree.eta[m.rows_of(level), 3].mean() for m in made]
        yield row(
            f"step 2, opacity of a wall of one voxel at level {level}",
            "mean of the children",
            opacity,
            "",
            leaks,
            opacity[0] == opacity[1],
        )
    yield row(
        "step 2, light through a wall where a cone is 8 voxels wide",
        "hidden by the wall",
        [r[3] for r in ray(1.0, wall, [[2.0, 3, 1.0]])],
        "of 1",
        leaks,
        below=0.01,
    )


def memory(work: Work) -> Items:
    """Of all volumes of a teapot and the plane under it, beside arrays."""
    scene = flat_with(work, "red-teapot", "12cm")
    mesh = step1_mesh(scene, ALBEDO)
    made = {}
    for n in (64, 128, 256):
        printed, dense = (
            size / 2**20
            for size in step2_volumes(mesh, scene, n).memory_bytes(CHANNELS)
        )
        made[f"{n}³"] = printed, dense
        yield row(
            f"step 2, memory of the volumes at {n}³ voxels",
            "empty voxels are not stored",
            printed,
            f"MB; arrays of all voxels {dense:.4g}",
            "as much as arrays of all voxels",
            printed < 0.2 * dense,
        )
    sparse, arrays = zip(*made.values(), strict=True)
    yield Bars(
        f"step 2, memory of the volumes at {[*made][-1]} voxels",
        "a teapot",
        "MB",
        list(made),
        {"arrays of all voxels": arrays, "printed method": sparse},
    )


def empty(work: Work) -> Row:
    """An object that is out of the light's and the camera's way: high over both."""
    changed = []
    for settings in methods(work, "red-cube", "8cm").values():
        settings["model"]["offset"] = ["0m", "0m", "3m"]
        job = work.planned(flat_scene(work), settings)
        most = 0.0
        if job.plan.frames[1].steps:
            shot = shot_of(job, 1)
            most = level_difference(shot.picture(), shot.renderer.original()).max()
        changed.append(most)
    return row(
        "step 2, change of the picture by an empty V_Δ",
        "none, as follows",
        changed,
        "grey levels at most",
        "pixels changed",
        changed == [0.0, 0.0],
    )
