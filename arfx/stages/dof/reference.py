"""The reference level: what a thin lens sees, by brute force. Shares no kernel with the other levels.

The real scene: every pixel's light onto every pixel that its circle covers, circles as exact areas (sampled 12 x 12 a
pixel), sums in float64. The virtual object: rays from SAMPLES places of the lens through every pixel onto the model
(embree); the fraction of rays that meet it is its coverage, and a point met has the colour that the pinhole picture has
there. Cost: O(pixels x radius^2) and O(pixels of the object x SAMPLES). Leaves out: colours of points that the pinhole
picture does not show (they take the mean of those met beside them), partly transparent materials."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numba
import numpy as np
from scipy.ndimage import distance_transform_edt

from arfx.core.camera import Camera
from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.stages.dof.corrected import depth_range
from arfx.stages.dof.depth_layers import depth_layers, dioptre_of
from arfx.stages.dof.optics import CircleOfConfusion
from arfx.stages.dof.params import DofParams
from arfx.stages.dof.surfaces import Plane, Real
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.mesh import Mesh, build_mesh
from arfx.stages.triangles import Triangles

SAMPLES = 192
_FINE = 12  # points a pixel's side by which the area of a circle in it is found
_RADII = 32  # circles a pixel of radius
_BATCH_PX = 2048


Prepared = tuple[Mesh, Triangles, LensTable]  # of the camera


def prepare(scene: Scene) -> Prepared:
    mesh = build_mesh(scene)
    return mesh, Triangles(mesh.corners_m, robust=True), LensTable(scene.camera)


def render(
    now: Layers, facts: FrameFacts, scene: Scene, real: Real, coc: CircleOfConfusion, params: DofParams, prepared: Prepared
) -> np.ndarray:
    """IMAGE (h, w, 3) of a frame with a pose."""
    rect, opacity = now.rect, float(facts.opacity)
    plate, shadow = now[Layer.PLATE].astype(float), now[Layer.SHADOW].astype(float)
    behind = plate + opacity * (plate * (shadow - 1) + np.asarray(facts.bias_rgb) * (1 - shadow))
    pixels = np.meshgrid(np.arange(rect.x0, rect.x1), np.arange(rect.y0, rect.y1))
    ideal = scene.camera.normalised(np.stack(pixels, -1).astype(float))
    directions = np.concatenate([np.where(np.isfinite(ideal), ideal, 0.0), np.ones((*ideal.shape[:2], 1))], -1)
    out = behind
    if params.scope == "all":
        depth = now[Layer.REAL_DEPTH] if real.tiles is not None else None
        out = _real(behind, directions, real, coc, params, scene.camera, depth)
    fraction, colour = _object(now, facts, scene, coc, params, prepared)
    return (out * (1 - opacity * fraction[..., None]) + opacity * colour).astype(np.float32)


def lens_points(blades: int, turn_deg: float, count: int = SAMPLES) -> np.ndarray:
    """(count, 2) places on a lens of the area of the unit disc, evenly (sunflower spiral; folded into the polygon)."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3 - np.sqrt(5))
    if blades >= 3:  # stretch every ray from the centre to the polygon's edge, at the same fraction of the area
        wedge = 2 * np.pi / blades
        edge = np.sqrt(2 * np.pi / (blades * np.sin(wedge))) * np.cos(wedge / 2)
        number, part = np.divmod(angle, wedge)
        # angles whose density follows the polygon's squared edge distance, as its area does
        angle = number * wedge + wedge / 2 + np.arctan((2 * part / wedge - 1) * np.tan(wedge / 2))
        radius = radius * edge / np.cos(angle % wedge - wedge / 2)
        angle = angle + np.radians(turn_deg)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)


def _real(
    behind: np.ndarray, directions: np.ndarray, real: Real, coc: CircleOfConfusion, params: DofParams, camera: Camera,
    depth_m: np.ndarray | None,
) -> np.ndarray:  # fmt: skip
    """The real scene through the lens, (h, w, 3)."""
    if depth_m is not None:
        return _measured(behind, depth_m, coc, params)
    dioptre = np.full(behind.shape[:2], real.background)
    if real.base is not None:
        dioptre = np.maximum(directions @ real.base.forms[2], dioptre)
    free = np.ones(behind.shape[:2])
    layers = []
    for plane in reversed(real.finite_planes):  # nearest first
        shown = free * _shown(plane, directions)
        free = free - shown
        layers.append((plane, shown))
    out = _normal(_scattered(behind, free, coc.radius_px(dioptre), params), behind)
    for plane, shown in reversed(layers):
        radius = coc.radius_px(np.maximum(directions @ plane.forms[2], 0))
        front = _normal(_scattered(behind, shown, radius, params), behind)
        fraction = np.zeros(free.shape)
        for point in lens_points(params.blades, params.blade_turn_deg):
            fraction += _shown(plane, directions, point * coc.px_per_dioptre / camera.fx, coc.focus)
        out = out + (front - out) * (fraction / SAMPLES)[..., None]
    return out


