"""Indirect light that the object's pixels send to the camera: all that falls on them, and what they mirror.

Gloss: the surroundings in a cone about the lobe's middle, as wide as the roughness asks; where the object hides some of
its own surroundings a ray along that middle shows which. Cost: O(covered pixels + rays). Source: docs/methods/gi.md#gloss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arfx.core.numerics import normalise
from arfx.core.pose import Pose
from arfx.stages.gi.gloss import (
    gloss_weights,
    mirror_tangent,
    off_specular_peak,
    widened_roughness,
)
from arfx.stages.gi.surroundings import Background, background_radiances
from arfx.stages.light.transport import Transport
from arfx.stages.lightmap.shading import Surface

_OCCLUDED = 0.01  # share of a place's hemisphere that the object hides, from which on a ray is sent
_LIFT_EXTENTS = 2e-3  # rays begin that far over the surface
_MIRRORS = 2  # times that a ray is mirrored on by metal
_METAL, _METAL_TANGENT = (
    0.5,
    0.2,
)  # metallic from which on; cone in which metal in a mirror sees its surroundings


@dataclass(frozen=True, eq=False)
class Sight:
    """What is mirrored. eye (3,) : the camera, anchor axes;  background : without the object
    sent, albedo (z, y, x, 3) : nodes of what the object sends, and of its colour
    shows : share of a white surface's light that can be seen"""

    anchor_from_world: Pose
    eye: np.ndarray
    background: Background
    transport: Transport
    sent: np.ndarray
    albedo: np.ndarray
    shows: float

    def along(self, places: np.ndarray, directions: np.ndarray, tangents: np.ndarray) -> np.ndarray:
        """(m, 3) radiance of the planes and the sky, anchor axes. tangents (m,) : of the cones' half-angles"""
        places, directions = (np.ascontiguousarray(a, np.float32) for a in (places, directions))
        cones = tangents.astype(np.float32)
        return np.asarray(background_radiances(places, directions, cones, self.background))

    def of_object(
        self, starts: np.ndarray, directions: np.ndarray, turns: int = _MIRRORS
    ) -> tuple[np.ndarray, np.ndarray]:
        """(rays (m,) that meet the object, before any plane; radiance (m, 3) that it sends there).

        turns : of a ray that metal mirrors on; then metal sends its light in all directions"""
        rays = self.transport.rays
        face, distance = rays.first_hits(starts, directions)
        met = np.flatnonzero(face >= 0)
        for axes in self.transport.planes.axes:
            down = -(directions[met] @ axes[3])
            height = (starts[met] - axes[0]) @ axes[3]
            met = met[(down <= 0) | (distance[met] * down <= height + rays.lift_m)]
        face = face[met]
        places = starts[met] + distance[met, None] * directions[met]
        along = (rays.normals[face] * directions[met]).sum(1, keepdims=True)
        normals = np.where(along > 0, -1.0, 1.0) * rays.normals[face]
        sent = self._at(self.sent, places, normals)
        metal = np.flatnonzero(rays.metallic[face] > _METAL)
        if turns > 0 and len(metal):
            towards = directions[met][metal] + 2 * np.abs(along[metal]) * normals[metal]
            starts = places[metal] + rays.lift_m * normals[metal]
            cones = np.full(len(metal), _METAL_TANGENT)
            seen = self.along(starts, towards, cones)
            again, more = self.of_object(starts, towards, turns - 1)
            seen[again] = more
            tint = self._at(self.albedo, places[metal], normals[metal])
            share = rays.metallic[face[metal], None]
            sent[metal] = (1 - share) * sent[metal] + share * tint * seen
        return met, sent

    def _at(self, nodes: np.ndarray, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
        layers = np.ones(len(places)), normals, places
        row = [np.ascontiguousarray(a[None], np.float32) for a in layers]
        return self.transport.grid.read(nodes, *row, Pose.identity())[0]


def reflected_light(surface: Surface, received: np.ndarray, sight: Sight) -> np.ndarray:
    """(h, w, 3) float32 that the surface sends to the camera, premultiplied by coverage.

    received (h, w, 3) : radiance of a white surface from all but the lamps. Where too little is mirrored to be seen, what
    is mirrored is the light that falls on the surface."""
    covered = (surface.coverage > 0) & ((surface.normal**2).sum(-1) > 1e-6)
    out = np.zeros((*covered.shape, 3), np.float32)
    if not covered.any():
        return out
    turn = sight.anchor_from_world.rotation.astype(np.float32)
    normals = normalise(surface.normal[covered]) @ turn.T
    places = surface.position[covered] @ turn.T
    places = places + sight.anchor_from_world.translation_m.astype(np.float32)
    to_eye = normalise(sight.eye.astype(np.float32) - places)
    facing = (normals * to_eye).sum(1, keepdims=True)
    metallic, roughness, specular = (surface.material[covered][:, k, None] for k in range(3))
    albedo, light = surface.albedo[covered], received[covered]
    a, b = (w[:, None] for w in gloss_weights(roughness[:, 0], facing[:, 0]))
    f0 = 0.08 * specular * (1 - metallic)
    b = np.where(f0 + metallic > 0, b, 0)
    gloss = (f0 + albedo * metallic) * a + b
    diffuse = albedo * (1 - metallic) * (1 - np.minimum(f0 * a + b, 1))
    shines = np.flatnonzero(gloss.max(1) > sight.shows * np.maximum(albedo.max(1), 1e-3))
    mirrored = light.copy()
    wide = widened_roughness(surface.material[..., 1], surface.coverage, surface.normal)[covered]
    n, v, rough = normals[shines], to_eye[shines], wide[shines]
    directions = off_specular_peak(rough, n, 2 * facing[shines] * n - v)
    seen = sight.along(places[shines], directions, mirror_tangent(rough))
    occluded = sight.transport.grid.read(
        sight.transport.occluded,
        surface.coverage,
        surface.normal,
        surface.position,
        sight.anchor_from_world,
    )[covered][shines, 0]
    near = np.flatnonzero(occluded > _OCCLUDED)
    lift = _LIFT_EXTENTS * sight.transport.rays.extent_m
    met, sent = sight.of_object(places[shines][near] + lift * n[near], directions[near])
    seen[near[met]] = sent
    mirrored[shines] = seen
    out[covered] = surface.coverage[covered][:, None] * (diffuse * light + gloss * mirrored)
    return out
