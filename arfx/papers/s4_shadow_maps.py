"""Step 2 of Yao, Tao, Wu 2018, light: two reflective shadow maps and the split injection of virtual
point lights.

R_rho is the real scene as the light sees it, R_mu the real scene and the object. Each texel is a
virtual point light: where the light meets a surface, and what that sends on. Texels that show the
real scene in both stay out of V_delta; where the object shows, the light of R_rho that hit the real
surface behind it goes in with one sign and that of R_mu, the object's, with the other.

With the printed labels V_delta = V_rho - V_mu, the light that the object takes is positive and the
light that it gives negative: the sign is turned round. Step 4 subtracts it.

Deviations. "Configured" lights are the frame's (`[light] given` configures one); light without a
direction has no shadow map. Metal sends its light evenly, as voxels are coarser than any
highlight."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.numerics import normalise
from arfx.papers.s4_volumes import Volumes
from arfx.papers.s4_voxels import Volume
from arfx.stages.gi.reference_scene import RayScene

TEXELS = 3  # of a shadow map across a voxel: one that the light grazes is not missed


class ShadowMap(NamedTuple):
    """A reflective shadow map. distance (k,) : from the light's plane, metres, inf = nothing
    position (k, 3), metres, anchor
    axes;  radiance (k, 3) that each virtual point light sends on"""

    distance: ndarray
    position: ndarray
    radiance: ndarray


def texel_rays(volume: Volume, direction: ndarray) -> ndarray:
    """(k, 3) where the rays of a light from `direction` (3,), unit, anchor axes, begin: a grid over
    the volume."""
    half = np.sqrt(3) / 2 * volume.n * volume.voxel_m
    side = int(np.ceil(np.sqrt(3) * volume.n * TEXELS))
    aside = [0.0, 1.0, 0.0] if abs(direction[1]) < 0.9 else [1.0, 0.0, 0.0]
    u = normalise(np.cross(direction, aside))
    v = np.cross(direction, u)
    a = ((np.arange(side) + 0.5) / side * 2 - 1)[:, None] * half
    middle = (
        np.asarray(volume.low_m)
        + volume.n * volume.voxel_m / 2
        + 2 * half * direction
    )
    return (middle + (a[:, None] * v + a * u)).reshape(-1, 3)


def shadow_map(
    rays: RayScene, origins: ndarray, direction: ndarray, rgb: ndarray
) -> ShadowMap:
    """What light `rgb` (3,) from `direction` (3,) meets: diffuse surfaces send rho x light x
    cosine."""
    directions = np.broadcast_to(-direction, origins.shape)
    met = rays.nearest(origins, directions)
    lit = np.isfinite(met.distance)
    surface = rays.surface(met.of(lit), origins[lit], directions[lit])
    position, radiance = np.zeros((2, *origins.shape))
    position[lit] = surface.position
    cosine = np.clip(surface.normal @ direction, 0, None)[:, None]
    radiance[lit] = surface.reflectance * rgb * cosine
    return ShadowMap(met.distance, position, radiance)


def shadow_maps(
    real: RayScene,
    virtual: RayScene,
    volume: Volume,
    direction: ndarray,
    rgb: ndarray,
) -> tuple[ShadowMap, ShadowMap, ndarray]:
    """(R_rho, R_mu, shows (k,): texels of R_mu in which the object does)."""
    origins = texel_rays(volume, direction)
    R_rho, alone = (
        shadow_map(rays, origins, direction, rgb) for rays in (real, virtual)
    )
    shows = alone.distance < R_rho.distance
    pairs = zip(alone, R_rho, strict=True)
    R_mu = ShadowMap(*(np.where(shows, a.T, b.T).T for a, b in pairs))
    return R_rho, R_mu, shows


def injected(
    volumes: Volumes, lights: ShadowMap, of: ndarray | bool = True
) -> ndarray:
    """(leaves, 3) radiance times opacity of the virtual point lights `of` (k,). A later texel
    overwrites an earlier one."""
    out = np.zeros((len(volumes.codes), 3))
    lit = of & np.isfinite(lights.distance)
    leaf = volumes.leaf_of(lights.position[lit])
    out[leaf[leaf >= 0]] = lights.radiance[lit][leaf >= 0]
    return out * volumes.tree.eta[volumes.rows_of(0), 3:]


class Radiance(NamedTuple):
    """The three fields, (nodes, 3) float32 each: without the object, with it, and V_rho - V_mu."""

    V_rho: ndarray
    V_mu: ndarray
    V_delta: ndarray


def step2_radiance(
    volumes: Volumes,
    real: RayScene,
    virtual: RayScene,
    lights: list[tuple[ndarray, ndarray]],
) -> Radiance:
    """lights : direction (3,), unit, anchor axes, and rgb (3,) of each"""
    V_rho, V_mu, V_delta = np.zeros((3, len(volumes.codes), 3))
    for light in lights:
        R_rho, R_mu, shows = shadow_maps(real, virtual, volumes.volume, *light)
        V_rho += injected(volumes, R_rho)
        V_mu += injected(volumes, R_mu)
        # split injection
        V_delta += injected(volumes, R_rho, shows) - injected(volumes, R_mu, shows)
    return Radiance(*map(volumes.filtered, (V_rho, V_mu, V_delta)))
