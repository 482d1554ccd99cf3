"""What all model files share of materials: pictures as arrays of a bounded size, numbers in range,
what is not drawn."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from arfx.core.model import Material, Texture
from arfx.errors import InputError
from arfx.media.model_files import ModelFolder

_BRIGHTEST = 1e6  # emission, where white paper in full light is 1
MAX_TEXELS = (
    8192**2 + 2 * 4096**2
)  # of a model together: 20 bytes each while it is drawn, 2 GB
# An 8k texture takes seconds and a gigabyte in software OpenGL; beyond it drivers refuse.
MAX_TEXTURE_PX = 8192


# The one list of what is read of a material and not drawn: words for the notice, and who has it.
NOT_DRAWN: tuple[tuple[str, Callable[[Material], bool]], ...] = (
    ("occlusion maps", lambda m: m.occlusion_texture is not None),
    ("clear coat", lambda m: m.clearcoat > 0),
    ("sheen of cloth", lambda m: any(m.sheen_colour)),
)


def not_drawn(materials: Iterable[Material]) -> list[str]:
    """Words for what the materials of a model hold and no renderer draws."""
    given = list(materials)
    return [text for text, has in NOT_DRAWN if any(map(has, given))]


def plain_material(has_colours: bool, double_sided: bool) -> Material:
    """Of a mesh that has none: light grey, white where vertices have colours of their own."""
    grey = 1.0 if has_colours else 0.8
    return Material(base_colour=(grey, grey, grey, 1.0), double_sided=double_sided)


class Textures:
    """The pictures of a model as arrays, each decoded once. path : of the model, for messages"""

    def __init__(self, folder: ModelFolder) -> None:
        self.path, self._folder = folder.path, folder
        self._named: dict[Any, np.ndarray | None] = {}
        # The picture too: its id stays unique while it lives.
        self._arrays: dict[int, tuple[Any, np.ndarray]] = {}
        self._texels = 0

    def read(self, name: Any, content: Callable[[], bytes]) -> np.ndarray | None:
        """(h, w, 4) uint8 of the picture of that name in the model; None: it is not there or no
        picture, which the folder tells. Raises InputError as `of`, which see."""
        if name not in self._named:
            image = None
            with contextlib.suppress(InputError):
                image = self._folder.picture(content())
            self._named[name] = self.of(image)
        return self._named[name]

    def of(self, image: Any) -> np.ndarray | None:
        """(h, w, 4) uint8 of a Pillow picture, None for None.

        Raises InputError: too large, damaged."""
        if image is None:
            return None
        if id(image) not in self._arrays:
            self._check_size(*image.size)
            try:
                self._arrays[id(image)] = (
                    image,
                    np.asarray(_in_8_bits(image).convert("RGBA")),
                )
            except (OSError, ValueError, SyntaxError) as e:  # Pillow decodes late
                what = "a texture is damaged or cut short"
                raise InputError(f"model {self.path}: {what}", "export it again") from e
        return self._arrays[id(image)][1]

    def texture(self, image: Any) -> Texture | None:
        """The picture laid by the first texture coordinates as they are."""
        picture = self.of(image)
        return None if picture is None else Texture(picture)

    def _check_size(self, width: int, height: int) -> None:
        if max(width, height) > MAX_TEXTURE_PX:
            hint = f"at most {MAX_TEXTURE_PX} px a side: scale it down"
            raise InputError(f"model {self.path}: a texture is {width}x{height} px", hint)
        self._texels += width * height
        if self._texels > MAX_TEXELS:
            what = f"its textures hold more than {MAX_TEXELS / 1e6:.0f} megapixels"
            raise InputError(f"model {self.path}: {what}", "scale them down")

    def close(self) -> None:
        """Lets go of the pictures, the arrays stay: trimesh's objects refer to each other in
        circles and live on."""
        for image, _ in self._arrays.values():
            image.close()


def _in_8_bits(image: Any) -> Any:
    """Pillow cuts 16-bit greys off at 255 where they should be scaled."""
    from PIL import Image

    if not image.mode.startswith("I"):
        return image
    return Image.fromarray(np.clip(np.asarray(image) >> 8, 0, 255).astype(np.uint8))


def unit(value: Any) -> float:
    """A number between 0 and 1."""
    return float(np.clip(float(value), 0.0, 1.0))


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
        what = (
            f"material {name!r} holds numbers that are not finite, or above {_BRIGHTEST:g}"
        )
        raise InputError(f"model {path}: {what}", "export it again")
