"""An independent renderer: rays in every pixel until little noise is left, plain numpy, no
filter but the average.

A pixel's rays are doubled until what their spread leaves of noise is under a tolerance, or
there are `most`. Noise in the mean: spread x rays^-3/4, as their points are of low
discrepancy. Left on a sample scene: .004 of coverage and .002 of colour (rms over the
object), half of what 64 rays everywhere leave. Shares no kernel with the stage: its own
sample pattern (R2 sequence, Roberts 2018), first hits (embree), interpolation, texture
lookup (bilinear in the full picture) and means. What it shares is the lens table and the
mesh."""

from __future__ import annotations

import numpy as np

from arfx.core.camera import Camera
from arfx.core.colour import SRGB
from arfx.core.layers import Layer, neutral
from arfx.core.model import CLAMP, MASK, MIRROR, OPAQUE, Material, Texture
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.scene_mesh import SceneMesh
from arfx.stages.raster.record import OUTPUTS
from arfx.stages.triangles import Triangles

MAX_LAYERS = 8
LEAST, MOST = 16, 512
TOLERANCE = 0.004  # of coverage, and of each attribute times coverage
_STRIP_PX = 1024
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]])


def r2_sequence(count: int) -> np.ndarray:
    """(count, 2) offsets in px, -0.5..0.5, the first one the centre: a pixel's depth is
    that sample's, its position lies on the ray through the centre, and both have to agree
    for rays to start on the surface."""
    g = 1.32471795724474602596  # the real root of x^3 = x + 1
    return (0.5 + np.arange(count)[:, None] * [1 / g, 1 / g**2]) % 1.0 - 0.5


