"""Radiance of every covered pixel of the virtual object under the light of its frame.

Metals and dielectrics as in glTF 2.0: Lambert's diffuse part, and GGX with Smith's
height-correlated shadowing and Schlick's Fresnel term. Lamps are seen by the lobe itself,
which a lamp of some size widens; soft light by its harmonics, and the surroundings mirrored
by the split sum. What single reflections lose is given back (Turquin 2019), so that a white
surface under even light is white at every roughness. What a camera adds where no light
falls is added to the object too.
Cost: O(covered pixels x (1 + lamps)). Leaves out: light from the object, and from the
plane, onto the object.
Source: docs/methods/light.md#shading, docs/methods/light.md#reflections."""

# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from arfx.core.compiled import FAST, line_kernel
from arfx.core.vectors import dot, minus, scaled, shifted, unit, vector
from arfx.stages.light.environment import Environment, radiance
from arfx.stages.light.split_sum import table_entry

_F = np.float32
SMOOTHEST = 0.05  # roughness: a smoother lobe lies between two pixels
_TINY = _F(1e-12)


class Surface(NamedTuple):
    """Layers of the object over one rectangle."""

    coverage: ndarray
    normal: ndarray
    position: ndarray
    albedo: ndarray
    material: ndarray
    emissive: ndarray


class Lights(NamedTuple):
    """Directional: towards, rgb (l, 3), widths (l,) of `highlight_width`; visibility (l, h,
    w);  soft_visibility (h, w)
    """

    towards: ndarray
    rgb: ndarray
    widths: ndarray
    visibility: ndarray
    soft_visibility: ndarray


def harmonic_terms(soft: ndarray, ambient: ndarray) -> ndarray:
    """(9, 3) float32 factors of 1, y, z, x, xy, yz, 3z^2 - 1, xz, x^2 - y^2; without
    harmonics the first alone.
    """
    out = np.zeros((9, 3))
    out[0] = ambient
    if len(soft):
        first, second = 0.4886025119029199, 1.0925484305920792
        scale = [0.28209479177387814, first, first, first, second, second]
        scale += [0.31539156525252005, second, second / 2]
        out[:] = soft * np.array(scale)[:, None]
    return out.astype(np.float32)


def highlight_width(size_deg: ndarray) -> ndarray:
    """What a light's disc (full angle) adds to roughness^4: a disc of radius a spreads
    half-vectors by a^2 / 16, the lobe's own spread is roughness^4 / 2."""
    return (np.radians(np.asarray(size_deg, float) / 2) ** 2 / 8).astype(np.float32)


@line_kernel(fastmath=FAST)
def ggx_reflection(alpha2, wide, n_h, n_v, n_l):  # pragma: no cover - compiled
    """What a lamp shows by microfacets, without Fresnel's factor, over the radiance of a
    white surface that faces it.

    alpha2 : roughness^4;  wide : the same with the lamp's own size;  n_h, n_v, n_l :
    cosines of half-vector, eye and lamp
    Source: Walter et al. 2007 (GGX), Heitz 2014 (height-correlated shadowing)."""
    one = _F(1)
    spread = n_h * n_h * (wide - one) + one
    eye = n_l * np.sqrt(n_v * n_v * (one - alpha2) + alpha2)
    lamp = n_v * np.sqrt(n_l * n_l * (one - alpha2) + alpha2)
    return _F(0.5) * n_l * wide / max(spread * spread * (eye + lamp), _TINY)


@line_kernel(fastmath=FAST)
def soft_radiance(soft, channel, normal):  # pragma: no cover - compiled
    """Of a white surface, never below 0. soft (9, 3) : of `harmonic_terms`"""
    c, (x, y, z) = channel, normal
    light = soft[0, c] + soft[1, c] * y + soft[2, c] * z + soft[3, c] * x
    light += soft[4, c] * x * y + soft[5, c] * y * z + soft[7, c] * x * z
    light += soft[6, c] * (_F(3) * z * z - _F(1)) + soft[8, c] * (x * x - y * y)
    return max(light, _F(0))


@line_kernel(fastmath=FAST)
def mirrored_share(visible, n_v, roughness):  # pragma: no cover - compiled
    """Share of what is mirrored that the object does not hide, 0..1, after what it leaves
    of the soft light.

    Source: Lagarde and de Rousiers 2014, listing 26, its power taken as its tangent."""
    one = _F(1)
    smooth = one - min(roughness, one)
    smooth *= smooth
    smooth *= smooth
    turned = _F(0.5) * smooth * smooth * (n_v + visible - one)
    return min(max(visible + turned, _F(0)), one)


