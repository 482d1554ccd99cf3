"""Names of outputs (-o) made from a pattern and what they are made of: out/{parent}/{stem}.mp4."""

from __future__ import annotations

import string
from pathlib import Path

from arfx.errors import ConfigError

# field -> what it stands for; "{{" and "}}" are braces
FIELDS = {"stem": "the clip's name without its ending", "parent": "the name of its folder"}


def has_field(pattern: Path) -> bool:
    """Raises ConfigError for a field that does not exist, or a brace alone."""
    return any(field is not None for _, field in _parts(str(pattern)))


def named(pattern: Path, source: Path, numbered: bool = False) -> Path:
    """The pattern's path for one source, a file or a folder. numbered : its name is a
    format with a frame number in it

    Raises ConfigError as `has_field`, and where the source gives a field no name."""
    values = {
        "stem": source.name if source.is_dir() else source.stem,
        "parent": source.parent.resolve().name,
    }
    for field in {field for _, field in _parts(str(pattern)) if field is not None}:
        if values[field] in ("", ".", ".."):
            raise ConfigError(
                f"{source}: -o {pattern} needs its {{{field}}}, which is {values[field]!r}",
                "rename it",
            )
    name = {field: v.replace("%", "%%") if numbered else v for field, v in values.items()}
    return Path(str(pattern.parent).format(**values)) / pattern.name.format(**name)


def fixed_folder(pattern: Path) -> Path:
    """The folder that all paths of a pattern lie in."""
    while has_field(pattern.parent):
        pattern = pattern.parent
    return Path(str(pattern.parent).format())


def _parts(text: str) -> list[tuple[str, str | None]]:
    """(text, the field behind it or None)"""
    known = "; ".join(f"{{{name}}} is {what}" for name, what in FIELDS.items())
    try:
        parts = list(string.Formatter().parse(text))
    except ValueError:
        raise ConfigError(
            f"-o {text}: a brace stands alone", f"{known}; {{{{ is a brace"
        ) from None
    for _, field, form, conversion in parts:
        if field is not None and (field not in FIELDS or form or conversion):
            rest = (f"!{conversion}" if conversion else "") + (f":{form}" if form else "")
            shown = f"{{{field}{rest}}}"
            raise ConfigError(
                f"-o {text}: there is no field {shown}", f"{known}; {{{{ is a brace"
            )
    return [(literal, field) for literal, field, _, _ in parts]
