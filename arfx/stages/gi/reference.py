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

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy import ndarray

from arfx.core.layers import Layer
from arfx.core.noise import noise
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.rect import Rect
from arfx.core.stage import View
from arfx.stages.gi.incoming import incoming_light
from arfx.stages.gi.plane_change import DARKEST, Rows, SeenPlaces, seen_places
from arfx.stages.gi.reference_lobes import MaterialLobes
from arfx.stages.gi.reference_tracer import BOUNCES, NUMBERS, Tracer
from arfx.stages.light.planes import Planes
from arfx.stages.viewing import direction_grid

LEAST_LEFT = 0.05  # of a plane's light, beside other planes
PICTURE_TEXELS = 128  # a side, of what the picture does not show of a plane
BATCH = 1 << 14  # pixels at once: bounds memory
DIMENSIONS = BOUNCES * NUMBERS

Draw = Callable[[ndarray], ndarray]


def trace_frame(
    view: View,
    planes: Planes,
    visible_rect: Rect,
    disc: Rect,
    samples: int,
    strength: float,
    gloss: tuple[float, float],
    mirror: Rect,
) -> Mapping[Layer, ndarray]:
    """VIRTUAL and SHADOW with indirect light. visible_rect : pixels of the picture that are looked
    at;  disc : planes' pixels
    gloss : of the planes, share mirrored seen from above, and roughness
    mirror : pixels that can mirror the object"""
    incoming = incoming_light(view, visible_rect, planes, PICTURE_TEXELS)
    tracer = Tracer(view, incoming)
    pixels = Pixels(view, tracer, sobol(samples))
    virtual, shadow = view[Layer.VIRTUAL].copy(), view[Layer.SHADOW].copy()

    def on_object(rows: Rows) -> None:
        virtual[rows] += pixels.object_light(rows)

    row, column = np.nonzero(object_mask(view, view.out))
    starts = range(0, len(row), BATCH)
    parallel_map(
        on_object, [(row[k : k + BATCH], column[k : k + BATCH]) for k in starts]
    )
    if strength <= 0:
        return {Layer.VIRTUAL: virtual, Layer.SHADOW: shadow}
    matt, shiny = (mask_of(view.rect, part) for part in (disc, mirror))
    inside = mask_of(view.rect, view.out) & (matt | shiny)
    grid = direction_grid(view.scene.camera)
    jobs: list[SeenPlaces] = []
    for k, rows, share, d, places in seen_places(view, view.layers, grid, planes):
        keep = np.flatnonzero(inside[rows])
        for start in range(0, len(keep), BATCH):
            some = keep[start : start + BATCH]
            here = rows[0][some], rows[1][some]
            jobs.append((k, here, share[some], d[some], places[some]))

    def on_plane(job: SeenPlaces) -> None:
        k, rows, share, d, places = job
        change = matt[rows][:, None] * pixels.plane_change(k, rows, places)
        if shiny[rows].any():
            image = pixels.mirrored(k, rows, places, d, gloss)
            change += shiny[rows][:, None] * image
        shadow[rows] += strength * share[:, None] * change

    parallel_map(on_plane, jobs)
    return {Layer.VIRTUAL: virtual, Layer.SHADOW: np.maximum(shadow, 0)}


def sobol(samples: int) -> ndarray:
    """(samples, DIMENSIONS) of a Sobol sequence: even where their number is a power of two."""
    from scipy.stats import qmc  # takes a second to import

    power = int(samples - 1).bit_length()
    sequence = qmc.Sobol(DIMENSIONS, scramble=False)
    return np.asarray(sequence.random_base2(power)[:samples])


def mask_of(rect: Rect, part: Rect) -> ndarray:
    """(h, w) bool: pixels of a rectangle in a part."""
    out = np.zeros((rect.height, rect.width), bool)
    out[part.clip(rect).slices_in(rect)] = True
    return out


def object_mask(view: View, part: Rect) -> ndarray:
    """(h, w) bool: pixels of a part that show the object's surface."""
    lengths = np.linalg.norm(view[Layer.NORMAL], axis=-1)
    return mask_of(view.rect, part) & (view[Layer.COVERAGE] > 0) & (lengths > 1e-3)


def object_points(view: View, rows: Rows) -> tuple[ndarray, ndarray, ndarray]:
    """(n, 3) each, anchor axes: position, metres, unit normal, and unit direction to the camera of
    what pixels show of the object."""
    anchor = view.scene.world_from_anchor.inverse()
    position = anchor.apply(view[Layer.POSITION][rows].astype(float))
    normal = normalise(view[Layer.NORMAL][rows].astype(float)) @ anchor.rotation.T
    eye = anchor.apply(view.pose.inverse().translation_m)
    return position, normal, normalise(eye - position)


@dataclass(frozen=True, eq=False)
class Pixels:
    """Of one frame. sequence (samples, DIMENSIONS) : of random numbers"""

    view: View
    tracer: Tracer
    sequence: ndarray

    def object_light(self, rows: Rows) -> ndarray:
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

    def plane_change(self, plane: int, rows: Rows, places: ndarray) -> ndarray:
        """(n, 3) change of a plane's light by the object, as a share of it. places (n, 3) : of
        `seen_places`"""
        tracer, alone = self.tracer, self.tracer.plane_light[plane]
        start, normals = tracer.over_plane(plane, places)
        lobes = tracer.plane_lobes(start, normals)
        total = self._mean(partial(tracer.light, start, lobes, True), rows)
        others = self._mean(partial(tracer.of_other_planes, start, normals), rows)
        plane_light = np.maximum(alone + others, LEAST_LEFT * alone)
        # the lamps' shadow is a share of the light that is there alone
        brighter = divide(alone, plane_light, where_zero=1.0) - 1
        lamps_take = 1 - self.view[Layer.SHADOW][rows]
        return divide(total, plane_light) - lamps_take * brighter

    def mirrored(
        self,
        plane: int,
        rows: Rows,
        places: ndarray,
        directions: ndarray,
        gloss: tuple[float, float],
    ) -> ndarray:
        """(n, 3) what a plane's mirror image of the object changes, as a share of the picture.

        directions (n, 3) : of `seen_places`"""
        start, normals = self.tracer.over_plane(plane, places)
        black = np.zeros_like(start)
        f0, roughness = (np.full((len(start), 1), value) for value in gloss)
        lobes = MaterialLobes(
            normals, -directions, black, black[:, :1], f0, roughness
        )
        draw = partial(self.tracer.light, start, lobes, True)
        plate = self.view[Layer.PLATE][rows] - np.array(self.view.facts.bias_rgb)
        plate = np.maximum(plate, DARKEST)
        # the picture cannot lose more than it shows
        return np.maximum(self._mean(draw, rows), -plate) / plate

    def _mean(self, draw: Draw, rows: Rows) -> ndarray:
        """(n, 3) of all samples of some pixels. draw : one, of numbers (n, BOUNCES, NUMBERS)"""
        (row, column), rect, count = rows, self.view.rect, len(rows[0])
        band = rect._replace(y0=rect.y0 + int(row[0]), y1=rect.y0 + int(row[-1]) + 1)
        drawn = (noise(band, self.view.key, k) for k in range(DIMENSIONS))
        shift = np.stack([each[row - row[0], column] for each in drawn], -1)
        total = np.zeros((count, 3))
        for point in self.sequence:
            numbers = (shift + point) % 1
            total += draw(numbers.reshape(count, BOUNCES, NUMBERS))
        return total / len(self.sequence)
