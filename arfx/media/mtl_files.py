"""Materials of MTL files, with the physical terms that later exporters write.

Those are Pr, Pm, Ps, Pc, Pcr, Ke and norm, and maps of Pr, Pm and Ke. Kd is a display colour
(sRGB), Ke radiance. Ns is a Blinn-Phong exponent, turned into roughness = sqrt(2 / (Ns + 2)) to the
half (Karis 2013); Pr goes before it. d < 1 is BLEND. A map of Pr or Pm stands in their place.
map_Bump is a normal map where it has colours. Leaves out: `Tr`, of which exporters disagree whether
1 means clear or solid; grey heights; map_d."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, CLAMP, OPAQUE, REPEAT, Material, Texture
from arfx.media.model_files import TABLES, ModelFile
from arfx.media.model_parts import checked, resized

_MTL = TABLES["mtl"]
_GREY = 0.4  # display colour of a material that states neither Kd nor a map
_SHEEN_ROUGHNESS = 0.5  # MTL has none


def mtl_material(
    file: ModelFile,
    name: str,
    lines: Iterable[str],
    left_out: dict[str, None],
) -> Material:
    """Of the lines below `newmtl`. left_out : gets what is, as keys

    Raises InputError: numbers out of range, a texture too large or damaged."""
    m = _Statements(file, lines, left_out)
    base, glow = m.texture("map_kd"), m.texture("map_ke")
    rough, metal = m.texture("map_pr"), m.texture("map_pm")
    bumps = next((k for k in ("norm", "map_bump", "bump") if k in m.stated), "norm")
    normal = m.texture(bumps)
    if normal is not None and (np.ptp(normal.picture[..., :3], axis=-1) == 0).all():
        left_out[f"grey heights of {m.stated[bumps][0]}"] = None
        normal = None
    display = m.colour("kd", _GREY if base is None else 1.0)
    shares = np.clip([*display, m.number("d", 1.0), m.number("ps", 0.0)], 0, 1)
    red, green, blue = SRGB.decode(shares[:3]).tolist()
    alpha, sheen = shares[3:].tolist()
    shine = 2.0 / (max(m.number("ns", 0.0), 0.0) + 2.0)
    material = Material(
        name=name,
        base_colour=(red, green, blue, alpha),
        base_texture=base,
        metallic=m.number("pm", 0.0) if metal is None else 1.0,
        roughness=max(m.number("pr", shine**0.25), 0.05) if rough is None else 1.0,
        metallic_roughness_texture=_joined(rough, metal),
        emissive=m.colour("ke", 0.0 if glow is None else 1.0),
        emissive_texture=glow,
        alpha_mode=BLEND if alpha < 1.0 else OPAQUE,
        double_sided=True,  # nobody promises an OBJ's winding
        normal_texture=normal,
        normal_scale=(m.options(bumps, "-bm") or [1.0])[0],
        clearcoat=m.number("pc", 0.0),
        clearcoat_roughness=m.number("pcr", 0.0),
        sheen_colour=(sheen, sheen, sheen),
        sheen_roughness=_SHEEN_ROUGHNESS,
    )
    return checked(material)


class _Statements:
    """What one material states, the last of each kind.

    stated : by its key in lower case how it is written, and its value"""

    def __init__(
        self, file: ModelFile, lines: Iterable[str], left_out: dict[str, None]
    ) -> None:
        self._file, self._left_out = file, left_out
        rows = (row for line in lines if len(row := line.split(None, 1)) == 2)
        self.stated: dict[str, tuple[str, str]] = defaultdict(lambda: ("", ""))
        self.stated.update((key.lower(), (key, value.strip())) for key, value in rows)
        base = self.stated["map_kd"][1]
        for key, (written, value) in self.stated.items():
            unread = (
                key.startswith(tuple(_MTL["other_maps"])) and key not in _MTL["maps"]
            )
            if unread and not (key == "map_ka" and value == base):
                left_out[written] = None

    def _numbers(self, key: str) -> list[float]:
        """[] where it is not stated, or no number."""
        written, value = self.stated[key]
        value = value.split("#")[0].strip().removeprefix("-halo").strip()
        out = numbers(value.split())
        if value and not out:
            self._left_out[f"{written} {value[:40]}"] = None
        return out

    def number(self, key: str, default: float) -> float:
        return (self._numbers(key) or [default])[0]

    def colour(self, key: str, default: float) -> tuple[float, float, float]:
        """One number stands for all."""
        red, green, blue = np.resize(self._numbers(key)[:3] or [default], 3).tolist()
        return red, green, blue

    def options(self, key: str, option: str) -> list[float]:
        """Numbers of an option of a map."""
        return numbers(_options(self.stated[key][1])[0].get(option, []))

    def texture(self, key: str) -> Texture | None:
        """`map_Kd -s 2 2 -o .5 0 name of a file.png`. Raises InputError."""
        written, value = self.stated[key]
        options, name = _options(value)
        for option, words in options.items():
            if option not in _MTL["read"] and words[:1] != ["off"]:
                self._left_out[f"{option} of {written}"] = None
        picture = self._file.picture(name) if name else None
        if picture is None:
            return None
        wide, high = (*self.options(key, "-s"), 1.0, 1.0)[:2]
        x, y = (*self.options(key, "-o"), 0.0, 0.0)[:2]
        # an MTL file counts v from the bottom
        matrix = np.array([[wide, 0, x], [0, high, 1 - high - y]], float)
        wrap = CLAMP if options.get("-clamp") == ["on"] else REPEAT
        return Texture(picture, 0, matrix, (wrap, wrap))


def _options(value: str) -> tuple[dict[str, list[str]], str]:
    """Options of a map with their values, and the name of its file, which may hold blanks."""
    options: dict[str, list[str]] = {}
    while value and (option := value.split(None, 1)[0].lower()) in _MTL["options"]:
        most = _MTL["options"][option]
        words = value.split(None, most + 1)[1:]
        count = 1
        if most > 1:
            count = next(
                (k for k in range(most) if not numbers(words[k : k + 1])), most
            )
        options[option] = words[:count]
        value = " ".join(value.split(None, count + 1)[count + 1 :])
    return options, value


def _joined(rough: Texture | None, metal: Texture | None) -> Texture | None:
    """Roughness in green, metallic in blue; laid as the first."""
    first = rough or metal
    if first is None:
        return None
    picture = np.full_like(first.picture, 255)
    if rough is not None:
        picture[..., 1] = rough.picture[..., 0]
    if metal is not None:
        picture[..., 2] = resized(metal.picture, *picture.shape[1::-1])[..., 0]
    return replace(first, picture=picture)


def numbers(words: list[str]) -> list[float]:
    """Of all words, none where one is no finite number."""
    try:
        out = [float(word) for word in words]
    except ValueError:
        return []
    return out if np.isfinite(out).all() else []
