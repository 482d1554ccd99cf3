"""What the object takes from the plane that it stands on, as textures of the plane: of the
soft light, made once a clip, and of each lamp, kept while the lamp stands still.

A texture counts silhouettes of the object: its shadows under directions that fill the
light's disc, or the hemisphere as densely as the cosine. So all of them agree where the
object touches the plane, however coarse the mesh is, and a second texture there, the
contact's, has texels of about a pixel. Values are the share of that light that is taken,
0..1.
Cost: O(silhouettes x (edges + texels)). Source: docs/methods/light.md#shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from arfx.core.facts import PlaneShadow
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.sampling import disc, hemisphere
from arfx.errors import RenderError
from arfx.stages.light.beams import Beam, disc_directions
from arfx.stages.light.caster import Caster
from arfx.stages.light.plane_lookup import PlaneTexture
from arfx.stages.light.silhouette import covered_fraction, smoothed

_MARGIN = 3  # texels without shadow around it
_BUNDLES = 16  # of directions of the hemisphere, each of which counts as its middle
_LOW = 0.05  # of the extent: what lies lower may touch the plane
# of the extent, around the contact; the outer half of it goes over to the wide texture
_BESIDE = 0.08

# blur of the soft picture beside the contact: each silhouette's own edge would show
_EVENED_TEXELS = 2.0


@dataclass(frozen=True)
class PlaneLevel:
    """texels : of a texture, about;  silhouettes : directions over a lamp's disc;  sky :
    over the hemisphere
    """

    texels: int
    silhouettes: int
    sky: int


PLANE_LEVELS = {
    "standard": PlaneLevel(400 * 400, 16, 512),
    "reference": PlaneLevel(1024 * 1024, 511, 2048),
}


@dataclass(frozen=True, eq=False)
class Contact:
    """Where the object touches the plane, with what is beside it.

    low, high (2,) : metres, of its box;  rim_m
    """

    low: np.ndarray
    high: np.ndarray
    rim_m: float

    def share(self, texture: PlaneTexture) -> np.ndarray:
        """(rows, columns) 1 inside, 0 outside, of a texture's texels."""
        inside = _inside_m(texel_places(texture), (*self.low, *self.high))
        return np.asarray(np.clip(inside / self.rim_m, 0, 1), np.float32)

    @property
    def corners(self) -> np.ndarray:
        """(4, 2) metres"""
        (x0, y0), (x1, y1) = self.low, self.high
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def contact_of(caster: Caster) -> Contact | None:
    """None where the object does not come near the plane."""
    heights = caster.above_vertices[:, 2]
    lowest = caster.above_vertices[heights < _LOW * caster.extent_m, :2].astype(float)
    if not len(lowest):
        return None
    beside = _BESIDE * caster.extent_m
    return Contact(lowest.min(0) - beside, lowest.max(0) + beside, beside / 2)


@dataclass(frozen=True, eq=False)
class SoftPicture:
    """What is hidden of soft light whose radiance in direction d is 1 + shape . d, in parts
    of 1 and of d.

    hidden (4, rows, columns) float32, means over the hemisphere weighted by the cosine
    texel_from_m : as `PlaneTexture`"""

    hidden: np.ndarray
    texel_from_m: np.ndarray

    def under(self, shape: tuple[float, float, float]) -> PlaneTexture:
        """shape : anchor axes, no longer than 1"""
        hidden = np.tensordot(np.array([1.0, *shape], np.float32), self.hidden, 1)
        return PlaneTexture(
            _zero_border(hidden / (1 + 2 / 3 * shape[2])), self.texel_from_m
        )

    def even_at(self, places_m: np.ndarray) -> np.ndarray:
        """(n, m) hidden share of even light at places (n, m, 2)"""
        (sx, _, x0), (_, sy, y0) = self.texel_from_m
        x = (places_m[..., 0] * sx + x0).clip(-9, 9e3).astype(np.float32)
        y = (places_m[..., 1] * sy + y0).clip(-9, 9e3).astype(np.float32)
        return cv2.remap(
            self.hidden[0], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
        )

    def times(self, share: np.ndarray) -> SoftPicture:
        return SoftPicture(self.hidden * share, self.texel_from_m)

    def blurred(self, texels: float) -> SoftPicture:
        border = cv2.BORDER_REPLICATE
        parts = [
            cv2.GaussianBlur(a, (0, 0), texels, borderType=border) for a in self.hidden
        ]
        return SoftPicture(np.stack(parts), self.texel_from_m)

    @property
    def even(self) -> PlaneTexture:
        return PlaneTexture(self.hidden[0], self.texel_from_m)


