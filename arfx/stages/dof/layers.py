"""What a frame's lens blurs, for every level but the reference: layers of light, the real scene
farthest.

The virtual object, real planes of limited size and what was measured before the focus are layers
of their own, with coverage and a blur radius that goes on outside of their outline. What the
outline lets through is then spread with the same discs as what it covers: both weights add up
to 1, and coverage is right inside, at the edge, and where near parts stand before far ones.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import EPS_DEPTH_M, divide
from arfx.core.rect import Rect
from arfx.stages.dof.aperture import SHARP_PX
from arfx.stages.dof.depth_layers import depth_layers, dioptre_of
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.planes import Real
from arfx.stages.viewing import between_nodes

_TILE_PX = 8  # tiles of the frame over which a radius is averaged before it goes on


@dataclass(frozen=True, eq=False)
class LightLayer:
    """Something that sends light, over `rect`.

    light : (h, w, 4) float32, colour premultiplied by coverage, and coverage; of one before the
        real
        scene (h, w, 5), and the weight of what it lets through
    radius : (h, w) float32, px, of its blur, also where nothing is covered"""

    rect: Rect
    light: ndarray
    radius: ndarray


def depth_range(facts: FrameFacts) -> tuple[float, float]:
    """Nearest and farthest distance, m, that a point of the object can have; a little wider for
    rounding."""
    near, far = facts.depth_range_m
    near = max(near * 0.999, EPS_DEPTH_M)
    return near, max(far * 1.001, near)


def object_radius_px(facts: FrameFacts, coc: CircleOfConfusion) -> float:
    """Bound of the blur's radius on the virtual object; 0 where none is in view."""
    near, far = depth_range(facts)
    return 0.0 if facts.model_box.empty else coc.largest_px((1 / near, 1 / far))


def object_box(facts: FrameFacts, frame: Rect, reach_px: float) -> Rect:
    """Pixels that the object's blur may change."""
    return facts.raster_box.pad(int(np.ceil(reach_px)) + 1).clip(frame)


def layers_of_light(
    now: Layers,
    facts: FrameFacts,
    real: Real,
    grid: ndarray,
    coc: CircleOfConfusion,
    params: DofParams,
) -> list[LightLayer]:
    """Of a frame with a pose, farthest first; the first covers all of `now`."""
    out, rect = real_layers(now, facts, real, grid, coc, params), now.rect
    box = facts.raster_box.clip(rect)
    if not box.empty:
        light, radius = _object(now.crop(box), facts, coc)
        if light[..., 3].any():
            out.append(_occluder(rect, box, light, radius))
    return out


def real_layers(
    now: Layers,
    facts: FrameFacts,
    real: Real,
    grid: ndarray,
    coc: CircleOfConfusion,
    params: DofParams,
) -> list[LightLayer]:
    """The same of the real scene alone."""
    rect, behind = now.rect, behind_object(now, facts)
    if params.scope != "all":
        return [LightLayer(rect, behind, np.zeros(behind.shape[:2], np.float32))]
    if real.tiles is not None:
        return _measured(rect, behind, dioptre_of(now[Layer.REAL_DEPTH]), coc)
    return _planes(rect, behind, real, grid, coc)


def behind_object(now: Layers, facts: FrameFacts) -> ndarray:
    """(h, w, 4) the real scene under its shadow, without the object; coverage 1."""
    out = cv2.cvtColor(now[Layer.IMAGE], cv2.COLOR_RGB2RGBA)
    box = facts.raster_box.clip(now.rect)
    if not box.empty:
        part = now.crop(box)
        plate, taken = part[Layer.PLATE], 1 - part[Layer.SHADOW]
        taken = taken * np.float32(facts.opacity)
        if facts.opacity < 1:
            # what shows through an object that fades has no shadow where it is covered, as in the
            # composite
            covered = part[Layer.COVERAGE][..., None]
            taken *= (1 - covered) / (1 - np.float32(facts.opacity) * covered)
        shaded = plate + (np.array(facts.bias_rgb, np.float32) - plate) * taken
        cv2.cvtColor(shaded, cv2.COLOR_RGB2RGBA, dst=out[box.slices_in(now.rect)])
    return out


