"""Materials of MTL files, with the physical terms that later exporters write.

Those are Pr, Pm, Ps, Pc, Pcr, Ke and norm, and maps of Pr, Pm and Ke. Kd is a display colour
(sRGB), Ke radiance. Ns is a Blinn-Phong exponent, turned into roughness = sqrt(2 / (Ns + 2)) to the
half (Karis 2013); Pr goes before it. d < 1 is BLEND. A map of Pr or Pm stands in their place.
map_Bump is a normal map where it has colours. Leaves out: `Tr`, of which exporters disagree whether
1 means clear or solid; grey heights; map_d."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from arfx.core.colour import SRGB
from arfx.core.model import BLEND, CLAMP, OPAQUE, REPEAT, Material, Texture
from arfx.media.model_files import ModelFile
from arfx.media.model_materials import check_numbers, checked, resized

# Options of maps and how many values they take at most; those that are read, or change nothing.
_OPTIONS = dict.fromkeys(
    ("-clamp", "-imfchan", "-cc", "-bm", "-boost", "-blendu", "-blendv"), 1
)
_OPTIONS |= {"-texres": 1, "-type": 1, "-s": 3, "-o": 3, "-t": 3, "-mm": 2}
_READ = ("-s", "-o", "-clamp", "-bm", "-boost", "-blendu", "-blendv", "-texres", "-type")
_MAPS = ("map_kd", "map_ke", "map_pr", "map_pm", "norm", "map_bump", "bump")
_OTHER_MAPS = ("map_", "disp", "decal", "refl")
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
    m = _Statements(file, name, lines, left_out)
    base, _ = m.texture("map_kd")
    glow, _ = m.texture("map_ke")
    rough, _ = m.texture("map_pr")
    metal, _ = m.texture("map_pm")
    normal, scale = m.normal_texture()
    display = m.colour("kd", _GREY if base is None else 1.0)
    red, green, blue = SRGB.decode(np.clip(display, 0, 1))
    alpha = min(max(m.number("d", 1.0), 0.0), 1.0)
    shine = 2.0 / (max(m.number("ns", 0.0), 0.0) + 2.0)
    metallic, roughness = m.number("pm", 0.0), m.number("pr", shine**0.25)
    sheen = min(max(m.number("ps", 0.0), 0.0), 1.0)
    emissive = m.colour("ke", 0.0 if glow is None else 1.0)
    material = Material(
        name=name,
        base_colour=(float(red), float(green), float(blue), alpha),
        base_texture=base,
        metallic=1.0 if metal is not None else metallic,
        roughness=1.0 if rough is not None else max(roughness, 0.05),
        metallic_roughness_texture=_joined(rough, metal),
        emissive=(emissive[0], emissive[1], emissive[2]),
        emissive_texture=glow,
        alpha_mode=BLEND if alpha < 1.0 else OPAQUE,
        double_sided=True,  # nobody promises an OBJ's winding
        normal_texture=normal,
        normal_scale=scale,
        clearcoat=m.number("pc", 0.0),
        clearcoat_roughness=m.number("pcr", 0.0),
        sheen_colour=(sheen, sheen, sheen),
        sheen_roughness=_SHEEN_ROUGHNESS,
    )
    return checked(material, file.path)


class _Statements:
    """What one material states, the last of each kind."""

    def __init__(
        self,
        file: ModelFile,
        name: str,
        lines: Iterable[str],
        left_out: dict[str, None],
    ) -> None:
        self._file, self._name, self._left_out = file, name, left_out
        rows = (row for line in lines if len(row := line.split(None, 1)) == 2)
        self._rows = {key.lower(): (key, value.strip()) for key, value in rows}
        base = self._rows.get("map_kd", ("", ""))[1]
        for key, (written, value) in self._rows.items():
            unread = key.startswith(_OTHER_MAPS) and key not in _MAPS
            if unread and not (key == "map_ka" and value == base):
                left_out[written] = None

    def numbers(self, key: str) -> list[float]:
        """[] where it is not stated, or no number. Raises InputError: out of range."""
        written, value = self._rows.get(key, ("", ""))
        value = value.split("#")[0].strip().removeprefix("-halo").strip()
        out = numbers(value.split())
        if value and not out:
            self._left_out[f"{written} {value[:40]}"] = None
        check_numbers(self._name, out, self._file.path)
        return out

    def number(self, key: str, default: float) -> float:
        return (self.numbers(key) or [default])[0]

    def colour(self, key: str, default: float) -> list[float]:
        """Three numbers; one stands for all."""
        return [float(x) for x in np.resize(self.numbers(key)[:3] or [default], 3)]

    def normal_texture(self) -> tuple[Texture | None, float]:
        """And its scale."""
        key = next((k for k in ("norm", "map_bump", "bump") if k in self._rows), "norm")
        texture, scale = self.texture(key)
        if texture is not None and (np.ptp(texture.picture[..., :3], axis=-1) == 0).all():
            self._left_out[f"grey heights of {self._rows[key][0]}"] = None
            return None, 1.0
        return texture, scale

    def texture(self, key: str) -> tuple[Texture | None, float]:
        """`map_Kd -s 2 2 -o .5 0 name of a file.png`, and the factor of its option -bm."""
        written, value = self._rows.get(key, ("", ""))
        options, name = _options(value)
        for option, words in options.items():
            if option not in _READ and words[:1] != ["off"]:
                self._left_out[f"{option} of {written}"] = None
        picture = self._file.picture(name) if name else None
        if picture is None:
            return None, 1.0
        scale, offset = [1.0, 1.0], [0.0, 0.0]
        for option, place in (("-s", scale), ("-o", offset)):
            stated = numbers(options.get(option, []))[:2]
            place[: len(stated)] = stated
        # an MTL file counts v from the bottom
        rows = [[scale[0], 0, offset[0]], [0, scale[1], 1 - scale[1] - offset[1]]]
        wrap = CLAMP if options.get("-clamp") == ["on"] else REPEAT
        strength = (numbers(options.get("-bm", [])) or [1.0])[0]
        return Texture(picture, 0, np.array(rows, float), (wrap, wrap)), strength


def _options(value: str) -> tuple[dict[str, list[str]], str]:
    """Options of a map with their values, and the name of its file, which may hold blanks."""
    options: dict[str, list[str]] = {}
    while value and (option := value.split(None, 1)[0].lower()) in _OPTIONS:
        most = _OPTIONS[option]
        words = value.split(None, most + 1)[1:]
        count = 1
        if most > 1:
            count = next((k for k in range(most) if not numbers(words[k : k + 1])), most)
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
    """Of all words, none where one is no number."""
    try:
        return [float(word) for word in words]
    except ValueError:
        return []