def soft_picture(
    caster: Caster, low: np.ndarray, high: np.ndarray, texels: int, sky: int
) -> SoftPicture:
    """Of a box of the plane. low, high (2,) : metres;  sky : directions"""
    pitch = max(
        float(np.sqrt(np.prod(high - low) / texels)), 1e-6 * caster.extent_m, 1e-9
    )
    columns = int(np.ceil((high[0] - low[0]) / pitch)) + 1
    rows = int(np.ceil((high[1] - low[1]) / pitch)) + 1
    points = caster.above_vertices.astype(float)
    points[:, :2] -= (low + high) / 2
    points = points / pitch + [(columns - 1) / 2, (rows - 1) / 2, 0]
    matrix = np.column_stack(
        [
            np.eye(2) / pitch,
            [(columns - 1) / 2, (rows - 1) / 2] - (low + high) / 2 / pitch,
        ]
    )
    towards = hemisphere(sky)
    bundle = (towards @ hemisphere(_BUNDLES).T).argmax(1)

    def counted(k: int) -> tuple[np.ndarray, np.ndarray]:
        directions = towards[bundle == k]
        slopes = -directions[:, :2] / directions[:, 2:]
        shape = rows, columns
        edges = caster.edges, caster.across, directions, slopes, shape
        return covered_fraction(points.astype(np.float32), *edges), directions.sum(0)

    hidden = np.zeros((4, rows, columns), np.float32)
    for k, (fraction, summed) in enumerate(parallel_map(counted, range(_BUNDLES))):
        for part, weight in zip(hidden, ((bundle == k).sum(), *summed), strict=True):
            part += np.float32(weight / sky) * fraction
    return SoftPicture(hidden, matrix)


def soft_pictures(
    caster: Caster, low: np.ndarray, high: np.ndarray, level: PlaneLevel
) -> tuple[SoftPicture, ...]:
    """Of all that shows, and of the contact, which add up to one."""
    wide = soft_picture(caster, low, high, level.texels, level.sky)
    contact = contact_of(caster)
    if contact is None:
        return (wide.blurred(_EVENED_TEXELS),)
    near = soft_picture(caster, contact.low, contact.high, level.texels, level.sky)
    share = contact.share(near.even)
    far = 1 - contact.share(wide.even)
    return wide.blurred(_EVENED_TEXELS).times(far), near.times(share)


def beam_textures(
    caster: Caster, beam: Beam, level: PlaneLevel, hard: bool
) -> tuple[PlaneTexture, ...]:
    """The share of a lamp's disc that is hidden, of all its shadow and of the contact,
    which add up to one.

    hard : by its middle alone"""
    wide = beam_texture(caster, beam, level, hard)
    contact = contact_of(caster)
    if contact is None:
        return (wide,)
    near = beam_texture(caster, beam, level, hard, contact.corners)
    return (
        PlaneTexture(wide.dark * (1 - contact.share(wide)), wide.texel_from_m),
        PlaneTexture(near.dark * contact.share(near), near.texel_from_m),
    )


