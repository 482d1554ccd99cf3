"""What the object takes from the plane that it stands on, as textures of the plane: of the
soft light, made once a clip, and of each lamp, kept while the lamp stands still.

A texture counts silhouettes of the object: its shadows under directions that fill the
light's disc, or the hemisphere as densely as the cosine. So all of them agree where the
object touches the plane, however coarse the mesh is, and a second texture there, the
contact's, has texels of about a pixel. Values are the share of that light that is taken,
0..1.
Cost: O(silhouettes x (edges + texels)). Source: docs/methods/light.md#shadow."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.facts import PlaneShadow
from arfx.core.numerics import divide, normalise
from arfx.core.parallel import parallel_map
from arfx.core.sampling import disc, hemisphere
from arfx.errors import RenderError
from arfx.stages.light.beams import Beam, disc_directions, rim_directions
from arfx.stages.light.caster import Caster
from arfx.stages.light.plane_lookup import PlaneTexture
from arfx.stages.light.silhouette import covered_fraction

_MARGIN = 3  # texels without shadow around it
_SHIFTED = 8  # silhouettes of a lamp without a size
_LARGE_DEG = 16  # of a lamp: a larger one has more silhouettes
_BUNDLES = 16  # of directions of the hemisphere, each of which counts as its middle
_LOW = 0.05  # of the extent: what lies lower may touch the plane
# of the extent, around the contact; the outer half of it goes over to the wide texture
_BESIDE = 0.08

# most and least blur beside the contact
_EVENED_TEXELS, _SHARPEST_TEXELS = 2.0, 0.3


@dataclass(frozen=True)
class PlaneLevel:
    """texels : of a texture, about;  silhouettes : directions over the disc of a lamp that is
    not large;  sky : over the hemisphere
    """

    texels: int
    silhouettes: int
    sky: int


PLANE_LEVELS = {
    "standard": PlaneLevel(400 * 400, 64, 512),
    "reference": PlaneLevel(1024 * 1024, 511, 2048),
}


def contact_box(caster: Caster) -> tuple[float, ...] | None:
    """x0, y0, x1, y1, metres, of where the object touches the plane, with what is beside it;
    None where it does not come near.
    """
    heights = caster.above_vertices[:, 2]
    lowest = caster.above_vertices[heights < _LOW * caster.extent_m, :2].astype(float)
    if not len(lowest):
        return None
    beside = _BESIDE * caster.extent_m
    return *(lowest.min(0) - beside), *(lowest.max(0) + beside)


def _joined_at_contact(
    caster: Caster, make: Callable[[tuple[float, ...] | None], PlaneTexture]
) -> tuple[PlaneTexture, ...]:
    """Of all that shows, and of the contact, which add up to one.

    make : of a box of the plane, None = all
    """
    box = contact_box(caster)
    if box is None:
        return (make(None),)
    wide, near = make(None), make(box)
    rim = _BESIDE * caster.extent_m / 2
    far, close = (
        np.clip(_inside_m(texel_places(t), box) / rim, 0, 1).astype(np.float32)
        for t in (wide, near)
    )
    return (
        PlaneTexture(wide.dark * (1 - far), wide.texel_from_m),
        PlaneTexture(near.dark * close, near.texel_from_m),
    )


def _grid(
    caster: Caster,
    low: ndarray,
    high: ndarray,
    texels: int,
    more: int,
    axes: ndarray,
) -> tuple[ndarray, tuple[int, int], ndarray]:
    """The caster's vertices (n, 3) float32 in texels, (rows, columns) and texel_from_m of
    about that many texels over a box along `axes` (2, 2), and `more` rows and columns.
    """
    pitch = max(
        float(np.sqrt(np.prod(high - low) / texels)), 1e-6 * caster.extent_m, 1e-9
    )
    columns, rows = np.ceil((high - low) / pitch).astype(int).tolist()
    columns, rows = columns + more, rows + more
    middle, centre = (low + high) / 2, np.array([columns - 1, rows - 1]) / 2
    points = caster.above_vertices.astype(float)
    points[:, :2] = points[:, :2] @ axes.T - middle
    points = points / pitch + [*centre, 0]
    matrix = np.column_stack([axes / pitch, centre - middle / pitch])
    return points.astype(np.float32), (rows, columns), matrix


def soft_picture(
    caster: Caster, low: ndarray, high: ndarray, texels: int, sky: int
) -> PlaneTexture:
    """What is hidden of soft light whose radiance in direction d is 1 + shape . d, in parts
    of 1 and of d: means over the hemisphere weighted by the cosine, (4, rows, columns).

    Of a box of the plane. low, high (2,) : metres;  sky : directions"""
    points, shape, matrix = _grid(caster, low, high, texels, 1, np.eye(2))
    towards = hemisphere(sky)
    bundle = (towards @ hemisphere(_BUNDLES).T).argmax(1)

    def counted(k: int) -> tuple[ndarray, ndarray]:
        directions = towards[bundle == k]
        slopes = -directions[:, :2] / directions[:, 2:]
        edges = caster.edges, caster.across, directions, slopes, shape
        return covered_fraction(points, *edges), directions.sum(0)

    hidden = np.zeros((4, *shape), np.float32)
    for k, (fraction, summed) in enumerate(parallel_map(counted, range(_BUNDLES))):
        for part, weight in zip(hidden, ((bundle == k).sum(), *summed), strict=True):
            part += np.float32(weight / sky) * fraction
    return PlaneTexture(hidden, matrix)


def soft_pictures(
    caster: Caster, low: ndarray, high: ndarray, level: PlaneLevel
) -> tuple[PlaneTexture, ...]:
    """`soft_picture` of all that shows, and of the contact, which add up to one."""

    def make(box: tuple[float, ...] | None) -> PlaneTexture:
        first, last = (low, high) if box is None else np.reshape(box, (2, 2))
        picture = soft_picture(caster, first, last, level.texels, level.sky)
        if box is None:
            for part in picture.dark:
                _even(part, _EVENED_TEXELS)
        return picture

    return _joined_at_contact(caster, make)


def _even(dark: ndarray, step_texels: float) -> None:
    """Blurs what each silhouette's own edge would show, in place, as far as steps are apart."""
    sigma = min(step_texels, _EVENED_TEXELS)
    if sigma > _SHARPEST_TEXELS:
        cv2.GaussianBlur(dark, (0, 0), sigma, dark, borderType=cv2.BORDER_REPLICATE)