def _measured(behind: np.ndarray, depth_m: np.ndarray, coc: CircleOfConfusion, params: DofParams) -> np.ndarray:
    """By measured depth: layers as in `depth_layers`, each spread by exact discs."""
    prepared = depth_layers(behind.astype(np.float32), dioptre_of(depth_m), coc)
    whole = np.ones(behind.shape[:2])
    out = _normal(_scattered(prepared.base.astype(float), whole, prepared.radius.astype(float), params), behind)
    for front in prepared.fronts:
        _, nearest = distance_transform_edt(front.radius < 0, return_indices=True)  # of the nearest pixel that has one
        radius = front.radius[tuple(nearest)].astype(float)
        coverage = front.coverage.astype(float)
        light = _scattered(divide(front.colour, coverage[..., None]), coverage, radius, params)
        through = _scattered(np.zeros_like(behind), 1 - coverage, radius, params)[..., 3]
        fraction = divide(light[..., 3], light[..., 3] + through)[..., None]
        out = out + (_normal(light, out) - out) * fraction
    return out


def _shown(plane: Plane, directions: np.ndarray, lens_m: np.ndarray | None = None, focus: float = 0.0) -> np.ndarray:
    """1 where the ray from a place on the lens that meets the pixel's direction in the focus meets the plane's square."""
    if lens_m is None:
        p = directions @ plane.forms.T
    else:
        # from o = (a, b, 0) along d - focus x o: at depth z, o + z (d - focus o) = z (d + (1/z - focus) o)
        shift = np.array([*lens_m, 0.0])
        d = directions - focus * shift
        along, from_lens = d @ plane.forms.T, plane.forms @ shift
        dioptre = divide(along[..., 2], 1 - from_lens[2])  # 1/z of a point z (d + o/z) on the plane
        p = np.stack([along[..., 0] + from_lens[0] * dioptre, along[..., 1] + from_lens[1] * dioptre, dioptre], -1)
    return ((p[..., 2] > 0) & (np.abs(p[..., :2]).max(-1) <= plane.half_m * p[..., 2])).astype(float)


