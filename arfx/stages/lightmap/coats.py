"""What lies over the base of a material: cloth's fibres (sheen) and varnish (clear coat),
after `shading.shade`.

A coat takes from what is below as much as it reflects of even light itself. Clear coat is a
second lobe of GGX with 4 % at normal incidence, by the split sum as the base; sheen is a
volume of fibres (Zeltner, Burley and Chiang 2022), of soft light by what it reflects of
even light, of lamps by its lobe. Only for pixels that have one.
Cost: O(coated pixels x (1 + lamps)). Source: glTF 2.0, KHR_materials_clearcoat and
KHR_materials_sheen.
"""

# mypy: disable-error-code="no-untyped-def"
import numpy as np

from arfx.core.compiled import FAST, kernel, line_kernel
from arfx.core.vectors import dot, minus, scaled
from arfx.stages.light.environment import Environment, radiance
from arfx.stages.light.split_sum import table_entry
from arfx.stages.lightmap.shading import (
    SMOOTHEST,
    Lights,
    Surface,
    ggx_reflection,
    half_vector,
    mirrored_share,
    soft_radiance,
    towards_eye,
)

_F = np.float32
_F0 = _F(0.04)  # of varnish
_LEAST_SHEEN = 0.07  # roughness of fibres
_PER_ROOT_2PI = _F(0.3989422804)
_TINY = _F(1e-12)


@line_kernel(fastmath=FAST)
def sheen_reflected(roughness, n_v):  # pragma: no cover - compiled
    """Share of even light that fibres reflect, a Gauss over the cosine of view.

    Source: the fit of MaterialX 1.39.
    """
    y, y2 = roughness, roughness * roughness
    width = y * (_F(0.0206607) + _F(1.58491) * y)
    width /= _F(0.0379424) + y * (_F(1.32227) + y)
    middle = _F(1.7932) - _F(0.95943) * y2
    middle = _F(-0.193854) + y * (_F(-1.14885) + y * middle)
    middle *= y / (_F(0.046391) + y)
    least = _F(0.000654023) + (_F(-0.0207818) + _F(0.119681) * y) * y
    least *= y / (_F(1.26264) + y * (_F(-1.92021) + y))
    off = (n_v - middle) / width
    reflected = np.exp(_F(-0.5) * off * off) * _PER_ROOT_2PI / width + least
    return min(max(reflected, _F(0)), _F(1))


@line_kernel(fastmath=FAST)
def sheen_lobe(roughness, n_v, n_l, v_l):  # pragma: no cover - compiled
    """How a lamp's light is reflected by fibres over `sheen_reflected`, of the radiance of
    a white surface that faces it.

    v_l : cosine between eye and lamp. A cosine lobe, linearly transformed; its fit is
    MaterialX 1.39's.
    """
    one, zero = _F(1), _F(0)
    x, y, y2 = n_v, roughness, roughness * roughness
    wide = (_F(2.58126) * x + _F(0.813703) * y) * y
    wide /= one + _F(0.310327) * x * x + _F(2.60994) * x * y
    tilt = _F(0.0000254053) + _F(1.71228) * x
    tilt += _F(1.34174) * y2 - _F(1.71506) * x * y
    tilt = np.sqrt(max(one - x, zero)) * (y - one) * y2 * y / tilt
    forth = (v_l - n_v * n_l) / np.sqrt(
        max(one - n_v * n_v, _TINY)
    )  # of the lamp, along the eye's side
    aside2 = max(one - n_l * n_l - forth * forth, zero)
    along = wide * forth + tilt * n_l
    length2 = along * along + wide * wide * aside2 + n_l * n_l
    squeezed = wide / max(length2, _TINY)
    return n_l * squeezed * squeezed


@kernel(fastmath=FAST, error_model="numpy")
def add_sheen(
    out, surface: Surface, sheen, eye, lights: Lights, soft, bias
):  # pragma: no cover - compiled
    """Fibres over `out` (h, w, 3) of `shade`, in place.

    sheen (h, w, 4) : colour, roughness;  the others : of `shade`
    """
    zero, one = _F(0), _F(1)
    light = np.empty(3, np.float32)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            most = max(sheen[y, x, 0], sheen[y, x, 1], sheen[y, x, 2])
            cover = surface.coverage[y, x]
            if not (cover > zero and most > zero):
                continue
            normal, view = towards_eye(surface, eye, y, x)
            n_v = max(dot(normal, view), _F(1e-3))
            rough = max(sheen[y, x, 3], _F(_LEAST_SHEEN))
            reflected = sheen_reflected(rough, n_v)
            share = reflected * lights.soft_visibility[y, x]
            for c in range(3):
                light[c] = share * soft_radiance(soft, c, normal)
            for k in range(lights.towards.shape[0]):
                n_l = dot(normal, lights.towards[k])
                if n_l > zero:
                    v_l = dot(view, lights.towards[k])
                    lobe = (
                        reflected
                        * sheen_lobe(rough, n_v, n_l, v_l)
                        * lights.visibility[k, y, x]
                    )
                    for c in range(3):
                        light[c] += lights.rgb[k, c] * lobe
            left = one - most * reflected
            for c in range(3):
                base = left * (out[y, x, c] - cover * bias[c])
                out[y, x, c] = base + cover * (sheen[y, x, c] * light[c] + bias[c])


@kernel(fastmath=FAST, error_model="numpy")
def add_clear_coat(
    out,
    surface: Surface,
    coat,
    eye,
    lights: Lights,
    environment: Environment,
    mirrors,
    table,
    bias,
):  # pragma: no cover - compiled
    """Varnish over `out` (h, w, 3), in place.

    coat (h, w, 2) : how much, roughness;  the others : of `shade`
    """
    zero, one, two = _F(0), _F(1), _F(2)
    light = np.empty(3, np.float32)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            amount, cover = coat[y, x, 0], surface.coverage[y, x]
            if not (cover > zero and amount > zero):
                continue
            normal, view = towards_eye(surface, eye, y, x)
            facing = dot(normal, view)
            n_v = max(facing, _F(1e-3))
            rough = max(coat[y, x, 1], _F(SMOOTHEST))
            direct, grazing = table_entry(table, rough, n_v)
            reflected = amount * (_F0 * direct + grazing)
            mirrored = minus(scaled(two * facing, normal), view)
            share = (
                mirrors
                * mirrored_share(lights.soft_visibility[y, x], n_v, rough)
                * reflected
            )
            around = radiance(environment, mirrored, rough)
            for c in range(3):
                light[c] = share * around[c]
            alpha2 = rough * rough * rough * rough
            for k in range(lights.towards.shape[0]):
                n_l = dot(normal, lights.towards[k])
                if n_l > zero:
                    v_l = dot(view, lights.towards[k])
                    n_h, away = half_vector(facing, n_l, v_l)
                    fresnel = _F0 + (one - _F0) * away * away * away * away * away
                    lobe = ggx_reflection(
                        alpha2, alpha2 + lights.widths[k], n_h, n_v, n_l
                    )
                    lobe *= amount * fresnel * lights.visibility[k, y, x]
                    for c in range(3):
                        light[c] += lights.rgb[k, c] * lobe
            for c in range(3):
                base = (one - reflected) * (out[y, x, c] - cover * bias[c])
                out[y, x, c] = base + cover * (light[c] + bias[c])