def under_light(
    soft: PlaneTexture, shape: tuple[float, float, float]
) -> PlaneTexture:
    """What is hidden of one soft light. soft : `soft_picture`;  shape : anchor axes, no
    longer than 1
    """
    hidden = np.tensordot(np.array([1.0, *shape], np.float32), soft.dark, 1)
    return PlaneTexture(
        _zero_border(hidden / (1 + 2 / 3 * shape[2])), soft.texel_from_m
    )


def beam_textures(
    caster: Caster, beam: Beam, level: PlaneLevel
) -> tuple[PlaneTexture, ...]:
    """`beam_texture` of all the shadow and of the contact, which add up to one."""
    return _joined_at_contact(
        caster, lambda box: beam_texture(caster, beam, level, box)
    )


def beam_texture(
    caster: Caster,
    beam: Beam,
    level: PlaneLevel,
    box: tuple[float, ...] | None = None,
) -> PlaneTexture:
    """The share of a lamp's disc that is hidden. box : x0, y0, x1, y1, metres, of the part
    to be made, None = all

    It lies along its light, so that a long shadow wastes no texels and its penumbra is a
    box in rows and columns."""
    outer = rim_directions(beam, 8)
    away = normalise(-outer[0, :2])
    if not away.any():
        away = np.array([1.0, 0.0])
    axes = np.stack(
        [away, [-away[1], away[0]]]
    )  # column axis falls away from the light
    slopes = -(outer[:, :2] @ axes.T) / outer[:, 2:]
    spread = caster.cast(outer)
    if box is not None:
        spread = np.array([[x, y] for x in box[::2] for y in box[1::2]])
    spread = spread @ axes.T
    low, high = spread.min(0), spread.max(0)
    points, shape, matrix = _grid(caster, low, high, level.texels, 2 * _MARGIN, axes)
    # of a lamp without a size: shifted sample points alone, antialiased
    count = round(level.silhouettes * max(beam.size_deg / _LARGE_DEG, 1))
    count = count if beam.size_deg > 0 else _SHIFTED
    many = disc_directions(beam, disc(count))
    displaced = -(many[:, :2] @ axes.T) / many[:, 2:]
    dark = covered_fraction(
        points, caster.edges, caster.across, many, displaced, shape
    )
    if box is None:
        # the mean distance of K points on a unit disc is sqrt(pi / K)
        opens = np.abs(slopes[1:] - slopes[0]).max() * points[:, 2].max(initial=0)
        _even(dark, opens * float(np.sqrt(np.pi / count)) / 4)
    return PlaneTexture(_zero_border(dark), matrix)


def within_surface(
    textures: Iterable[PlaneTexture],
    surface_m: tuple[float, float, float, float] | None,
) -> list[PlaneTexture]:
    """The same, with nothing beyond the surface (x0, y0, x1, y1), which ends within a texel.

    None = unlimited"""
    if surface_m is None:
        return list(textures)
    out = []
    for texture in textures:
        matrix = texture.texel_from_m
        pitch = float(np.sqrt(abs(1 / np.linalg.det(matrix[:, :2]))))
        inside = _inside_m(texel_places(texture), surface_m)
        share = np.clip(inside / pitch + 0.5, 0, 1)
        out.append(PlaneTexture((texture.dark * share).astype(np.float32), matrix))
    return out


def plane_shadow_texture(
    shadow: PlaneShadow, ambient_fraction: ndarray
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


def texel_places(texture: PlaneTexture) -> ndarray:
    """(rows, columns, 2) x and y, metres, of the texels' centres."""
    rows, columns = texture.dark.shape[-2:]
    u, v = np.arange(columns), np.arange(rows)[:, None]
    metres = cv2.invertAffineTransform(texture.texel_from_m)
    return np.stack([a * u + b * v + c for a, b, c in metres], -1)


def _inside_m(places: ndarray, box: Sequence[float]) -> ndarray:
    """How far places (..., 2) lie inside a box x0, y0, x1, y1; below 0 outside."""
    x, y = places[..., 0], places[..., 1]
    across, along = (
        np.minimum(x - box[0], box[2] - x),
        np.minimum(y - box[1], box[3] - y),
    )
    return np.asarray(np.minimum(across, along))


def _zero_border(dark: ndarray) -> ndarray:
    """float32, contiguous, 0 along the border: what is looked up outside meets nothing."""
    return np.pad(np.clip(dark, 0, 1)[1:-1, 1:-1], 1).astype(np.float32)