def _scattered(colour: np.ndarray, weight: np.ndarray, radius: np.ndarray, params: DofParams) -> np.ndarray:
    """(h, w, 4) sums of light and weight."""
    boost = params.highlight_boost * np.clip((colour.max(-1) - 0.9) / 0.1, 0, 1)
    light = np.concatenate([colour * (1 + boost[..., None]), np.ones_like(colour[..., :1])], -1) * weight[..., None]
    index = np.round(radius * _RADII).astype(np.int64)
    used = np.unique(index)
    kernels = [_disc(int(q) / _RADII, params.blades, params.blade_turn_deg) for q in used]
    start = np.cumsum([0] + [k.size for k in kernels])[:-1]
    half = np.array([k.shape[0] // 2 for k in kernels])
    which = np.searchsorted(used, index)
    return _scatter(light, which, np.concatenate([k.ravel() for k in kernels]), start, half)


def _disc(radius: float, blades: int, turn_deg: float) -> np.ndarray:
    """(n, n) fraction of the shape's area in every pixel, sum 1."""
    corner = 1.0 if blades < 3 else np.sqrt(2 * np.pi / (blades * np.sin(2 * np.pi / blades)))
    half = max(int(np.ceil(radius * corner - 0.5)), 0)
    if radius <= 0.5 and blades < 3:
        return np.ones((1, 1))
    p = (np.arange((2 * half + 1) * _FINE) + 0.5) / _FINE - half - 0.5
    x, y = np.meshgrid(p, p)
    if blades < 3:
        inside = x * x + y * y <= radius * radius
    else:
        wedge = 2 * np.pi / blades
        angle = (np.arctan2(y, x) - np.radians(turn_deg)) % wedge - wedge / 2
        inside = np.hypot(x, y) * np.cos(angle) <= radius * corner * np.cos(wedge / 2)
    area = inside.reshape(2 * half + 1, _FINE, 2 * half + 1, _FINE).sum((1, 3)).astype(float)
    total = area.sum()
    return area / total if total > 0 else np.ones((1, 1))


@numba.njit(cache=True, nogil=True)
def _scatter(light, which, kernels, start, half):  # pragma: no cover - compiled
    h, w = which.shape
    out = np.zeros((h, w, 4))
    for y in range(h):
        for x in range(w):
            if light[y, x, 3] <= 0:
                continue
            k = which[y, x]
            n, s = half[k], start[k]
            side = 2 * n + 1
            for j in range(max(y - n, 0), min(y + n + 1, h)):
                for i in range(max(x - n, 0), min(x + n + 1, w)):
                    fraction = kernels[s + (j - y + n) * side + i - x + n]
                    if fraction > 0:
                        for c in range(4):
                            out[j, i, c] += fraction * light[y, x, c]
    return out


def _normal(sums: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    known = sums[..., 3:] > 1e-9
    return np.where(known, divide(sums[..., :3], sums[..., 3:]), otherwise)


def _object(
    now: Layers, facts: FrameFacts, scene: Scene, coc: CircleOfConfusion, params: DofParams, prepared: Prepared
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the lens that sees the object (h, w), and its premultiplied colour (h, w, 3)."""
    fraction, colour = np.zeros((now.rect.height, now.rect.width)), np.zeros((now.rect.height, now.rect.width, 3))
    (mesh, rays, directions), pose = prepared, facts.pose
    near, far = depth_range(facts)
    reach = coc.largest_px((1 / near, 1 / far))
    corner = 1.0 if params.blades < 3 else 1.3
    box = facts.raster_box.pad(int(np.ceil(corner * reach)) + 1).clip(now.rect)
    if facts.model_box.empty or box.empty:
        return fraction, colour
    radius_m = coc.px_per_dioptre / scene.camera.fx
    lens = lens_points(params.blades, params.blade_turn_deg) * radius_m
    step = np.array([0.7548776662466927, 0.5698402909980532])  # R2 sequence (Roberts 2018): places within the pixel
    inner = (0.5 + np.arange(1, SAMPLES + 1)[:, None] * step) % 1.0 - 0.5
    eye = pose.inverse().translation_m - mesh.centre_m
    rows = max(_BATCH_PX // box.width, 1)
    for top in range(box.y0, box.y1, rows):
        part = Rect(box.x0, top, box.x1, min(top + rows, box.y1))
        sums = np.zeros((part.height, part.width, 5))
        y, x = np.arange(part.y0, part.y1, dtype=float), np.arange(part.x0, part.x1, dtype=float)
        d = np.stack([directions.at(y + dy, x + dx) for dx, dy in inner], 2)  # (h, w, s, 2)
        ok = np.isfinite(d).all(-1)
        d = np.where(ok[..., None], d, 0.0)
        origin = np.concatenate([lens, np.zeros((SAMPLES, 1))], 1)
        along = np.concatenate([d - coc.focus * lens, np.ones((*d.shape[:3], 1))], -1)
        start = np.broadcast_to(eye + origin @ pose.rotation, along.shape).reshape(-1, 3)
        hit = rays.first_hits(
            np.ascontiguousarray(start, np.float32), np.ascontiguousarray((along @ pose.rotation).reshape(-1, 3), np.float32)
        )
        met = (hit["primID"] >= 0) & ok.reshape(-1)
        z = np.asarray(hit["tfar"], float)[met]
        pixel = np.repeat(np.arange(part.area), SAMPLES)[met]
        points = np.broadcast_to(origin, along.shape).reshape(-1, 3)[met] + z[:, None] * along.reshape(-1, 3)[met]
        _look_up(sums.reshape(-1, 5), pixel, points, now, scene.camera)
        s = sums / SAMPLES
        known = divide(sums[..., 0:3], sums[..., 3:4])
        at_part = part.slices_in(now.rect)
        fraction[at_part] = s[..., 4]
        colour[at_part] = known * s[..., 4:5]
    return fraction, colour


def _look_up(sums: np.ndarray, pixel: np.ndarray, points: np.ndarray, now: Layers, camera: Camera) -> None:
    """Add to sums (n, 5): colour and number of the points that the pinhole picture shows, number of all that are opaque."""
    place = camera.project(points) - [now.rect.x0, now.rect.y0]
    h, w = now.rect.height, now.rect.width
    known = np.isfinite(place).all(1)
    place = np.where(known[:, None], place, 0.0)
    low = np.floor(place).astype(int)
    part = place - low
    total, opaque = np.zeros((len(points), 4)), np.zeros(len(points))
    for dy in (0, 1):
        for dx in (0, 1):
            y, x = np.clip(low[:, 1] + dy, 0, h - 1), np.clip(low[:, 0] + dx, 0, w - 1)
            cover = now[Layer.COVERAGE][y, x].astype(float)
            depth = now[Layer.DEPTH][y, x].astype(float)
            same = (cover > 0) & (np.abs(depth - points[:, 2]) < 0.02 * points[:, 2])
            fraction = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1]) * same
            total[:, :3] += fraction[:, None] * now[Layer.VIRTUAL][y, x]
            total[:, 3] += fraction * cover
            opaque = np.maximum(opaque, cover)
    # a point inside the picture where nothing is drawn is a hole that its material is cut out of
    inside = known & (place >= 0).all(1) & (place[:, 0] <= w - 1) & (place[:, 1] <= h - 1)
    solid = (opaque > 0) | ~inside
    shown = known & (total[:, 3] > 1e-3)
    colour = divide(total[:, :3], total[:, 3:])
    for c in range(3):
        sums[:, c] += np.bincount(pixel[shown], colour[shown, c], len(sums))
    sums[:, 3] += np.bincount(pixel[shown], minlength=len(sums))
    sums[:, 4] += np.bincount(pixel[solid], minlength=len(sums))
