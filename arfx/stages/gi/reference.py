"""Level `reference`: Monte Carlo paths (embree) through the same scenes. It shares with the other
levels what is known before any light travels (which plane a pixel shows, what the picture says of
the planes, and the guess where it says nothing), and no kernel.

Object pixels send paths by their material's lobes; plane pixels towards the ball around the object,
as only paths that meet it count, as what it sends less what it hides. Every pixel gets `gi.samples`
paths: a Sobol sequence that is shifted by numbers of the pixel's own, so that a part of the picture
gets the same as the whole. Not denoised.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering; Cranley, Patterson 1976 (shifted
sequences).
Cost: O(pixels x samples)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from arfx.core.layers import Layer
from arfx.core.noise import noise
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.stage import View
from arfx.stages.gi.incoming import incoming_light
from arfx.stages.gi.plane_change import shown_planes
from arfx.stages.gi.reference_lobes import MaterialLobes, PlaneLobes, dot
from arfx.stages.gi.reference_scene import RayScene, Surroundings
from arfx.stages.gi.reference_sky import Environment
from arfx.stages.gi.reference_tracer import BOUNCES, LOBE, NUMBERS, Tracer
from arfx.stages.light.planes import Planes, texel_positions
from arfx.stages.light.surroundings import frame_surroundings
from arfx.stages.viewing import direction_grid

LEAST_LEFT = 0.05  # of a plane's light, beside other planes
DARKEST = 0.002  # radiance below which a pixel is no base for a ratio
PICTURE_TEXELS = 128  # a side, of what the picture does not show of a plane
BATCH = 1 << 14  # pixels at once: bounds memory
DIMENSIONS = (BOUNCES + 1) * NUMBERS

Draw = Callable[[np.ndarray], np.ndarray]
Rows = tuple[np.ndarray, np.ndarray]  # rows and columns of some pixels


def trace_frame(
    view: View,
    planes: Planes,
    visible_rect: Rect,
    disc: Rect,
    samples: int,
    strength: float,
    gloss: tuple[float, float],
    mirror: Rect,
) -> Mapping[Layer, np.ndarray]:
    """VIRTUAL and SHADOW with indirect light. visible_rect : pixels of the picture that are looked
    at;  disc : planes' pixels
    gloss : of the planes, share mirrored seen from above, and roughness
    mirror : pixels that can mirror the object"""
    scene, rect = view.scene, view.rect
    rays = RayScene(scene)
    known = frame_surroundings(view.facts, scene, view.light)
    cube_from_anchor = known.axes @ scene.world_from_anchor.rotation
    texels = texel_positions(planes, PICTURE_TEXELS)
    incoming = incoming_light(view, visible_rect, planes, texels)
    around = Surroundings(incoming, Environment(known.cubes(), cube_from_anchor))
    tracer = Tracer(rays, around, view.light, scene)
    anchor_from_camera = (view.pose @ scene.world_from_anchor).inverse()
    everywhere, grid = (
        np.ones((rect.height, rect.width)),
        direction_grid(scene.camera),
    )
    shares = shown_planes(view.layers, grid, anchor_from_camera, planes)
    shown = np.stack([everywhere if share is None else share for share in shares])
    pixels = Pixels(view, anchor_from_camera, tracer, shown, sobol(samples))
    virtual, shadow = view[Layer.VIRTUAL].copy(), view[Layer.SHADOW].copy()
    wanted, matt, shiny = (mask_of(rect, part) for part in (view.out, disc, mirror))

    def on_object(rows: Rows) -> None:
        virtual[rows] += pixels.object_light(rows)

    def on_planes(rows: Rows) -> None:
        change = pixels.plane_change(rows, matt[rows], shiny[rows], gloss)
        shadow[rows] += strength * change

    parallel_map(on_object, batches(object_mask(view, view.out)))
    if strength > 0:
        parallel_map(on_planes, batches(wanted & (matt | shiny)))
    return {Layer.VIRTUAL: virtual, Layer.SHADOW: np.maximum(shadow, 0)}


def sobol(samples: int) -> np.ndarray:
    """(samples, DIMENSIONS) of a Sobol sequence: even where their number is a power of two."""
    from scipy.stats import qmc  # takes a second to import

    power = int(samples - 1).bit_length()
    sequence = qmc.Sobol(DIMENSIONS, scramble=False)
    return np.asarray(sequence.random_base2(power)[:samples])


def batches(mask: np.ndarray) -> list[Rows]:
    """Pixels of a mask (h, w), BATCH at a time, row by row."""
    rows, columns = np.nonzero(mask)
    starts = range(0, len(rows), BATCH)
    return [(rows[k : k + BATCH], columns[k : k + BATCH]) for k in starts]


def mask_of(rect: Rect, part: Rect) -> np.ndarray:
    """(h, w) bool: pixels of a rectangle in a part."""
    out = np.zeros((rect.height, rect.width), bool)
    out[part.clip(rect).slices_in(rect)] = True
    return out


def object_mask(view: View, part: Rect) -> np.ndarray:
    """(h, w) bool: pixels of a part that show the object's surface."""
    lengths = np.linalg.norm(view[Layer.NORMAL], axis=-1)
    return mask_of(view.rect, part) & (view[Layer.COVERAGE] > 0) & (lengths > 1e-3)


