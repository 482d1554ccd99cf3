"""Yao, Tao, Wu 2018 as printed: reflective shadow maps and split injection."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from arfx.core.numerics import normalise
from arfx.core.scene import Scene
from arfx.papers.s4_plane import step1_mesh
from arfx.papers.s4_shadow_maps import Radiance, shadow_maps, step2_radiance
from arfx.papers.s4_volumes import Volumes, step2_volumes
from arfx.stages.gi.reference_scene import RayScene
from tests.unit.stages.gi_scenes import LAMP, MATT_RED, box, on_plane

ALBEDO = 0.5
D, RGB = normalise(np.array([0.6, 0.0, 0.8])), np.array([0.5, 0.4, 0.3])


@cache
def built() -> tuple[Scene, RayScene, RayScene, Volumes]:
    s = on_plane(box(MATT_RED), LAMP)
    mesh = step1_mesh(s, ALBEDO)
    return s, RayScene(mesh), RayScene(s), step2_volumes(mesh, s, 32)


@cache
def fields() -> Radiance:
    _, real, virtual, volumes = built()
    return step2_radiance(volumes, real, virtual, [(D, RGB)])


def test_both_shadow_maps() -> None:
    s, real, virtual, volumes = built()
    R_rho, R_mu, shows = shadow_maps(real, virtual, volumes.volume, D, RGB)
    assert 0.02 < shows.mean() < 0.5
    np.testing.assert_allclose(
        R_rho.position[shows][:, 2], 0, atol=1e-6
    )  # behind the object lies the plane
    assert (R_mu.position[shows][:, 2] > -1e-6).all() and (
        R_mu.distance[shows] < R_rho.distance[shows]
    ).all()
    assert np.array_equal(R_mu.position[~shows], R_rho.position[~shows]), (
        "texels of the real scene are the same in both"
    )
    np.testing.assert_allclose(
        R_rho.radiance[shows],
        np.tile(ALBEDO * RGB * D[2], (shows.sum(), 1)),
        rtol=1e-5,
    )
    top = shows & (R_mu.position[:, 2] > s.model_points_m[:, 2].max() - 1e-5)
    np.testing.assert_allclose(
        R_mu.radiance[top],
        np.tile(np.array([0.8, 0.04, 0.03]) * RGB * D[2], (top.sum(), 1)),
        rtol=1e-4,
    )


def test_light_that_the_object_takes_and_gives_has_opposite_signs() -> None:
    """As printed: V_rho - V_mu, positive where the object stands in the light of the plane."""
    volumes, delta = built()[3], fields().V_delta
    leaves = delta[volumes.rows_of(0)]
    shadow, lit = volumes.leaf_of(np.array([[-0.06, 0.0, 1e-6], [0.1, 0.0, 1e-6]]))
    assert leaves[shadow] == pytest.approx(ALBEDO * RGB * D[2], rel=1e-3), (
        "the light that the shadow takes from the plane"
    )
    assert (leaves[lit] == 0).all(), "the plane in the light stays out"
    assert (leaves[:, 0] < -0.1).sum() > 20 and leaves[:, 0].min() == pytest.approx(
        -0.8 * RGB[0] * D[2], rel=1e-3
    )


def test_split_injection_is_the_difference_of_the_volumes() -> None:
    """But in voxels that both an edge of the shadow and the light meet: there the later
    texel overwrites.
    """
    volumes, made = built()[3], fields()
    V_rho, V_mu, V_delta = (
        v[volumes.rows_of(0)] for v in (made.V_rho, made.V_mu, made.V_delta)
    )
    off = np.abs(V_delta - (V_rho - V_mu)).max(1) > 1e-6
    assert (np.abs(V_delta).max(1) > 0).sum() > 4 * off.sum()
    assert off.mean() < 0.1
    np.testing.assert_allclose(
        made.V_delta[0], V_delta.sum(0) / 32**3, rtol=1e-4
    )  # filtered as all are


def test_without_an_object_the_difference_is_exactly_zero() -> None:
    s, real, _, volumes = built()
    away = s.world_from_model.copy()
    away[0, 3] += 100
    made = step2_radiance(
        volumes, real, RayScene(replace(s, world_from_model=away)), [(D, RGB)]
    )
    assert (
        not made.V_delta.any()
        and np.array_equal(made.V_rho, made.V_mu)
        and made.V_rho.any()
    )


def test_lights_add() -> None:
    _, real, virtual, volumes = built()
    twice = step2_radiance(volumes, real, virtual, [(D, RGB), (D, RGB)])
    np.testing.assert_allclose(twice.V_delta, 2 * fields().V_delta, atol=1e-6)
