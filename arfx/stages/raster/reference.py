"""The reference level: many rays in every pixel, plain numpy, no filter but the average. Slow on purpose.

Shares no kernel with the other levels: its own sample pattern (R2 sequence, Roberts 2018), interpolation, texture lookup
(bilinear in the full picture) and means. What it shares is embree, the lens table and the mesh arrays."""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera
from arfx.core.layers import Layer, neutral
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.stages.raster import mesh as columns
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.mesh import Mesh
from arfx.stages.raster.rays import MAX_LAYERS, OUTPUTS
from arfx.stages.raster.textures import CODE
from arfx.stages.triangles import Triangles

SAMPLES = 64
_STRIP_PX = 4096


def r2_sequence(count: int) -> np.ndarray:
    """(count, 2) offsets in px, -0.5..0.5, the one nearest the centre first and moved there: a pixel's depth is that sample's,
    its position lies on the ray through the centre, and both have to agree for rays to start on the surface."""
    g = 1.32471795724474602596  # the real root of x^3 = x + 1
    p = (0.5 + np.arange(1, count + 1)[:, None] * [1 / g, 1 / g**2]) % 1.0 - 0.5
    p = p[np.argsort((p**2).sum(1), kind="stable")]
    p[0] = 0.0
    return p


class ReferenceRenderer:
    any_rectangle = True

    def __init__(self, mesh: Mesh, camera: Camera, samples: int = SAMPLES) -> None:
        self.mesh, self.camera, self.lens = mesh, camera, LensTable(camera)
        self.scene = Triangles(mesh.corners_m, robust=True)
        self.offsets = r2_sequence(samples)

    def render(self, rect: Rect, camera_from_world: Pose) -> dict[Layer, np.ndarray]:
        """All layers over `rect`, which lies in the frame."""
        out = {name: neutral(name, rect) for name in OUTPUTS}
        rows = max(_STRIP_PX // max(rect.width, 1), 1)
        for top in range(rect.y0, rect.y1, rows):
            strip = Rect(rect.x0, top, rect.x1, min(top + rows, rect.y1))
            for name, array in self._strip(strip, camera_from_world).items():
                out[name][strip.slices_in(rect)] = array
        return out

    def _strip(self, rect: Rect, pose: Pose) -> dict[Layer, np.ndarray]:
        h, w, s = rect.height, rect.width, len(self.offsets)
        y, x = np.arange(rect.y0, rect.y1, dtype=float), np.arange(rect.x0, rect.x1, dtype=float)
        d = np.stack([self.lens.at(y + dy, x + dx) for dx, dy in self.offsets], 2).reshape(-1, 2)
        ok = np.isfinite(d).all(1)
        d = np.concatenate([np.where(ok[:, None], d, 0.0), np.ones((len(d), 1))], 1) @ pose.rotation
        eye = pose.inverse().translation_m
        sums, depth, ident = self._trace(eye - self.mesh.centre_m, d, ok)
        # from here by pixel: (h * w, s, ...)
        sums = sums.reshape(h * w, s, -1)
        depth, ident = depth.reshape(h * w, s), ident.reshape(h * w, s)
        weight = sums[..., 0]
        total = weight.sum(1)
        mean = divide(sums[..., 1:].sum(1), total[:, None])
        hit = ident > 0
        first = hit.argmax(1)  # the covering sample next to the centre
        pixel = np.arange(h * w)
        z = np.where(hit.any(1), depth[pixel, first], np.inf)
        centre = self.lens.at(y, x).reshape(-1, 2)
        centre = np.concatenate([centre, np.ones((h * w, 1))], 1) @ pose.rotation
        covered = (hit.any(1) & np.isfinite(centre).all(1)).reshape(-1, 1)
        centre = np.where(covered, centre, 0.0)
        position = np.where(covered, eye + np.where(np.isfinite(z), z, 0)[:, None] * centre, 0.0)
        normal = normalise(mean[:, 3:6])
        normal = np.where(covered & (np.abs(normal).sum(1, keepdims=True) == 0), -normalise(centre), normal)
        alpha = divide(total, hit.sum(1))
        values = {
            Layer.COVERAGE: np.minimum(total / s, 1.0), Layer.DEPTH: z, Layer.NORMAL: normal, Layer.POSITION: position,
            Layer.ALBEDO: mean[:, :3], Layer.MATERIAL: np.concatenate([mean[:, 6:9], alpha[:, None]], 1),
            Layer.EMISSIVE: mean[:, 9:12],
        }  # fmt: skip
        arrays = {k: v.reshape(h, w, *v.shape[1:]).astype(np.float32) for k, v in values.items()}
        arrays[Layer.OBJECT_ID] = ident[pixel, first].reshape(h, w).astype(np.int32)
        return arrays

    def _trace(self, eye: np.ndarray, d: np.ndarray, ok: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums (n, 13): weight, then weighted albedo, normal, material, emissive; depth; 1 + part."""
        m, n = self.mesh, len(d)
        sums, depth, ident = np.zeros((n, 13)), np.full(n, np.inf), np.zeros(n, np.int32)
        transmittance, start = np.ones(n), np.zeros(n)
        active = np.flatnonzero(ok)
        for _ in range(MAX_LAYERS):
            if not len(active):
                break
            origins = eye + start[active, None] * d[active]
            hit = self.scene.first_hits(origins.astype(np.float32), np.ascontiguousarray(d[active], np.float32))
            found = hit["primID"] >= 0
            active, f = active[found], hit["primID"][found]
            u, v = hit["u"][found].astype(float), hit["v"][found].astype(float)
            z = start[active] + hit["tfar"][found]
            part = m.part[f]
            back_side = (m.face_normal[f] * d[active]).sum(1) > 0
            values, alpha = self._surface(f, np.stack([1 - u - v, u, v], 1), d[active], back_side)
            alpha[back_side & (m.ints[part, columns.TWO_SIDED] == 0)] = 0.0
            weight = transmittance[active] * alpha
            sums[active, 0] += weight
            sums[active, 1:] += weight[:, None] * values
            transmittance[active] -= weight
            shown = alpha > 1 / 512
            new = active[shown & (ident[active] == 0)]
            depth[new], ident[new] = z[shown & (ident[active] == 0)], part[shown & (ident[active] == 0)] + 1
            start[active] = z * (1 + 5e-7)
            active = active[transmittance[active] > 1 / 512]
        return sums, depth, ident

    def _surface(self, f: np.ndarray, bary: np.ndarray, d: np.ndarray, back_side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Albedo, normal, metallic roughness specular, emissive (n, 12), and opacity (n,)."""
        m = self.mesh
        corner = m.faces[f]
        row, kind = m.floats[m.part[f]].astype(float), m.ints[m.part[f]]

        def mix(a: np.ndarray) -> np.ndarray:
            return (a[corner] * bary[..., None]).sum(1)

        colour = row[:, :4] * mix(m.colours)
        surface = row[:, [columns.METALLIC, columns.ROUGHNESS, columns.SPECULAR]]
        emissive = row[:, columns.EMIT_R : columns.CUTOFF]
        uv = mix(m.uv)
        for t in range(len(m.textures.table)):
            use = kind[:, columns.BASE_TEXTURE] == t
            colour[use] *= self._bilinear(t, uv[use], 1)
            use = kind[:, columns.MR_TEXTURE] == t
            surface[use, :2] *= self._bilinear(t, uv[use], 0)[:, :2]
            use = kind[:, columns.EMISSIVE_TEXTURE] == t
            emissive[use] *= self._bilinear(t, uv[use], 1)[:, :3]
        mode = kind[:, columns.MODE]
        alpha = np.where(mode == 0, 1.0, np.where(mode == 1, colour[:, 3] >= row[:, columns.CUTOFF], colour[:, 3]))
        normal = normalise(mix(m.normals)) * np.where(back_side, -1.0, 1.0)[:, None]
        unit = normalise(d)
        normal = normalise(normal - np.maximum((normal * unit).sum(1), 0.0)[:, None] * unit)
        return np.concatenate([colour[:, :3], normal, surface, emissive], 1), alpha

    def _bilinear(self, t: int, uv: np.ndarray, srgb: int) -> np.ndarray:
        stack = self.mesh.textures
        w, h, start = (int(stack.table[t, k]) for k in (0, 1, 3))
        picture = stack.texels[start : start + w * h].reshape(h, w, 4)
        p = uv * [w, h] - 0.5
        low = np.floor(p).astype(int)
        part = p - low
        out = np.zeros((len(uv), 4))
        for dy in (0, 1):
            for dx in (0, 1):
                raw = picture[(low[:, 1] + dy) % h, (low[:, 0] + dx) % w]
                fraction = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
                linear = np.concatenate([CODE[srgb][raw[:, :3]], CODE[0][raw[:, 3:]]], 1)
                out += fraction[:, None] * linear
        return out