def object_points(
    view: View, rows: Rows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, 3) each, anchor axes: position, metres, unit normal, and unit direction to the camera of
    what pixels show of the object."""
    anchor = view.scene.world_from_anchor.inverse()
    position = anchor.apply(view[Layer.POSITION][rows].astype(float))
    normal = normalise(view[Layer.NORMAL][rows].astype(float)) @ anchor.rotation.T
    eye = anchor.apply(view.pose.inverse().translation_m)
    return position, normal, normalise(eye - position)


@dataclass(frozen=True, eq=False)
class Pixels:
    """Of one frame. shown (planes, h, w) : is it what a pixel shows, 0..1
    sequence (samples, DIMENSIONS) : of random numbers"""

    view: View
    anchor_from_camera: Pose
    tracer: Tracer
    shown: np.ndarray
    sequence: np.ndarray

    def object_light(self, rows: Rows) -> np.ndarray:
        """(n, 3) indirect light that the object sends to the camera."""
        names = Layer.COVERAGE, Layer.ALBEDO, Layer.MATERIAL
        coverage, albedo, material = (self.view[n][rows].astype(float) for n in names)
        position, normal, towards = object_points(self.view, rows)
        metal, roughness, specular = material.T[:3, :, None]
        f0 = 0.08 * specular * (1 - metal)
        lobes = MaterialLobes(normal, towards, albedo, metal, f0, roughness)
        start = position + self.tracer.rays.lift * normal
        draw = partial(self.tracer.light, start, lobes, False)
        return self._mean(draw, rows) * coverage[:, None]

    def plane_change(
        self,
        rows: Rows,
        matt: np.ndarray,
        shiny: np.ndarray,
        gloss: tuple[float, float],
    ) -> np.ndarray:
        """(n, 3) change of the planes' light by the object, as a share of it.

        matt (n,) : pixels that may change;  shiny (n,) : that may mirror the object, by this
        `gloss`: share seen from above, and roughness"""
        tracer, around, rect = self.tracer, self.tracer.around, self.view.rect
        pixels = np.stack([rows[1] + rect.x0, rows[0] + rect.y0], -1).astype(float)
        seen = self.view.scene.camera.directions(pixels)
        directions = normalise(seen @ self.anchor_from_camera.rotation.T)
        out, eye = np.zeros(directions.shape), self.anchor_from_camera.translation_m
        shares = self.shown[:, rows[0], rows[1]]
        share, axes = shares.max(0), around.axes[shares.argmax(0)]
        falls = -dot(directions, axes[:, 3])
        heights = dot(eye - axes[:, 0], axes[:, 3])
        keep = np.flatnonzero((share > 0) & ((falls > 1e-9) & (heights > 0))[:, 0])
        if not len(keep):
            return out
        rows = rows[0][keep], rows[1][keep]
        directions, normals = directions[keep], axes[keep, 3]
        places = eye + heights[keep] / falls[keep] * directions
        start = places + tracer.rays.lift * normals
        draw = partial(tracer.light, start, tracer.plane_lobes(start, normals), True)
        total = self._mean(draw, rows) * matt[keep, None]
        alone = tracer.plane_light[shares.argmax(0)[keep]]
        others = self._light_of_other_planes(start, normals, rows)
        plane_light = np.maximum(alone + others, LEAST_LEFT * alone)
        # the lamps' shadow is a share of the light that is there alone
        lamps_take = 1 - self.view[Layer.SHADOW][rows]
        brighter = divide(alone, plane_light, where_zero=1.0) - 1
        ratio = divide(total, plane_light) - lamps_take * brighter
        if shiny.any():
            image = self._mirrored(start, normals, directions, gloss, rows)
            ratio += image * shiny[keep, None]
        out[keep] = ratio * share[keep, None]
        return out

    def _mirrored(
        self,
        start: np.ndarray,
        normals: np.ndarray,
        directions: np.ndarray,
        gloss: tuple[float, float],
        rows: Rows,
    ) -> np.ndarray:
        """(n, 3) what the planes' mirror image of the object changes, as a share of the picture."""
        black = np.zeros_like(start)
        f0, roughness = np.broadcast_to(
            np.reshape(gloss, (2, 1, 1)), (2, len(start), 1)
        )
        lobes = MaterialLobes(
            normals, -directions, black, black[:, :1], f0, roughness
        )
        draw = partial(self.tracer.light, start, lobes, True)
        plate = self.view[Layer.PLATE][rows] - np.array(self.view.facts.bias_rgb)
        plate = np.maximum(plate, DARKEST)
        # the picture cannot lose more than it shows
        return np.maximum(self._mean(draw, rows), -plate) / plate

    def _light_of_other_planes(
        self,
        start: np.ndarray,
        normals: np.ndarray,
        rows: Rows,
    ) -> np.ndarray:
        """(n, 3) light of white planes that other planes give them less what they hide, without the
        object."""
        around = self.tracer.around
        if len(around.axes) < 2:
            return np.zeros_like(start)
        lobes = PlaneLobes(start, normals, np.zeros(3), np.inf, all_around=True)

        def draw(numbers: np.ndarray) -> np.ndarray:
            d = lobes.directions(numbers[:, 0, LOBE])
            wide, ends = np.ones_like(start), around.first_plane(start, d)
            sky = around.environment.radiance(d, wide)
            return around.radiance(start, d, *ends, wide) - sky

        return self._mean(draw, rows)

    def _mean(self, draw: Draw, rows: Rows) -> np.ndarray:
        """(n, 3) of all samples of some pixels. draw : one, of numbers (n, BOUNCES + 1, NUMBERS)"""
        (row, column), rect, count = rows, self.view.rect, len(rows[0])
        band = rect._replace(y0=rect.y0 + int(row[0]), y1=rect.y0 + int(row[-1]) + 1)
        drawn = (noise(band, self.view.key, k) for k in range(DIMENSIONS))
        shift = np.stack([each[row - row[0], column] for each in drawn], -1)
        total = np.zeros((count, 3))
        for point in self.sequence:
            numbers = (shift + point) % 1
            total += draw(numbers.reshape(count, BOUNCES + 1, NUMBERS))
        return total / len(self.sequence)
