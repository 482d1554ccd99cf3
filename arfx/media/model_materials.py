"""What all model files share of materials: colours, numbers in range."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.model import Material
from arfx.errors import InputError

_BRIGHTEST = 1e6  # emission, where white paper in full light is 1


def plain_material(has_colours: bool, double_sided: bool) -> Material:
    """Of a mesh that has none: light grey, white where vertices have colours of their own."""
    grey = 1.0 if has_colours else 0.8
    return Material(base_colour=(grey, grey, grey, 1.0), double_sided=double_sided)


def unit(value: Any) -> float:
    """A number between 0 and 1."""
    return float(np.clip(float(value), 0.0, 1.0))


def unit_colours(values: np.ndarray) -> np.ndarray:
    """(n, 4) between 0 and 1 of red, green, blue and maybe alpha (n, 3 or 4), whole numbers as
    shares of the largest; what is no number leaves a colour alone."""
    shares = values.astype(float)
    if values.dtype.kind in "ui":
        shares /= np.iinfo(values.dtype).max
    out = np.ones((len(values), 4))
    out[:, : values.shape[1]] = np.where(np.isfinite(shares), shares, 1.0)
    return np.clip(out, 0.0, 1.0)


def resized(picture: np.ndarray, wide: int, high: int) -> np.ndarray:
    """A picture (h, w, 4) uint8 of another size."""
    from PIL import Image

    return np.asarray(Image.fromarray(picture).resize((wide, high)))


def check_material(material: Material, path: Path) -> Material:
    """The same. Raises InputError: one of its numbers is out of range."""
    numbers = [
        np.ravel(x) for x in vars(material).values() if isinstance(x, (float, tuple))
    ]
    numbers += [t.picture_from_uv.ravel() for t in material.textures.values()]
    check_numbers(material.name, np.concatenate(numbers), path)
    return material


def check_numbers(name: str, numbers: Any, path: Path) -> None:
    """name : of the material. Raises InputError."""
    if not (np.abs(numbers) <= _BRIGHTEST).all():
        what = f"material {name!r} holds numbers that are not finite, or above {_BRIGHTEST:g}"
        raise InputError(f"model {path}: {what}", "export it again")
