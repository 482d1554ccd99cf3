"""What all model files share of materials: colours, numbers in range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, MASK, OPAQUE, Material
from arfx.errors import InputError

_BRIGHTEST = 1e6  # emission, where white paper in full light is 1
_UNIT = ("metallic", "roughness", "clearcoat", "clearcoat_roughness", "sheen_roughness")


def plain_material(has_colours: bool, double_sided: bool) -> Material:
    """Of a mesh that has none: light grey, white where vertices have colours of their own."""
    grey = 1.0 if has_colours else 0.8
    return Material(base_colour=(grey, grey, grey, 1.0), double_sided=double_sided)


def shares(values: np.ndarray) -> np.ndarray:
    """Whole numbers as shares of the largest one, at least -1; floats as they are."""
    if values.dtype.kind == "f":
        return values
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


def unit_colours(values: np.ndarray) -> np.ndarray:
    """(n, 4) between 0 and 1 of red, green, blue and maybe alpha (n, 3 or 4), whole numbers as
    `shares`; what is no number leaves a colour alone."""
    out = np.ones((len(values), 4))
    out[:, : values.shape[1]] = np.nan_to_num(shares(values), nan=1, posinf=1, neginf=1)
    return np.clip(out, 0.0, 1.0)


def linear_colours(display: np.ndarray) -> np.ndarray:
    """(n, 4) of display colours (sRGB) as `unit_colours` takes them."""
    out = unit_colours(display)
    out[:, :3] = SRGB.decode(out[:, :3])
    return out


def resized(picture: np.ndarray, wide: int, high: int) -> np.ndarray:
    """A picture (h, w, 4) uint8 of another size."""
    from PIL import Image

    return np.asarray(Image.fromarray(picture).resize((wide, high)))


def checked(material: Material) -> Material:
    """The same, what is a share between 0 and 1, and opaque where its alpha mode is none.

    Raises InputError: one of its numbers is out of range; ValueError: a colour has too few or
    too many."""
    colours = (material.base_colour, material.emissive, material.sheen_colour)
    if [len(colour) for colour in colours] != [4, 3, 3]:
        raise ValueError
    given = vars(material).values()
    numbers = [np.ravel(x) for x in given if isinstance(x, (float, tuple))]
    numbers += [t.picture_from_uv.ravel() for t in material.textures.values()]
    if not (np.abs(np.concatenate(numbers)) <= _BRIGHTEST).all():
        what = f"material {material.name!r} holds numbers that are not finite, or above"
        raise InputError(f"{what} {_BRIGHTEST:g}", "export it again")
    mode = material.alpha_mode.upper()
    shares = {name: min(max(getattr(material, name), 0.0), 1.0) for name in _UNIT}
    return replace(
        material, alpha_mode=mode if mode in (MASK, BLEND) else OPAQUE, **shares
    )
