"""Indirect light that the object's pixels send to the camera: all that falls on them, and
what they mirror.

Gloss: the surroundings in a cone about the lobe's middle, as wide as the roughness asks;
where the object hides some of its own surroundings a ray along that middle shows which, and
a wide lobe rather the light that falls on the place. Cost: O(covered pixels + rays).
Source: docs/methods/gi.md#gloss."""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.pose import Pose
from arfx.core.vectors import dot, minus, mixed, placed, scaled, turned, unit
from arfx.stages.gi.background import Background, behind_object
from arfx.stages.gi.gloss import mirror_tangent, widened_roughness
from arfx.stages.light.split_sum import split_sum
from arfx.stages.light.transport import Transport
from arfx.stages.lightmap.shading import SMOOTHEST, Surface, reflected_shares

# shares of a place's hemisphere that the object hides: from the first on a ray is sent, from
# the second on the widest lobe shows the light that falls on the place
_OCCLUDED, _MUCH = 0.01, 0.1
_LIFT_EXTENTS = 2e-3  # rays begin that far over the surface
_MIRRORS = 2  # times that a ray is mirrored on by metal
_METAL = 0.5  # metallic from which on what a mirror shows of it is mirrored on
_METAL_ROUGHNESS = 0.27  # of metal that is seen in a mirror


@dataclass(frozen=True, eq=False)
class Sight:
    """What is mirrored. eye (3,) : the camera, anchor axes;  background : without the object
    sent (z, y, x, 3) : nodes of what the object sends
    shows : share of a white surface's light that can be seen"""

    anchor_from_world: Pose
    eye: ndarray
    background: Background
    transport: Transport
    sent: ndarray
    shows: float

    def of_object(
        self, starts: ndarray, directions: ndarray, turns: int = _MIRRORS
    ) -> tuple[ndarray, ndarray]:
        """(rays (m,) that meet the object, before any plane; radiance (m, 3) that it sends there).

        turns : of a ray that metal mirrors on; then metal sends its light in all directions
        """
        rays = self.transport.rays
        face, distance = rays.first_hits(starts, directions)
        met = np.flatnonzero(face >= 0)
        planes = self.transport.planes
        _, plane_m = planes.first_met(starts[met], directions[met])
        met = met[distance[met] <= plane_m + rays.lift_m]
        face = face[met]
        places = starts[met] + distance[met, None] * directions[met]
        along = (rays.normals[face] * directions[met]).sum(1, keepdims=True)
        normals = np.where(along > 0, -1.0, 1.0) * rays.normals[face]
        sent = self._at(self.sent, places, normals)
        metal = np.flatnonzero(rays.metallic[face] > _METAL)
        if turns > 0 and len(metal):
            towards = (
                directions[met][metal] + 2 * np.abs(along[metal]) * normals[metal]
            )
            starts = places[metal] + rays.lift_m * normals[metal]
            rough = np.full(len(metal), _METAL_ROUGHNESS)
            seen = behind_object(self.background, starts, towards, rough)
            again, more = self.of_object(starts, towards, turns - 1)
            seen[again] = more
            tint = self._at(self.transport.colours, places[metal], normals[metal])
            share = rays.metallic[face[metal], None]
            sent[metal] = (1 - share) * sent[metal] + share * tint * seen
        return met, sent

    def _at(self, nodes: ndarray, places: ndarray, normals: ndarray) -> ndarray:
        covered = np.ones((1, len(places)), np.float32)
        row = normals[None].astype(np.float32), places[None].astype(np.float32)
        grid = self.transport.grid
        return np.asarray(
            grid.read(nodes, covered, row[0], row[1], Pose.identity())[0]
        )