class ReferenceRenderer:
    def __init__(
        self,
        mesh: SceneMesh,
        camera: Camera,
        most: int = MOST,
        tolerance: float = TOLERANCE,
    ) -> None:
        self.mesh, self.camera = mesh, camera
        self.scene = Triangles(mesh.corners_m, robust=True)
        self.offsets, self.tolerance = r2_sequence(most), tolerance

    def render(self, rect: Rect, camera_from_world: Pose) -> dict[Layer, np.ndarray]:
        """All layers over `rect`, which lies in the frame."""
        out = {name: neutral(name, rect) for name in OUTPUTS}
        rows = max(_STRIP_PX // max(rect.width, 1), 1)
        strips = [
            Rect(rect.x0, y, rect.x1, min(y + rows, rect.y1))
            for y in range(rect.y0, rect.y1, rows)
        ]
        for strip, made in zip(
            strips,
            parallel_map(lambda s: self._strip(s, camera_from_world), strips),
            strict=True,
        ):
            for name, array in made.items():
                out[name][strip.slices_in(rect)] = array
        return out

    def _strip(self, rect: Rect, pose: Pose) -> dict[Layer, np.ndarray]:
        y, x = (
            a.ravel()
            for a in np.mgrid[rect.y0 : rect.y1, rect.x0 : rect.x1].astype(float)
        )
        n, eye = len(y), pose.inverse().translation_m
        sums, hits = np.zeros((n, 13)), np.zeros(n)  # over the samples taken so far
        depth, ident, nearest = (
            np.full(n, np.inf),
            np.zeros(n, np.int32),
            np.full(n, np.inf),
        )
        squares, taken = np.zeros((n, 13)), np.zeros(n)
        active, start, end = np.arange(n), 0, LEAST
        while len(active) and start < len(self.offsets):
            offsets = self.offsets[start:end]
            own, z, number = self._samples(x[active], y[active], offsets, pose)
            sums[active] += np.einsum("nkc->nc", own)
            squares[active] += np.einsum("nkc,nkc->nc", own, own)
            hits[active] += (number > 0).sum(1)
            away = np.where(number > 0, (offsets**2).sum(1), np.inf)
            first, row = (
                away.argmin(1),
                np.arange(len(active)),
            )  # the covering sample next to the centre
            closer = away[row, first] < nearest[active]
            at, first, row = active[closer], first[closer], row[closer]
            nearest[at], depth[at], ident[at] = (
                away[row, first],
                z[row, first],
                number[row, first],
            )
            taken[active] = end
            low, high = sums[active] / end, squares[active] / end
            if start == 0:  # what passes through a corner alone is seen there
                corners = self._samples(x, y, _CORNERS, pose)[0]
                low, high = (
                    (4 * low + corners.mean(1)) / 5,
                    (4 * high + (corners * corners).mean(1)) / 5,
                )
            active = active[(high - low * low).max(1) > self.tolerance**2 * end**1.5]
            start, end = end, 2 * end
        weight = sums[:, 0]
        shown = divide(sums[:, 1:], weight[:, None])
        centre, inside = self._rays(x, y, pose)
        covered = ((hits > 0) & inside)[:, None]
        centre = np.where(covered, centre, 0.0)
        position = np.where(
            covered,
            eye + np.where(np.isfinite(depth), depth, 0)[:, None] * centre,
            0.0,
        )
        normal = normalise(shown[:, 3:6])
        normal = np.where(
            covered & (np.abs(normal).sum(1, keepdims=True) == 0),
            -normalise(centre),
            normal,
        )
        alpha = divide(weight, hits)
        values = {
            Layer.COVERAGE: np.minimum(weight / taken, 1.0),
            Layer.DEPTH: depth,
            Layer.NORMAL: normal,
            Layer.POSITION: position,
            Layer.ALBEDO: shown[:, :3],
            Layer.MATERIAL: np.concatenate([shown[:, 6:9], alpha[:, None]], 1),
            Layer.EMISSIVE: shown[:, 9:12],
        }
        arrays: dict[Layer, np.ndarray] = {
            k: v.reshape(rect.height, rect.width, *v.shape[1:]).astype(np.float32)
            for k, v in values.items()
        }
        arrays[Layer.OBJECT_ID] = ident.reshape(rect.height, rect.width)
        return arrays

    def _samples(
        self, x: np.ndarray, y: np.ndarray, offsets: np.ndarray, pose: Pose
    ) -> tuple[np.ndarray, ...]:
        """What `_trace` gives, (n, k, ...), for pixels x, y (n,) at `offsets` (k, 2)."""
        across, down = (
            (x[:, None] + offsets[:, 0]).ravel(),
            (y[:, None] + offsets[:, 1]).ravel(),
        )
        sums, z, number = self._trace(
            pose.inverse().translation_m - self.mesh.centre_m,
            *self._rays(across, down, pose),
        )
        return (
            sums.reshape(len(x), len(offsets), -1),
            z.reshape(len(x), -1),
            number.reshape(len(x), -1),
        )

    def _rays(
        self, x: np.ndarray, y: np.ndarray, pose: Pose
    ) -> tuple[np.ndarray, np.ndarray]:
        """Directions (n, 3), camera z = 1, in world axes through places (n,) px, and which
        are any.
        """
        d = self.camera.normalised(np.stack([x, y], -1))
        ok = np.isfinite(d).all(1)
        return (
            np.concatenate([np.where(ok[:, None], d, 0.0), np.ones((len(d), 1))], 1)
            @ pose.rotation,
            ok,
        )

    def _trace(
        self, eye: np.ndarray, d: np.ndarray, ok: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums (n, 13): weight, then weighted albedo, normal, material, emissive; depth; 1
        + part.
        """
        m, n = self.mesh, len(d)
        sums, depth, ident = (
            np.zeros((n, 13)),
            np.full(n, np.inf),
            np.zeros(n, np.int32),
        )
        transmittance, start = np.ones(n), np.zeros(n)
        active = np.flatnonzero(ok)
        for _ in range(MAX_LAYERS):
            if not len(active):
                break
            origins = eye + start[active, None] * d[active]
            hit = self.scene.first_hits(
                origins.astype(np.float32),
                np.ascontiguousarray(d[active], np.float32),
            )
            found = hit["primID"] >= 0
            active, f = active[found], hit["primID"][found]
            u, v = hit["u"][found].astype(float), hit["v"][found].astype(float)
            z = start[active] + hit["tfar"][found]
            part = m.part[f]
            back_side = np.einsum("ij,ij->i", m.face_normal[f], d[active]) > 0
            values, alpha = self._surface(
                f, np.stack([1 - u - v, u, v], 1), d[active], back_side
            )
            alpha[back_side & m.hidden_behind[f]] = 0.0
            weight = transmittance[active] * alpha
            sums[active, 0] += weight
            sums[active, 1:] += weight[:, None] * values
            transmittance[active] -= weight
            shown = alpha > 1 / 512
            new = active[shown & (ident[active] == 0)]
            depth[new], ident[new] = (
                z[shown & (ident[active] == 0)],
                part[shown & (ident[active] == 0)] + 1,
            )
            start[active] = z * (1 + 5e-7)
            active = active[transmittance[active] > 1 / 512]
        return sums, depth, ident

    def _surface(
        self, f: np.ndarray, bary: np.ndarray, d: np.ndarray, back_side: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Albedo, normal, metallic roughness specular, emissive (n, 12), and opacity (n,)."""
        m = self.mesh
        corner = m.faces[f]

        def mix(a: np.ndarray) -> np.ndarray:
            p, q, r = corner.T
            return np.asarray(
                a[p] * bary[:, :1] + a[q] * bary[:, 1:2] + a[r] * bary[:, 2:]
            )

        normal = normalise(mix(m.normals)) * np.where(back_side, -1.0, 1.0)[:, None]
        unit = normalise(d)
        normal = normalise(
            normal
            - np.maximum(np.einsum("ij,ij->i", normal, unit), 0.0)[:, None] * unit
        )
        values, alpha = np.zeros((len(f), 12)), np.zeros(len(f))
        values[:, 3:6] = normal
        for number, material in enumerate(m.materials):
            use = m.part[f] == number
            colour, surface, emissive = _material(material, mix(m.uv)[use])
            colour *= mix(m.colours)[use]
            values[use, :3], values[use, 6:9], values[use, 9:12] = (
                colour[:, :3],
                surface,
                emissive,
            )
            opacity = (
                np.ones(len(colour))
                if material.alpha_mode == OPAQUE
                else colour[:, 3]
            )
            alpha[use] = (
                opacity >= material.alpha_cutoff
                if material.alpha_mode == MASK
                else opacity
            )
        return values, alpha


def _material(
    material: Material, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour (n, 4), metallic roughness specular and emission (n, 3) at uv (n, 4), both sets."""
    n = len(uv)
    colour = np.tile(np.array(material.base_colour, float), (n, 1))
    surface = np.tile(
        [float(material.metallic), material.roughness, material.specular], (n, 1)
    )
    emissive = np.tile(np.array(material.emissive, float), (n, 1))
    if material.base_texture is not None:
        seen = bilinear(material.base_texture, True, uv)
        colour[:, : seen.shape[1]] *= seen
    if material.metallic_roughness_texture is not None:
        surface[:, :2] *= bilinear(material.metallic_roughness_texture, False, uv)[
            :, [2, 1]
        ]
    if material.emissive_texture is not None:
        emissive *= bilinear(material.emissive_texture, True, uv)[:, :3]
    return colour, surface, emissive


def bilinear(texture: Texture, srgb: bool, uv: np.ndarray) -> np.ndarray:
    """(n, c) linear, of a texture's picture (h, w, c) at uv (n, 4)."""
    picture, matrix = texture.picture, texture.picture_from_uv
    h, w = picture.shape[:2]
    place = uv[:, 2 * texture.uv_set :][:, :2] @ matrix[:, :2].T + matrix[:, 2]
    p = place * [w, h] - 0.5
    low = np.floor(p).astype(int)
    part = p - low
    out = np.zeros((len(uv), picture.shape[2]))
    for dy in (0, 1):
        for dx in (0, 1):
            row, column = (
                _texel(low[:, 1] + dy, h, texture.wrap[1]),
                _texel(low[:, 0] + dx, w, texture.wrap[0]),
            )
            linear = picture[row, column] / 255.0
            if srgb:
                linear[:, :3] = SRGB.decode(linear[:, :3])
            fraction = (part[:, 0] if dx else 1 - part[:, 0]) * (
                part[:, 1] if dy else 1 - part[:, 1]
            )
            out += fraction[:, None] * linear
    return out


def _texel(i: np.ndarray, n: int, wrap: str) -> np.ndarray:
    """Texels of a picture of n in a row that lie at places i of a picture without end."""
    if wrap == CLAMP:
        return np.clip(i, 0, n - 1)
    folded = i % (2 * n)
    return np.minimum(folded, 2 * n - 1 - folded) if wrap == MIRROR else i % n
