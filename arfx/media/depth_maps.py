"""Measured depth of the real scene: a folder of maps (16-bit PNG or PGM, TIFF, EXR), a file that holds many (TIFF, video),
or one map for a camera at rest.

Depth runs along the optical axis, upright as the clip is shown. 0, negative, not finite and the largest value of 16 bits
mean that nothing was measured there. Maps belong to frames by their order, or by the time in their names as TUM RGB-D
writes them (1305031102.160407.png: seconds), or by the times of a video's frames.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arfx.core.opener import is_folder, read_bytes
from arfx.errors import InputError
from arfx.media.depth_frames import TIFF, VIDEO, DepthPages, DepthVideo, open_frames
from arfx.media.images import decode_picture, read_exr
from arfx.media.pairing import by_time, in_order

SUFFIXES = (".png", ".pgm", ".exr", *TIFF)
_KINDS = "16-bit PNG or PGM, TIFF, EXR"
_STEPS_A_METRE = 1000.0  # of integers, where the job does not say otherwise: millimetres
_ASPECT = 0.005


@dataclass(frozen=True)
class DepthMaps:
    """files : in order;  steps_per_m : stored values to a metre, None = by kind (integers: millimetres, floats: metres)

    times_s : of each map after the first one, where they are told, else None;  start_s : of the first, after the clip's
    frames : the maps where one file holds them, else None: each file is one
    """

    path: Path
    files: tuple[Path, ...]
    steps_per_m: float | None
    times_s: tuple[float, ...] | None
    start_s: float = 0.0
    frames: DepthVideo | DepthPages | None = None

    @property
    def count(self) -> int:
        return len(self.files) if self.frames is None else self.frames.count

    @property
    def still(self) -> bool:
        """One map for every frame."""
        return self.count == 1

    def name(self, number: int) -> str:
        """What messages call a map."""
        return str(self.files[number]) if self.frames is None else f"{self.path}, map {number}"

    def of_frames(self, times_s: list[float], before: int, whole: bool) -> list[int | None]:
        """Number of each frame's map, None where none was taken near its time.

        times_s : after the clip's first frame;  before, whole : as of `in_order`, which raises InputError
        """
        if self.still:
            return [0] * len(times_s)
        if self.times_s is not None:
            return by_time(np.array(self.times_s) + self.start_s, times_s)
        hint = "one map for each frame, or times in their names (1305031102.160407.png), or a single map"
        return in_order(f"depth {self.path} holds {self.count} maps", self.count, len(times_s), before, whole, hint)

    def load(self, number: int, width: int, height: int) -> np.ndarray:
        """(h, w) float32 metres of a map at its own size; nothing measured = 0.

        width, height : of the clip. Raises InputError: unreadable, of another kind or shape.
        """
        stored = (
            _stored(self.files[number]) if self.frames is None else _depth_kind(self.frames.stored(number), self.name(number))
        )
        h, w = stored.shape
        if abs(w * height / (h * width) - 1) > _ASPECT:
            raise InputError(
                f"depth map {self.name(number)} is {w}x{h}, the clip {width}x{height}: another shape",
                "maps as the clip is shown, of its size or the same aspect ratio",
            )
        steps = self.steps_per_m or (_STEPS_A_METRE if stored.dtype.kind == "u" else 1.0)
        with np.errstate(all="ignore"):
            metres = stored.astype(np.float32) / np.float32(steps)
            good = np.isfinite(metres) & (metres > 0)
            if stored.dtype.kind == "u":
                good &= stored < np.iinfo(stored.dtype).max
        return np.where(good, metres, np.float32(0))

    def digest(self, number: int) -> str:
        """Of a map's file, or of its values."""
        if self.frames is not None:
            return hashlib.blake2b(self.frames.stored(number).tobytes(), digest_size=8).hexdigest()
        return hashlib.blake2b(read_bytes(self.files[number], "depth map"), digest_size=8).hexdigest()


def open_depth(path: Path, steps_per_m: float | None = None, start_s: float = 0.0) -> DepthMaps:
    """List a folder's maps, or take one file. Raises InputError: missing, empty, kinds mixed, times twice."""
    if not is_folder(path, "depth"):
        if path.suffix.lower() in (*TIFF, *VIDEO):
            frames = open_frames(path)
            return DepthMaps(path, (path,), steps_per_m, frames.times_s, start_s, frames)
        if path.suffix.lower() not in SUFFIXES:
            raise InputError(f"depth {path} is not a depth map", f"{_KINDS}; a folder of them; or a video of 16-bit grey (FFV1)")
        return DepthMaps(path, (path,), steps_per_m, None)
    found = [p for p in _listed(path) if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")]
    if not found:
        raise InputError(f"depth folder {path} holds no depth map", _KINDS)
    kinds = sorted({p.suffix.lower() for p in found})
    if len(kinds) > 1:
        raise InputError(f"depth folder {path} holds {' and '.join(kinds)} files", "maps of one kind only")
    stamps = [_time(p.stem) for p in found]
    if len(found) > 1 and all(t is not None for t in stamps):
        ordered = sorted(zip((t for t in stamps if t is not None), found, strict=True))
        times = np.array([t for t, _ in ordered])
        if (np.diff(times) <= 0).any():
            raise InputError(f"depth folder {path}: two maps have the same time in their names")
        return DepthMaps(path, tuple(p for _, p in ordered), steps_per_m, tuple((times - times[0]).tolist()), start_s)
    return DepthMaps(path, tuple(sorted(found, key=_natural)), steps_per_m, None)


def _listed(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError as e:
        raise InputError(f"depth folder {folder} cannot be listed: {e.strerror}") from None


def _time(stem: str) -> float | None:
    """Seconds in a map's name; only with a fraction: 12.png is the twelfth map, not the twelfth second."""
    return float(stem) if re.fullmatch(r"\d+\.\d+", stem) else None


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """2 before 10."""
    return [(int(n), "") if n else (-1, text) for n, text in re.findall(r"(\d+)|(\D+)", path.stem)], path.name


def _stored(path: Path) -> np.ndarray:
    """(h, w) as stored: uint16 or float32."""
    if path.suffix.lower() == ".exr":
        picture = read_exr(path, "depth map")
        return np.ascontiguousarray(picture if picture.ndim == 2 else picture[..., 0])
    import cv2

    return _depth_kind(decode_picture(path, "depth map", cv2.IMREAD_UNCHANGED), str(path))


def _depth_kind(raw: np.ndarray, name: str) -> np.ndarray:
    """The same, if it is one channel of 16 bits or float32. Raises InputError."""
    if raw.ndim != 2 or raw.dtype not in (np.uint16, np.float32):
        kind = f"{raw.dtype} with {1 if raw.ndim == 2 else raw.shape[2]} channel{'s' if raw.ndim > 2 else ''}"
        raise InputError(
            f"depth map {name} holds {kind}, not depth", "one channel of 16 bits: a PNG or PGM as RGB-D cameras give"
        )
    return raw