@line_kernel(fastmath=FAST)
def reflected_shares(
    table, metal, roughness, specular, n_v
):  # pragma: no cover - compiled
    """(matt, coat, direct, grazing, lost): shares of even light, of the matt part, of what
    a dielectric mirrors, the split sum's two, and how much single reflections lose of white
    over what they mirror."""
    one, two = _F(1), _F(2)
    direct, grazing = table_entry(table, roughness, n_v)
    lost = one / (direct + grazing) - one
    varnish = _F(0.08) * specular
    coat = varnish * direct + min(two * specular, one) * grazing
    coat = min(coat * (one + varnish * lost), one)
    return (one - metal) * (one - coat), coat, direct, grazing, lost


@line_kernel(fastmath=FAST, inline="always")
def towards_eye(surface: Surface, eye, y, x):  # pragma: no cover - compiled
    """Normal of a pixel, and the unit direction to the eye."""
    return vector(surface.normal[y, x]), unit(minus(eye, surface.position[y, x]))


@line_kernel(fastmath=FAST, inline="always")
def half_vector(n_v, n_l, v_l):  # pragma: no cover - compiled
    """(its cosine to the normal, 1 less its cosine to eye and lamp), from cosines of the
    normal, the eye and the lamp to each other."""
    half, one = _F(0.5), _F(1)
    v_h = np.sqrt(max(half * (one + v_l), _TINY))
    return min(max(half * (n_v + n_l) / v_h, _F(0)), one), one - min(v_h, one)


def shade(
    surface: Surface,
    eye: ndarray,
    lights: Lights,
    soft: ndarray,
    environment: Environment,
    mirrors: np.float32,
    table: ndarray,
    bias: ndarray,
) -> ndarray:
    """(h, w, 3) float32, premultiplied by the coverage.

    eye (3,) : the camera, WORLD frame;  soft (9, 3) : of `harmonic_terms`
    mirrors : share of the environment that is mirrored;  table : `split_sum`;  bias (3,)"""
    out = np.zeros((*surface.coverage.shape, 3), np.float32)
    _shade(out, surface, eye, lights, soft, environment, mirrors, table, bias)
    return out


@line_kernel(fastmath=FAST, error_model="numpy")
def _shade(
    out,
    surface: Surface,
    eye,
    lights: Lights,
    soft,
    environment: Environment,
    mirrors,
    table,
    bias,
):  # pragma: no cover - compiled
    coverage, _, _, albedo, material, emissive = surface
    towards, rgb, widths, visibility, soft_visibility = lights
    zero, one, two = _F(0), _F(1), _F(2)
    for y in range(coverage.shape[0]):
        for x in range(coverage.shape[1]):
            cover = coverage[y, x]
            if not cover > zero:
                continue
            normal, view = towards_eye(surface, eye, y, x)
            facing = dot(normal, view)
            n_v = max(facing, _F(1e-3))
            metal, rough, specular = (
                material[y, x, 0],
                material[y, x, 1],
                material[y, x, 2],
            )
            rough = max(rough, _F(SMOOTHEST))
            base = _F(0.08) * specular * (one - metal)
            # at grazing angles all is mirrored, unless the material is set not to be glossy
            # at all (F0 under 4 %)
            edge = metal + (one - metal) * min(two * specular, one)
            shares = reflected_shares(table, metal, rough, specular, n_v)
            matt, coat, direct, grazing, lost = shares
            colour, pixel = albedo[y, x], out[y, x]
            visible = soft_visibility[y, x]
            for c in range(3):
                pixel[c] = colour[c] * matt * visible * soft_radiance(soft, c, normal)
            if mirrors > zero:
                # the lobe's middle: the mirrored direction, the rougher the nearer to the
                # normal (Lagarde 2014)
                alpha = min(rough * rough, one)
                bend = (one - alpha) * (np.sqrt(one - alpha) + alpha)
                along = bend * (two * facing) + one - bend
                middle = shifted(scaled(along, normal), -bend, view)
                around = radiance(environment, middle, rough)
                share = mirrors * mirrored_share(visible, n_v, rough)
                for c in range(3):
                    mirrored = (
                        metal
                        * (colour[c] * direct + grazing)
                        * (one + colour[c] * lost)
                    )
                    pixel[c] += share * around[c] * ((one - metal) * coat + mirrored)
            alpha2 = rough * rough * rough * rough
            for k in range(towards.shape[0]):
                n_l = dot(normal, towards[k])
                arrives = visibility[k, y, x]
                if n_l <= zero or arrives <= zero:
                    continue
                n_h, away = half_vector(facing, n_l, dot(view, towards[k]))
                fresnel = edge * away * away * away * away * away
                lobe = ggx_reflection(alpha2, alpha2 + widths[k], n_h, n_v, n_l)
                diffuse = matt * n_l
                for c in range(3):
                    f0 = base + colour[c] * metal
                    gloss = lobe * (one + f0 * lost) * (f0 + (one - f0) * fresnel)
                    pixel[c] += rgb[k, c] * arrives * (colour[c] * diffuse + gloss)
            for c in range(3):
                pixel[c] = cover * (pixel[c] + emissive[y, x, c] + bias[c])
