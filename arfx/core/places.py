"""Where arfx keeps what outlives a job, and which names of files it takes."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from arfx.errors import ConfigError


def cache_folder() -> Path:
    """arfx's own in the user's cache folder; it may not exist yet. Raises RuntimeError where the user has no home."""
    home = Path.home()
    by_system = {"win32": home / "AppData" / "Local", "darwin": home / "Library" / "Caches"}
    return Path(os.environ.get("XDG_CACHE_HOME") or by_system.get(sys.platform, home / ".cache")) / "arfx"


def check_name(name: str | Path) -> None:
    """Raises ConfigError for a name that is not text in the system's encoding: job files cannot hold it, and OpenCV crashes."""
    try:
        str(name).encode()
    except UnicodeEncodeError:
        raise ConfigError(
            f"the name {str(os.fsencode(name))[1:]} is not {sys.getfilesystemencoding()} text", "rename it"
        ) from None