def beam_texture(
    caster: Caster,
    beam: Beam,
    level: PlaneLevel,
    hard: bool,
    within: np.ndarray | None = None,
) -> PlaneTexture:
    """The share of a lamp's disc that is hidden. within (n, 2) : points around the part to
    be made, None = all

    It lies along its light, so that a long shadow wastes no texels and its penumbra is a
    box in rows and columns."""
    middle = disc_directions(beam, np.zeros((1, 2)))[0]
    away = normalise(-middle[:2])
    if not away.any():
        away = np.array([1.0, 0.0])
    axes = np.stack([away, [-away[1], away[0]]])  # column axis falls away from the light
    soft = level.silhouettes > 1 and not hard
    angles = np.arange(8) * np.pi / 4
    rim = disc_directions(beam, np.column_stack([np.cos(angles), np.sin(angles)]))
    outer = np.concatenate([middle[None], rim]) if soft else middle[None]
    slopes = -(outer[:, :2] @ axes.T) / outer[:, 2:]
    if within is None:
        footprint = caster.outline[:, :2] @ axes.T
        spread = footprint[None] + slopes[:, None] * caster.outline[None, :, 2:]
        spread = spread.reshape(-1, 2)
    else:
        spread = within @ axes.T
    low, high = spread.min(0), spread.max(0)
    texel_area = float(np.prod(high - low)) / level.texels
    pitch = max(float(np.sqrt(texel_area)), 1e-6 * caster.extent_m, 1e-9)
    columns = int(np.ceil((high[0] - low[0]) / pitch)) + 2 * _MARGIN
    rows = int(np.ceil((high[1] - low[1]) / pitch)) + 2 * _MARGIN
    low = (low + high) / 2 - pitch * (
        np.array([columns, rows]) - 1
    ) / 2  # place of texel (0, 0)
    matrix = np.column_stack([axes / pitch, -low / pitch])
    flat = caster.above_vertices[:, :2] @ (axes / pitch).T - low / pitch
    points = np.column_stack([flat, caster.above_vertices[:, 2] / pitch]).astype(
        np.float32
    )
    # without a size: 8 shifted sample points, antialiased
    many = (
        disc_directions(beam, disc(level.silhouettes))
        if soft
        else np.repeat(middle[None], 8, 0)
    )
    displaced = -(many[:, :2] @ axes.T) / many[:, 2:]
    shape = rows, columns
    dark = covered_fraction(points, caster.edges, caster.across, many, displaced, shape)
    if soft:
        radii = np.abs(slopes[1:] - slopes[0]).max(0)
        widths = float(radii[0]), float(radii[1])
        dark = smoothed(dark, points, caster.above, slopes[0], widths, level.silhouettes)
    return PlaneTexture(_zero_border(dark), matrix)


def within_surface(
    texture: PlaneTexture, surface_m: tuple[float, float, float, float] | None
) -> PlaneTexture:
    """The same, with nothing beyond the surface (x0, y0, x1, y1), which ends within a texel.

    None = unlimited"""
    if surface_m is None:
        return texture
    pitch = float(np.sqrt(abs(1 / np.linalg.det(texture.texel_from_m[:, :2]))))
    inside = _inside_m(texel_places(texture), surface_m)
    share = np.clip(inside / pitch + 0.5, 0, 1)
    return PlaneTexture((texture.dark * share).astype(np.float32), texture.texel_from_m)


def plane_shadow_texture(
    shadow: PlaneShadow, ambient_fraction: np.ndarray
) -> PlaneTexture:
    """Fraction of the lamps' light that a real shadow takes already: (1 - ratio) / (1 -
    ambient fraction), 0..1.

    ambient_fraction (3,). With it the object's shadow is what it takes of the light that is
    there, so that the result is never darker than the soft light alone with the object in
    it, however dark the plate is."""
    (x0, y0, x1, y1), ratio = shadow.box_m, np.array(shadow.ratio)
    usable = ratio.ndim == 2 and ratio.size > 0 and bool(np.isfinite(ratio).all())
    if not usable or not (x1 > x0 and y1 > y0):
        raise RenderError(
            "facts: the real shadow on the plane needs a box with an extent and a grid of"
            " finite numbers"
        )
    darkening = np.clip(divide(1 - ratio, 1 - float(ambient_fraction.mean())), 0, 1)
    rows, columns = darkening.shape
    sx, sy = columns / (x1 - x0), rows / (y1 - y0)
    return PlaneTexture(
        np.pad(darkening, 1).astype(np.float32),
        np.array([[sx, 0, 0.5 - x0 * sx], [0, sy, 0.5 - y0 * sy]]),
    )


def texel_places(texture: PlaneTexture) -> np.ndarray:
    """(rows, columns, 2) x and y, metres, of the texels' centres."""
    rows, columns = texture.dark.shape
    v, u = np.mgrid[:rows, :columns]
    inverse = np.linalg.inv(texture.texel_from_m[:, :2])
    return np.asarray((np.stack([u, v], -1) - texture.texel_from_m[:, 2]) @ inverse.T)


def _inside_m(places: np.ndarray, box: Sequence[float]) -> np.ndarray:
    """How far places (..., 2) lie inside a box x0, y0, x1, y1; below 0 outside."""
    x, y = places[..., 0], places[..., 1]
    across, along = np.minimum(x - box[0], box[2] - x), np.minimum(y - box[1], box[3] - y)
    return np.asarray(np.minimum(across, along))


def _zero_border(dark: np.ndarray) -> np.ndarray:
    """float32, contiguous, 0 along the border: what is looked up outside meets nothing."""
    return np.pad(np.clip(dark, 0, 1)[1:-1, 1:-1], 1).astype(np.float32)
