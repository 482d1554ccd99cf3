"""The `rays` back end: one ray per pixel, more along edges, attributes by compiled loops. Needs no OpenGL.

First hits come from testing each ray against the faces near it (visibility.py), hits behind transparent ones from embree.
More than one ray is sent only where an outline, a sharp edge or a cut-out passes through the pixel (edges.py). Directions
are those of the distorted camera, so nothing is warped. Transparent layers are followed front to back, up to MAX_LAYERS.
Cost: O(faces + pixels of the rectangle + edge pixels x samples); measured in `Raster.levels`."""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera
from arfx.core.layers import Layer, neutral, uninitialised
from arfx.core.numerics import EPS_DEPTH_M
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.raster import hits, surface
from arfx.stages.raster.arrays import (
    COLUMNS,
    OUTPUTS,
    GBuffer,
    Hits,
    Samples,
    View,
    fragments,
    no_samples,
    view,
)
from arfx.stages.raster.edges import add_differences, edge_pixels
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.mesh import CUTOFF, EMIT_R, Mesh
from arfx.stages.raster.visibility import face_boxes, nearest_faces, nearest_faces_at
from arfx.stages.triangles import Triangles

MAX_LAYERS = 8
# A ray goes on this far behind a hit, as a fraction of the depth: four steps of float32.
_ONWARD = np.float32(4 * 1.2e-7)
_TILE_RAYS = 1 << 20  # rays in flight: bounds memory to about 150 MB


def lattice(count: int) -> np.ndarray:
    """(count, 2) offsets in px, -0.5..0.5: every column and every row of a count x count grid holds one, at steps of the golden
    section (Korobov). Edges at all angles are a quarter better covered than by Hammersley's points."""
    steps = [a for a in range(2, count) if np.gcd(a, count) == 1] or [1]
    step = min(steps, key=lambda a: abs(a - count * (3 - 5**0.5) / 2))
    i = np.arange(count)
    return (np.stack([i, i * step % count], 1) + 0.5) / count - 0.5


