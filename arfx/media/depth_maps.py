"""Measured depth of the real scene, read and its holes filled: a folder of maps (16-bit PNG
or PGM, TIFF, EXR), a file that holds many (TIFF, video), or one map for a camera at rest.

Depth runs along the optical axis, upright as the clip is shown. 0, negative, not finite and
the largest value of 16 bits mean that nothing was measured there. Maps belong to frames by
their order, or by the time in their names as TUM RGB-D writes them (1305031102.160407.png:
seconds), or by the times of a video's frames. Any map of one file can be asked for, from
any thread; one after the other is quick."""

import hashlib
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.numerics import divide
from arfx.core.opener import folder_entries, is_folder, read_bytes, regular
from arfx.errors import InputError
from arfx.media.clip import match_by_time, match_in_order, probe, spacing_s
from arfx.media.frames import ClipReader
from arfx.media.images import check_size, decode_picture
from arfx.media.planes import planes_of

TIFF = (".tif", ".tiff")
VIDEO = (".mkv", ".nut", ".avi", ".mov", ".mp4")
SUFFIXES = (".png", ".pgm", ".exr", *TIFF)
_KINDS = "16-bit PNG or PGM, TIFF, EXR"
_STEPS_A_METRE = (
    1000.0  # of integers, where the job does not say otherwise: millimetres
)
_ASPECT = 0.005
# of the maps' spacing: a map is of the frames nearer than half of it, and cameras are not
# on time to a tenth
_REACH = 0.55
LAMBDA = 10.0  # radius of the smoother: about its square root, px, where the picture is even
SIGMA = 6.0  # grey levels that count as an edge
_FAINT = 1e-6  # a mask smoothed to less than this carries nothing: the nearest known value is used


Read = Callable[[int], ndarray]


def _open_video(path: Path) -> tuple[Read, tuple[float, ...]]:
    """What reads a frame as a map, and the times of all after the first.

    Raises InputError: it holds no depth; when read: the frame cannot be decoded."""
    info = probe(path)
    if not re.fullmatch(r"gray1\d[lb]e", info.pixel_format):
        what = f"depth {path} holds {info.pixel_format} pictures, not depth"
        raise InputError(what, "grey of 16 bits: FFV1 gray16 in .mkv")
    with ClipReader(info, threads=1) as reader:
        times = reader.times()
        pts = [frame.pts for frame in reader.frames()] if times is None else times.pts
    kept = (
        threading.local()
    )  # last : of each thread the last map, and what is behind it

    def read(number: int) -> ndarray:
        last, stored, frames = vars(kept).get("last", (-2, None, None))
        if number == last:
            return stored
        if number != last + 1:
            frames = ClipReader(info, threads=1).frames(pts[number])
        frame = next(frames, None)
        if frame is None or frame.pts != pts[number]:
            what = f"map {number} cannot be decoded where it was listed"
            raise InputError(f"depth {path}: {what}", "the file is damaged")
        stored = planes_of(frame.picture, frame.format.layout)[0][
            :, : info.coded_width
        ]
        kept.last = number, stored, frames
        return stored

    return read, tuple(float((t - pts[0]) * info.time_base) for t in pts)


def _page(path: Path, number: int) -> ndarray:
    """(h, w[, channels]) of a TIFF as stored. Raises InputError where it cannot be read."""
    done, pages = cv2.imreadmulti(str(path), number, 1, flags=cv2.IMREAD_UNCHANGED)
    if not done or len(pages) != 1:
        what = f"depth {path}: page {number} cannot be read"
        raise InputError(what, "TIFF with 16-bit or float pages")
    return np.asarray(pages[0])


@dataclass(frozen=True)
class DepthMaps:
    """files : in order;  count : of maps;  steps_per_m : stored values to a metre, None = by kind
    (integers: millimetres, floats: metres)
    times_s : of each map after the first one, where they are known, else None;  start_s :
    of the first, after the clip's
    read : gives each map where one file holds them, else None: each file is one"""

    path: Path
    files: tuple[Path, ...]
    count: int
    steps_per_m: float | None
    start_s: float
    times_s: tuple[float, ...] | None = None
    read: Read | None = None

    @property
    def still(self) -> bool:
        """One map for every frame."""
        return self.count == 1

    def name(self, number: int) -> str:
        """What messages call a map."""
        return f"{self.path}, map {number}" if self.read else str(self.files[number])

    def of_frames(
        self, times_s: list[float], before: int, whole: bool
    ) -> list[int | None]:
        """Number of each frame's map, None where none was taken near its time.
        times_s : after the clip's first frame;  before, whole : as of `in_order`, which
        raises InputError
        """
        if self.still:
            return [0] * len(times_s)
        if self.times_s is not None:
            taken_s = np.array(self.times_s) + self.start_s
            found = match_by_time(taken_s, times_s, _REACH * spacing_s(self.times_s))
            return [None if m is None else m.nearest for m in found]
        what = f"depth {self.path} holds {self.count} maps"
        hint = (
            "one map for each frame, or times in their names (1305031102.160407.png), or a"
            " single map"
        )
        return match_in_order(what, self.count, len(times_s), before, whole, hint)

    def load(self, number: int, width: int, height: int) -> ndarray:
        """(h, w) float32 metres of a map at its own size; nothing measured = 0.
        width, height : of the clip. Raises InputError: unreadable, of another kind or shape.
        """
        if self.read:
            raw = self.read(number)
        else:
            raw = decode_picture(
                self.files[number], "depth map", cv2.IMREAD_UNCHANGED
            )
        if raw.ndim != 2 or raw.dtype not in (np.uint16, np.float32):
            channels = 1 if raw.ndim == 2 else raw.shape[2]
            kind = f"{raw.dtype} with {channels} channel{'s' if raw.ndim > 2 else ''}"
            raise InputError(
                f"depth map {self.name(number)} holds {kind}, not depth",
                "one channel of 16 bits: a PNG or PGM as RGB-D cameras give",
            )
        h, w = raw.shape
        if abs(w * height / (h * width) - 1) > _ASPECT:
            shapes = f"is {w}x{h}, the clip {width}x{height}: another shape"
            raise InputError(
                f"depth map {self.name(number)} {shapes}",
                "maps as the clip is shown, of its size or the same aspect ratio",
            )
        most, usual = np.inf, 1.0
        if raw.dtype == np.uint16:
            most, usual = 0xFFFF, _STEPS_A_METRE
        with np.errstate(all="ignore"):
            metres = raw.astype(np.float32) / np.float32(self.steps_per_m or usual)
            good = np.isfinite(metres) & (metres > 0) & (raw < most)
        return np.where(good, metres, np.float32(0))

    def digest(self, number: int) -> str:
        """Of a map's file, or of its values."""
        if self.read:
            data = self.read(number).tobytes()
        else:
            data = read_bytes(self.files[number], "depth map")
        return hashlib.blake2b(data, digest_size=8).hexdigest()


