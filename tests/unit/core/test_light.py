"""The light that all effects share: turned, scaled, written and read."""

from __future__ import annotations

import json

import numpy as np

from arfx.core.light import DirectionalLight, Light, harmonics, turned_harmonics
from arfx.core.numerics import normalise
from arfx.core.pose import rotation_from_euler_deg

RNG = np.random.default_rng(1)
NORMALS = normalise(RNG.normal(size=(300, 3)))
SOFT = tuple(
    map(tuple, RNG.normal(scale=0.05, size=(9, 3)) + np.eye(9)[0][:, None] * 2)
)
LIGHT = Light(
    (0.5, 0.5, 0.5),
    (DirectionalLight((0.6, 0.0, 0.8), (0.5, 0.4, 0.3), 8.0, 2.0),),
    "marker",
    SOFT,
)
TURN = rotation_from_euler_deg(20, -50, 110)


def test_harmonics_are_orthonormal() -> None:
    # Gauss-Legendre in z and even azimuths: exact for products of degree 2
    z, w = np.polynomial.legendre.leggauss(6)
    phi = np.arange(12) * np.pi / 6
    zz, pp = np.meshgrid(z, phi, indexing="ij")
    r = np.sqrt(1 - zz**2)
    h = harmonics(np.stack([r * np.cos(pp), r * np.sin(pp), zz], -1))
    weights = np.repeat(w[:, None], 12, 1) * np.pi / 6
    assert (
        np.abs(np.einsum("ijk,ijl,ij->kl", h, h, weights) - np.eye(9)).max() < 1e-12
    )


def test_a_turned_light_lights_turned_surfaces_alike() -> None:
    assert (
        np.abs(
            LIGHT.turned(TURN).radiance(NORMALS @ TURN.T) - LIGHT.radiance(NORMALS)
        ).max()
        < 1e-12
    )


def test_turning_back_gives_the_same_coefficients() -> None:
    there = turned_harmonics(np.array(SOFT), TURN)
    assert np.abs(there - np.array(SOFT)).max() > 1e-3
    assert np.abs(turned_harmonics(there, TURN.T) - np.array(SOFT)).max() < 1e-12


def test_scaling_is_by_channel() -> None:
    factor = np.array([2.0, 0.5, 0.0])
    assert (
        np.abs(
            LIGHT.scaled(factor).radiance(NORMALS) - LIGHT.radiance(NORMALS) * factor
        ).max()
        < 1e-12
    )


def test_json_keeps_every_digit() -> None:
    assert Light.from_json(json.loads(json.dumps(LIGHT.to_json()))) == LIGHT
    assert Light.from_json(json.loads(json.dumps(Light().to_json()))) == Light()