class RayRenderer:
    """Renders rectangles of one mesh through one camera.

    samples : per edge pixel; of a mesh with transparency a quarter, because each one is followed through it
    A texture gets half as many taps along a pixel's side as there are samples along it."""

    any_rectangle = True

    def __init__(self, mesh: Mesh, camera: Camera, samples: int) -> None:
        self.mesh, self.camera, self.lens = mesh, camera, LensTable(camera)
        self.scene = Triangles(mesh.corners_m, robust=True)
        self.offsets = lattice(max(samples // 4, min(samples, 4)) if mesh.layered else samples)
        self.order = np.argsort((self.offsets**2).sum(1), kind="stable")
        self.taps = max(round(np.sqrt(samples) / 2), 1)
        self.pixel = float(1.0 / np.sqrt(camera.fx * camera.fy))
        self.glows = bool(mesh.floats[:, EMIT_R:CUTOFF].any())

    def render(self, rect: Rect, camera_from_world: Pose) -> dict[Layer, np.ndarray]:
        """All layers of OUTPUTS over `rect`, which lies in the frame."""
        clear = (
            rect.empty or self.mesh.layered
        )  # else each pixel is written; EMISSIVE only where something glows
        out = {
            n: neutral(n, rect) if clear or n is Layer.EMISSIVE else uninitialised(n, rect)
            for n in OUTPUTS
        }
        if rect.empty:
            return out
        height = max(_TILE_RAYS // rect.width, 1)
        for top in range(rect.y0, rect.y1, height):
            strip = Rect(rect.x0, top, rect.x1, min(top + height, rect.y1))
            self._strip(
                strip, camera_from_world, {k: v[strip.slices_in(rect)] for k, v in out.items()}
            )
        return out

    def _strip(self, rect: Rect, camera_from_world: Pose, out: dict[Layer, np.ndarray]) -> None:
        # One pixel more on each side, so that a pixel's neighbours do not depend on the rectangle asked for.
        wide = rect.pad(1)
        h, w, m = wide.height, wide.width, self.mesh
        lens = np.ascontiguousarray(self.lens.directions(wide.pad(1)))
        seen_from = view(lens, camera_from_world, self.pixel, self.taps)
        eye = seen_from.eye - m.centre_m
        points = Pose(camera_from_world.rotation, camera_from_world.apply(m.centre_m)).apply(
            m.vertices
        )
        box = face_boxes(points, self.camera.project(points), m.faces, self.camera, wide)
        x, y = (np.ascontiguousarray(lens[1:-1, 1:-1, k], float) for k in range(2))
        *nearest, front = nearest_faces(points, m.faces, m.hidden, box, x, y, EPS_DEPTH_M)
        first_hits = Hits(*(a.ravel() for a in nearest))
        prim, depth = first_hits.face, first_hits.depth
        edge = edge_pixels(m, self.camera, points, front, wide, depth.reshape(h, w)).ravel()
        add_differences(
            edge, prim, depth, m.part, m.face_normal, lens, h, w, seen_from.rotation, self.pixel
        )
        layers, centres = GBuffer(*(out[name] for name in OUTPUTS)), None
        if not m.layered:
            later = np.empty(h * w, np.int64)
            later = later[
                : surface.write_centres(
                    first_hits, edge, seen_from, self.glows, m.surfaces, later, layers
                )
            ]
            own = np.ascontiguousarray(lens[1:-1, 1:-1]).reshape(-1, 1, 2)[later]
            surface.write_edges(
                later,
                own,
                np.zeros(1, np.int64),
                Hits(*(a[later] for a in first_hits)),
                first_hits,
                seen_from,
                self.glows,
                m.surfaces,
                fragments(1),
                layers,
            )
        else:
            directions, valid = hits.world_directions(lens[1:-1, 1:-1], seen_from.rotation)
            centres, masked = self._trace(eye, directions, valid, first_hits, seen_from)
            edge |= masked  # a mean of opacities says little about where a cut-out ends: sampled instead
            hits.resolve_centres(h, w, edge, centres, directions, seen_from.eye, layers)
        inner = edge.reshape(h, w).copy()
        inner[[0, -1]], inner[:, [0, -1]] = False, False
        pixels = np.flatnonzero(inner)
        count = len(self.offsets)
        for start in range(0, len(pixels), max(_TILE_RAYS // count, 1)):
            chunk = pixels[start : start + max(_TILE_RAYS // count, 1)]
            inside = hits.sample_directions(lens, chunk, w, self.offsets)
            slot = np.full((h, w), -1, np.int32)
            slot.flat[chunk] = np.arange(len(chunk))
            x, y = (np.ascontiguousarray(inside[..., k], float) for k in range(2))
            met = nearest_faces_at(points, m.faces, m.hidden, box, slot, x, y, EPS_DEPTH_M)
            found = Hits(*(a.ravel() for a in met))
            if centres is None:
                surface.write_edges(
                    chunk,
                    inside,
                    self.order,
                    found,
                    first_hits,
                    seen_from,
                    self.glows,
                    m.surfaces,
                    fragments(count),
                    layers,
                )
                continue
            finer = seen_from._replace(pixel=np.float32(self.pixel / np.sqrt(count)))
            rays, ok = hits.world_directions(inside, finer.rotation)
            samples, _ = self._trace(eye, rays, ok, found, finer)
            hits.resolve_edges(
                chunk,
                self.order,
                samples,
                centres.depth[chunk],
                centres.ident[chunk],
                finer,
                layers,
            )

    def _trace(
        self,
        eye: np.ndarray,
        directions: np.ndarray,
        valid: np.ndarray,
        first_hits: Hits,
        seen_from: View,
    ) -> tuple[Samples, np.ndarray]:
        """Samples along rays from `eye`, and which met a cut-out.

        first_hits : of the rays;  seen_from : whose pixel is a sample's"""
        m, n = self.mesh, len(directions)
        samples = no_samples(n)
        start, masked = np.zeros(n, np.float32), np.zeros(n, bool)
        active = np.arange(n) if valid.all() else np.flatnonzero(valid)
        origin = eye.astype(np.float32)
        for layer in range(MAX_LAYERS):
            if not len(active):
                break
            if layer == 0:
                face, u, v, distance = (
                    first_hits if len(active) == n else Hits(*(a[active] for a in first_hits))
                )
            else:
                rays = directions[active]
                start[active] *= 1 + _ONWARD
                hit = self.scene.first_hits(origin + start[active, None] * rays, rays)
                face, u, v, distance = (hit[key] for key in ("primID", "u", "v", "tfar"))
            continuing = np.empty(len(active), active.dtype)
            z = start[active] + distance
            values = np.empty((len(active), COLUMNS), np.float32)
            rays = directions if len(active) == n else directions[active]
            surface.surfaces(Hits(face, u, v, z), rays, seen_from, m.surfaces, values)
            count = hits.accumulate(
                active, face, z, values, directions, start, m.surfaces, samples, masked, continuing
            )
            active = continuing[:count]
        return samples, masked