def _planes(
    rect: Rect,
    behind: ndarray,
    real: Real,
    grid: ndarray,
    coc: CircleOfConfusion,
) -> list[LightLayer]:
    """The endless plane, and planes of limited size before it."""
    visible, fronts = np.ones((rect.height, rect.width), np.float32), []
    for plane in reversed(real.finite_planes):  # the nearest hides the others
        positions = between_nodes(plane.positions(grid), rect)
        inside = visible * plane.within(positions)
        visible = visible - inside
        if inside.any():
            radius = coc.radius_px(np.maximum(positions[..., 2], 0))
            fronts.append(_occluder(rect, rect, behind * inside[..., None], radius))
    if fronts:
        behind = behind * visible[..., None]
    radius = coc.radius_px(real.dioptres(grid, rect))
    return [LightLayer(rect, behind, radius), *reversed(fronts)]


def _measured(
    rect: Rect, behind: ndarray, dioptre: ndarray, coc: CircleOfConfusion
) -> list[LightLayer]:
    (light, radius), *fronts = depth_layers(behind, dioptre, coc)
    before = (_occluder(rect, rect, *front) for front in fronts)
    return [LightLayer(rect, light, radius), *before]


def _object(
    now: Layers, facts: FrameFacts, coc: CircleOfConfusion
) -> tuple[ndarray, ndarray]:
    """Light and radius of the virtual object; sharp where its depth is not a distance."""
    depth, (near, far) = now[Layer.DEPTH], depth_range(facts)
    known = depth > 0
    dioptre = 1 / np.clip(
        np.where(known, depth, near), np.float32(near), np.float32(far)
    )
    radius = np.where(known, coc.radius_px(dioptre), np.float32(0))
    light = cv2.cvtColor(now[Layer.VIRTUAL], cv2.COLOR_RGB2RGBA)
    coverage = np.fmax(now[Layer.COVERAGE], np.float32(0))  # not a number is none
    cv2.insertChannel(coverage, light, 3)
    if facts.opacity < 1:
        light = light * np.float32(facts.opacity)
    return light, radius


def _occluder(area: Rect, box: Rect, light: ndarray, radius: ndarray) -> LightLayer:
    """A layer over as much of `area` as it and its blur take. light, radius : over `box`"""
    covered = box_of(light[..., 3])
    light, radius = light[covered.slices], radius[covered.slices]
    box, coverage = covered.shift(box.x0, box.y0), light[..., 3]
    within = radius * (coverage > 0)
    rect = box.pad(int(np.ceil(2 * float(within.max()))) + 1).clip(area)
    shape, at = (rect.height, rect.width), box.slices_in(rect)
    padded = np.zeros((5, *shape), np.float32)
    for channel, values in zip(padded, cv2.split(light), strict=False):
        channel[at] = values * (coverage > 0)
    padded[4] = 1 - padded[3]
    around = np.zeros(shape, np.float32)
    around[at] = within
    if within.max() > SHARP_PX:
        outside = _radius_around(rect, padded[3], around)
        around = np.where(padded[3] > 0, around, outside)
    return LightLayer(rect, cv2.merge(list(padded)), around)


def _radius_around(rect: Rect, coverage: ndarray, radius: ndarray) -> ndarray:
    """(h, w) px: the mean radius of the nearest tile that anything covers, linear between tiles.

    Tiles lie on the frame's grid, so a pixel gets the same from any rectangle that holds what is
    near."""
    tiles = rect.align(_TILE_PX, _TILE_PX)
    inner = rect.slices_in(tiles)
    sums = np.zeros((2, tiles.height, tiles.width), np.float32)
    sums[(0, *inner)], sums[(1, *inner)] = coverage * radius, coverage
    size = tiles.width // _TILE_PX, tiles.height // _TILE_PX
    total, weight = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in sums)
    known, means = weight > 0, divide(total, weight).astype(np.float32)
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(nearest.max() + 1, np.float32)
    of_label[nearest[known]] = means[known]
    whole = cv2.resize(of_label[nearest], (tiles.width, tiles.height))
    return whole[inner]


def box_of(mask: ndarray) -> Rect:
    """Smallest rectangle that holds what is not 0."""
    x, y, width, height = cv2.boundingRect((mask != 0).view(np.uint8))
    return Rect(x, y, x + width, y + height)
