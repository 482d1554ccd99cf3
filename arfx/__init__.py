"""arfx: batch augmented-reality video from a recorded clip and a camera calibration."""

from arfx.core import compiled as _compiled

__version__ = "0.1.0"
_compiled.configure_numba()
