"""The job presets that come with arfx: configs/ in the source tree, arfx/config/presets/ in an installed wheel."""

from __future__ import annotations

import os
from pathlib import Path

from arfx.config.load import near
from arfx.errors import InputError

_PLACES = (Path(__file__).parent / "presets", Path(__file__).parents[2] / "configs")


def presets() -> dict[str, Path]:
    """Name -> file."""
    place = next((p for p in _PLACES if p.is_dir()), None)
    return {} if place is None else {p.stem: p for p in sorted(place.glob("*.toml"))}


def find(name_or_file: Path) -> Path:
    """A job file, or a preset by its bare name. Raises InputError naming the presets."""
    if os.path.exists(name_or_file) or name_or_file.suffix or len(name_or_file.parts) > 1:  # noqa: PTH110 - False for a name too long
        return name_or_file
    known = presets()
    if str(name_or_file) not in known:
        raise InputError(f"there is no job file or preset {str(name_or_file)!r}", near(str(name_or_file), known))
    return known[str(name_or_file)]
