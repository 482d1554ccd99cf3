"""Names of outputs (-o) made from a pattern and what they are made of: out/{parent}/{stem}.mp4."""

import re
from pathlib import Path

from arfx.errors import ConfigError

# field -> what it stands for; "{{" and "}}" are braces
FIELDS = {
    "stem": "the clip's name without its ending",
    "parent": "the name of its folder",
}
_BRACES = re.compile(r"\{\{|\}\}|\{([^{}]*)\}|[{}]")


def has_field(pattern: Path) -> bool:
    """Raises ConfigError for a field that does not exist, or a brace alone."""
    return bool(_fields(pattern))


def named(pattern: Path, source: Path, numbered: bool = False) -> Path:
    """The pattern's path for one source, a file or a folder. numbered : its name is a
    format with a frame number in it

    Raises ConfigError as `has_field`, and where the source gives a field no name."""
    values = {
        "stem": source.name if source.is_dir() else source.stem,
        "parent": source.parent.resolve().name,
    }
    for field in _fields(pattern):
        if values[field] in ("", ".", ".."):
            raise ConfigError(
                f"{source}: -o {pattern} needs its {{{field}}}, which is {values[field]!r}",
                "rename it",
            )
    name = {
        field: v.replace("%", "%%") if numbered else v for field, v in values.items()
    }
    return Path(str(pattern.parent).format(**values)) / pattern.name.format(**name)


def fixed_folder(pattern: Path) -> Path:
    """The folder that all paths of a pattern lie in."""
    while has_field(pattern.parent):
        pattern = pattern.parent
    return Path(str(pattern.parent).format())


def _fields(pattern: Path) -> set[str]:
    found = [m for m in _BRACES.finditer(str(pattern)) if m[0] not in ("{{", "}}")]
    for m in found:
        if m[1] not in FIELDS:
            known = "; ".join(
                f"{{{name}}} is {what}" for name, what in FIELDS.items()
            )
            raise ConfigError(
                f"-o {pattern}: there is no field {m[0]}", f"{known}; {{{{ is a brace"
            )
    return {m[1] for m in found}
