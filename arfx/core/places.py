"""Where arfx keeps what outlives a job."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """arfx's own in the user's cache folder; it may not exist yet. Raises RuntimeError where the user has no home."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "arfx"
