"""arfx: batch augmented-reality video from a recorded clip and a camera calibration."""

__version__ = "0.1.0"