def reflected_light(surface: Surface, received: ndarray, sight: Sight) -> ndarray:
    """(h, w, 3) float32 that the surface sends to the camera, premultiplied by coverage.

    received (h, w, 3) : radiance of a white surface from all but the lamps. Where too
    little is mirrored to be seen, what is mirrored is the light that falls on the
    surface."""
    roughness = np.ascontiguousarray(surface.material[..., 1])
    wide = widened_roughness(roughness, surface.coverage, surface.normal).astype(
        np.float32
    )
    anchor = sight.anchor_from_world
    matrix, eye = anchor.matrix.astype(np.float32), sight.eye.astype(np.float32)
    out = np.zeros((*surface.coverage.shape, 3), np.float32)
    pixels = np.empty((surface.coverage.size, 2), np.int64)
    lobes = np.empty((surface.coverage.size, 13), np.float32)
    of_light = received, matrix, eye, split_sum(), np.float32(sight.shows)
    count = _lobes(out, pixels, lobes, surface, wide, *of_light)
    if not count:
        return out
    lobes, (row, column) = lobes[:count], pixels[:count].T
    places, normals, directions, rough, weights = np.split(lobes, [3, 6, 9, 10], 1)
    seen = behind_object(sight.background, places, directions, rough[:, 0])
    layers = surface.coverage, surface.normal, surface.position
    grid = sight.transport.grid
    occluded = grid.read(sight.transport.occluded, *layers, anchor)[row, column, 0]
    near = np.flatnonzero(occluded > _OCCLUDED)
    lift = _LIFT_EXTENTS * sight.transport.rays.extent_m
    met, sent = sight.of_object(places[near] + lift * normals[near], directions[near])
    seen[near[met]] = sent
    tangent = mirror_tangent(rough[near, 0])
    wide = tangent / np.hypot(1, tangent)
    share = wide * np.clip((occluded[near] - _OCCLUDED) / (_MUCH - _OCCLUDED), 0, 1)
    seen[near] += share[:, None] * (received[row[near], column[near]] - seen[near])
    out[row, column] += weights * seen
    return out


@line_kernel(fastmath=FAST, error_model="numpy")
def _lobes(
    out, pixels, lobes, surface: Surface, wide, received, matrix, eye, table, shows
):  # pragma: no cover - compiled
    """How many pixels there are whose mirrored light shows.

    pixels (n, 2) : those;  lobes (n, 13) : place, normal, direction, roughness, weights of
    each, anchor axes
    out (h, w, 3) += what the pixels send of the light that falls on them; of those pixels
    the matt part alone
    wide (h, w) : roughness, no less than a pixel of the curved surface holds;  matrix (4,
    4) : anchor from world
    """
    coverage, normal, position, albedo, material, _ = surface
    zero, one, count = np.float32(0), np.float32(1), 0
    for y in range(coverage.shape[0]):
        for x in range(coverage.shape[1]):
            cover, to, colour = coverage[y, x], lobes[count], albedo[y, x]
            n = turned(matrix, normal[y, x])
            if cover <= zero or not dot(n, n) > np.float32(1e-6):
                continue
            n, place = unit(n), placed(matrix, position[y, x])
            view = unit(minus(eye, place))
            facing = dot(view, n)
            metal, specular = material[y, x, 0], material[y, x, 2]
            rough = max(material[y, x, 1], np.float32(SMOOTHEST))
            n_v = max(facing, np.float32(1e-3))
            shares = reflected_shares(table, metal, rough, specular, n_v)
            matt, coat, direct, grazing, lost = shares
            brightest, strongest = np.float32(1e-3), zero
            for k in range(3):
                mirrored = metal * (colour[k] * direct + grazing)
                mirrored *= one + colour[k] * lost
                to[10 + k] = cover * ((one - metal) * coat + mirrored)
                brightest, strongest = (
                    max(brightest, colour[k]),
                    max(strongest, to[10 + k]),
                )
            shines = strongest > shows * brightest * cover
            for k in range(3):
                gloss = zero if shines else to[10 + k]
                out[y, x, k] = (cover * matt * colour[k] + gloss) * received[y, x, k]
            if not shines:
                continue
            spread = min(wide[y, x] * wide[y, x], one)
            lean = (one - spread) * (np.sqrt(one - spread) + spread)
            middle = unit(mixed(n, minus(scaled(2 * facing, n), view), lean))
            to[0], to[1], to[2] = place
            to[3], to[4], to[5] = n
            to[6], to[7], to[8] = middle
            to[9] = wide[y, x]
            pixels[count, 0], pixels[count, 1] = y, x
            count += 1
    return count