def open_depth(
    path: Path, steps_per_m: float | None = None, start_s: float = 0.0
) -> DepthMaps:
    """List a folder's maps, or take one file.

    Raises InputError: missing, empty, kinds mixed, times twice.
    """
    if not is_folder(path, "depth"):
        suffix = path.suffix.lower()
        if suffix in TIFF:
            check_size(regular(path, "depth"), path, "depth map")
            count = cv2.imcount(str(path), cv2.IMREAD_UNCHANGED)
            if count < 1:
                hint = "16-bit or float pages"
                raise InputError(f"depth {path} cannot be read as a TIFF", hint)
            page = partial(_page, path)
            return DepthMaps(path, (path,), count, steps_per_m, start_s, None, page)
        if suffix in VIDEO:
            read, times_s = _open_video(path)
            count = len(times_s)
            return DepthMaps(
                path, (path,), count, steps_per_m, start_s, times_s, read
            )
        if suffix not in SUFFIXES:
            hint = f"{_KINDS}; a folder of them; or a video of 16-bit grey (FFV1)"
            raise InputError(f"depth {path} is not a depth map", hint)
        return DepthMaps(path, (path,), 1, steps_per_m, start_s)
    found = sorted(
        (
            p
            for p in folder_entries(path, "depth folder")
            if p.suffix.lower() in SUFFIXES
        ),
        key=lambda p: (  # 2 before 10
            [int(x) if x.isdecimal() else x for x in re.split(r"(\d+)", p.stem)],
            p.name,
        ),
    )
    if not found:
        raise InputError(f"depth folder {path} holds no depth map", _KINDS)
    for p in found:
        regular(p, "depth map")  # a pipe would be waited for
    kinds = sorted({p.suffix.lower() for p in found})
    if len(kinds) > 1:
        what = f"depth folder {path} holds {' and '.join(kinds)} files"
        raise InputError(what, "maps of one kind only")
    since_s = None
    # seconds in names have a fraction: 12.png is the twelfth map, not the twelfth second
    if len(found) > 1 and all(re.fullmatch(r"\d+\.\d+", p.stem) for p in found):
        found.sort(key=lambda p: float(p.stem))
        times = np.array([float(p.stem) for p in found])
        if (np.diff(times) <= 0).any():
            what = f"depth folder {path}: two maps have the same time in their names"
            raise InputError(what)
        since_s = tuple((times - times[0]).tolist())
    return DepthMaps(path, tuple(found), len(found), steps_per_m, start_s, since_s)


def fill_holes(depth_m: ndarray, guide: ndarray) -> ndarray:
    """(H, W) float32 metres at the guide's size, > 0 everywhere: holes are filled along the
    picture's edges.

    depth_m : (h, w) metres, 0 = unknown, at least one known;  guide : (H, W) uint8, the picture

    What is known at a hole's rim spreads into it through what looks alike: the smoothed
    product of the rim's values and its mask, over the smoothed mask, both by the weighted
    least squares that follow the picture's edges (fast global smoother). Measured pixels
    keep their value. A short radius keeps a surface's slope: 20 px holes put into real maps
    are filled to .1 to .9 % (median), as nearest values would. In dioptres, so that a far
    wall weighs no more than a near table.
    Source: Min et al. 2014 (the smoother); the quotient as in normalised convolution
    (Knutsson and Westin 1993).
    """
    h, w = guide.shape
    if depth_m.shape != guide.shape:
        depth_m = cv2.resize(depth_m, (w, h), interpolation=cv2.INTER_NEAREST)
    known = depth_m > 0
    if known.all():
        return np.ascontiguousarray(depth_m, np.float32)
    unknown = (~known).astype(np.uint8)
    rim = cv2.dilate(unknown, np.ones((3, 3), np.uint8)) > 0
    mask = (known & rim).astype(np.float32)
    dioptre = divide(1.0, depth_m).astype(np.float32)
    smooth = cv2.ximgproc.createFastGlobalSmootherFilter(
        np.ascontiguousarray(guide), LAMBDA, SIGMA
    )
    total, value = smooth.filter(mask), smooth.filter(dioptre * mask)
    _, label = cv2.distanceTransformWithLabels(
        unknown, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(label.max()) + 1, np.float32)
    of_label[label[known]] = dioptre[known]  # of the nearest known pixel
    least, most = dioptre[known].min(), dioptre[known].max()
    spread = np.clip(divide(value, total), least, most)
    taken = divide(1.0, np.where(total > _FAINT, spread, of_label[label])).astype(
        np.float32
    )
    return np.where(known, depth_m, taken)
