"""What the object takes from the plane that it stands on, as small pictures of the plane: one of the ambient light, made
once per clip, and one of each directional light, kept while the light stands still.

Each picture lies along its own light, so that a long shadow wastes no texels and its penumbra is a box in rows and
columns. Values are the share of that light that is taken, 0..1; the border is 0, and so is everything outside."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.facts import PlaneShadow
from arfx.core.numerics import divide, normalise
from arfx.errors import RenderError
from arfx.stages.lightmap.beams import Beam, disc_directions
from arfx.stages.lightmap.caster import Caster
from arfx.stages.lightmap.silhouette import covered_fraction, smoothed
from arfx.stages.triangles import Triangles, disc, hemisphere

_LIFT = 1e-4  # of the extent, off the plane: a base that lies in it would hide every ray or none, by rounding
_SETS = 4
_MARGIN = 3  # texels without shadow around it


@dataclass(frozen=True)
class PlaneLevel:
    """texels : of a light's picture, about;  silhouettes : directions over the light's disc, 1 = its middle, antialiased
    ambient_texels : a side;  ambient_rays : of each"""

    texels: int
    silhouettes: int
    ambient_texels: int
    ambient_rays: int


PLANE_LEVELS = {
    "draft": PlaneLevel(256 * 256, 1, 96, 16),
    "standard": PlaneLevel(400 * 400, 16, 192, 64),
    "high": PlaneLevel(640 * 640, 64, 256, 320),
    "reference": PlaneLevel(1024 * 1024, 511, 384, 512),
}


@dataclass(frozen=True, eq=False)
class PlaneTexture:
    """dark (rows, columns) float32;  texel_from_m (2, 3) : plane coordinates (x, y, 1), metres, to column and row"""

    dark: np.ndarray
    texel_from_m: np.ndarray


@dataclass(frozen=True, eq=False)
class SoftPicture:
    """What is hidden of soft light whose radiance in direction d is 1 + shape . d, in parts of 1 and of d.

    hidden (4, rows, columns) float32, means over the hemisphere weighted by the cosine;  texel_from_m : as `PlaneTexture`"""

    hidden: np.ndarray
    texel_from_m: np.ndarray

    def under(self, shape: tuple[float, float, float]) -> PlaneTexture:
        """shape : anchor axes, no longer than 1"""
        dark = np.tensordot(np.array([1.0, *shape], np.float32), self.hidden, 1) / (
            1 + 2 / 3 * shape[2]
        )
        return PlaneTexture(_zero_border(dark), self.texel_from_m)

    def even_at(self, places_m: np.ndarray) -> np.ndarray:
        """(n, m) hidden share of even light at places (n, m, 2)"""
        (sx, _, x0), (_, sy, y0) = self.texel_from_m
        x, y = (
            (places_m[..., i] * s + o).clip(-9, 9e3).astype(np.float32)
            for i, s, o in ((0, sx, x0), (1, sy, y0))
        )
        return cv2.remap(self.hidden[0], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def soft_picture(
    caster: Caster,
    rays: Triangles,
    centre: np.ndarray,
    half: np.ndarray,
    texels: int,
    directions: int,
) -> SoftPicture:
    """Of a box of the plane. centre, half (2,) : metres

    Each of _SETS x _SETS neighbours turns the rays differently: what few rays leave, bands otherwise, is noise."""
    t = (np.arange(texels) + 0.5) / texels * 2 - 1
    x, y = np.meshgrid(centre[0] + half[0] * t, centre[1] + half[1] * t)
    points = np.stack([x, y, np.full(x.shape, _LIFT * caster.extent_m)], -1)
    spiral, hidden, count = (
        hemisphere(directions),
        np.empty((4, texels, texels), np.float32),
        _SETS**2,
    )
    for k in range(count):
        v, u = (k * 5 % count) // _SETS, k % _SETS  # neighbours are far from each other in k
        c, s = np.cos(2 * np.pi * k / count), np.sin(2 * np.pi * k / count)
        towards = spiral @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        weights = np.column_stack([np.ones(directions), towards]) / directions
        part = points[v::_SETS, u::_SETS]
        taken = rays.hidden_sum(part.reshape(-1, 3), towards, weights)
        hidden[:, v::_SETS, u::_SETS] = taken.T.reshape(4, *part.shape[:2])
    scale, low = texels / (2 * half), centre - half
    return SoftPicture(
        hidden,
        np.array(
            [[scale[0], 0, -low[0] * scale[0] - 0.5], [0, scale[1], -low[1] * scale[1] - 0.5]]
        ),
    )


def ambient_picture(
    caster: Caster, rays: Triangles, centre: np.ndarray, half: np.ndarray, level: PlaneLevel
) -> SoftPicture:
    """Smoothed `soft_picture` of the same box."""
    made = soft_picture(caster, rays, centre, half, level.ambient_texels, level.ambient_rays)
    smooth = [
        cv2.GaussianBlur(a, (0, 0), 0.8, borderType=cv2.BORDER_REPLICATE) for a in made.hidden
    ]
    return SoftPicture(np.stack(smooth), made.texel_from_m)


def plane_shadow_texture(shadow: PlaneShadow, ambient_fraction: np.ndarray) -> PlaneTexture:
    """Fraction of the directional light that a real shadow already takes: (1 - ratio) / (1 - ambient fraction), 0..1.

    ambient_fraction (3,). With it the object's shadow is what it takes of the light that is there:
    ratio = (ambient x V + direct x left x V_l) / (ambient + direct x left), so that the result is never darker than the
    ambient light alone with the object in it, however dark the plate is."""
    (x0, y0, x1, y1), ratio = shadow.box_m, np.array(shadow.ratio)
    if (
        ratio.ndim != 2
        or not ratio.size
        or not np.isfinite(ratio).all()
        or not (x1 > x0 and y1 > y0)
    ):
        raise RenderError(
            "facts: the real shadow on the plane needs a box with an extent and a grid of finite numbers"
        )
    darkening = np.clip(divide(1 - ratio, 1 - float(ambient_fraction.mean())), 0, 1)
    rows, columns = darkening.shape
    sx, sy = columns / (x1 - x0), rows / (y1 - y0)
    return PlaneTexture(
        np.pad(darkening, 1).astype(np.float32),
        np.array([[sx, 0, 0.5 - x0 * sx], [0, sy, 0.5 - y0 * sy]]),
    )


def beam_texture(caster: Caster, beam: Beam, level: PlaneLevel, hard: bool) -> PlaneTexture:
    """The share of a directional light's disc that is hidden. hard : by its middle alone."""
    middle = disc_directions(beam, np.zeros((1, 2)))[0]
    away = normalise(-middle[:2])
    if not away.any():
        away = np.array([1.0, 0.0])
    axes = np.stack([away, [-away[1], away[0]]])  # column axis falls away from the light
    soft = level.silhouettes > 1 and not hard
    rim = disc_directions(
        beam, np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])
    )
    outer = np.concatenate([middle[None], rim]) if soft else middle[None]
    slopes = -(outer[:, :2] @ axes.T) / outer[:, 2:]
    footprint = caster.outline[:, :2] @ axes.T
    spread = (footprint[None] + slopes[:, None] * caster.outline[None, :, 2:]).reshape(-1, 2)
    low, high = spread.min(0), spread.max(0)
    pitch = max(float(np.sqrt(np.prod(high - low) / level.texels)), 1e-6 * caster.extent_m, 1e-9)
    columns = -(-int(np.ceil((high[0] - low[0]) / pitch) + 2 * _MARGIN) // 64) * 64
    rows = int(np.ceil((high[1] - low[1]) / pitch)) + 2 * _MARGIN
    low = (low + high) / 2 - pitch * (np.array([columns, rows]) - 1) / 2  # place of texel (0, 0)
    matrix = np.column_stack([axes / pitch, -low / pitch])
    points = np.column_stack(
        [
            caster.above_vertices[:, :2] @ (axes / pitch).T - low / pitch,
            caster.above_vertices[:, 2] / pitch,
        ]
    ).astype(np.float32)
    # without a size: 8 shifted sample points, antialiased
    towards = (
        disc_directions(beam, disc(level.silhouettes)) if soft else np.repeat(middle[None], 8, 0)
    )
    displaced = -(towards[:, :2] @ axes.T) / towards[:, 2:]
    dark = covered_fraction(
        points, caster.edges, caster.across, towards, displaced, (rows, columns)
    )
    if soft:
        radii = np.abs(slopes[1:] - slopes[0]).max(0)
        dark = smoothed(
            dark,
            points,
            caster.above,
            slopes[0],
            (float(radii[0]), float(radii[1])),
            level.silhouettes,
        )
    return PlaneTexture(_zero_border(dark), matrix)


def within_surface(
    texture: PlaneTexture, surface_m: tuple[float, float, float, float] | None
) -> PlaneTexture:
    """The same, with nothing beyond the surface (x0, y0, x1, y1), which ends within a texel; None = unlimited."""
    if surface_m is None:
        return texture
    rows, columns = texture.dark.shape
    v, u = np.mgrid[:rows, :columns]
    inverse = np.linalg.inv(texture.texel_from_m[:, :2])
    at = np.stack([u, v], -1) - texture.texel_from_m[:, 2]
    position = at @ inverse.T
    x0, y0, x1, y1 = surface_m
    x, y = position[..., 0], position[..., 1]
    inside = np.minimum(np.minimum(x - x0, x1 - x), np.minimum(y - y0, y1 - y))
    pitch = float(np.sqrt(abs(np.linalg.det(inverse))))
    return PlaneTexture(
        (texture.dark * np.clip(inside / pitch + 0.5, 0, 1)).astype(np.float32),
        texture.texel_from_m,
    )


def _zero_border(dark: np.ndarray) -> np.ndarray:
    """float32, contiguous, 0 along the border: what is looked up outside meets nothing."""
    return np.pad(np.clip(dark, 0, 1)[1:-1, 1:-1], 1).astype(np.float32)
