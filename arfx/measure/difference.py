"""How far a picture is from its reference, in units that an eye knows, over the pixels that
an effect touches.

FLIP: how visible a difference is to someone who flips between two pictures, 0 (none) to 1;
Andersson et al. 2020 (LDR form).
Delta E: CIEDE2000, 1 is about the least that is seen. SSIM: structural similarity of luma,
1 where both agree; Wang et al. 2004.
Cost: FLIP about 1.5 us of one core per pixel, SSIM and Delta E together as much; of the
touched pixels' box alone.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.rect import Rect

TOUCHED = 0.5  # grey levels: less than this is not a change
# a 0.7 m wide display of 3840 pixels seen from 0.7 m, FLIP's published standard
PIXELS_PER_DEGREE = 67.02
# Widest of FLIP's filters at that distance: contrast sensitivity of blue-yellow, 3 sqrt(b /
# 2 pi^2) ppd = 9.05 px, rounded up.
MARGIN_PX = 10


@dataclass(frozen=True)
class Difference:
    """mean, p99 : grey levels, of the largest channel of each pixel;  flip, delta_e, ssim : means
    worst_px : (x, y) in the picture;  pixels : how many it was taken over"""

    mean: float = 0.0
    p99: float = 0.0
    flip: float = 0.0
    delta_e: float = 0.0
    ssim: float = 1.0
    worst_px: tuple[int, int] = (0, 0)
    pixels: int = 0


def level_difference(a: ndarray, b: ndarray) -> ndarray:
    """(h, w) grey levels between two (h, w, 3) uint8 pictures: the largest of the channels."""
    return np.asarray(cv2.absdiff(a, b).max(-1), np.float32)


def touched(*pairs: tuple[ndarray, ndarray]) -> ndarray:
    """(h, w) bool: pixels in which any of the pairs differs."""
    return np.asarray(
        np.any([level_difference(a, b) > TOUCHED for a, b in pairs], axis=0)
    )


def difference(reference: ndarray, test: ndarray, where: ndarray) -> Difference:
    """Of two (h, w, 3) uint8 sRGB pictures.

    where : (h, w) bool, those that count; without any there is no difference
    """
    if not where.any():
        return Difference()
    x, y, width, height = cv2.boundingRect(where.astype(np.uint8))
    box = Rect(x, y, x + width, y + height)
    seen = box.pad(MARGIN_PX).clip(Rect.of(where.shape[1], where.shape[0]))
    a, b, inside = reference[seen.slices], test[seen.slices], where[seen.slices]
    apart = level_difference(a, b)
    values = apart[inside]
    if not values.any():
        return Difference(pixels=len(values))
    worst = int(np.argmax(np.where(inside, apart, -1)))
    worst_y, worst_x = divmod(worst, apart.shape[1])
    return Difference(
        float(values.mean()),
        float(np.percentile(values, 99)),
        float(flip_map(a, b)[inside].mean()),
        float(delta_e(a[inside], b[inside]).mean()),
        float(ssim_map(a, b)[inside].mean()),
        (worst_x + seen.x0, worst_y + seen.y0),
        len(values),
    )


def flip_map(reference: ndarray, test: ndarray) -> ndarray:
    """(h, w) float32, FLIP of every pixel of two (h, w, 3) uint8 sRGB pictures."""
    from flip_evaluator import nbflip

    a, b = (
        np.ascontiguousarray(p.astype(np.float32) / np.float32(255))
        for p in (reference, test)
    )
    error = nbflip.evaluate(
        a, b, False, True, False, False, {"ppd": PIXELS_PER_DEGREE}
    )[0]
    return np.ascontiguousarray(error[..., 0], np.float32)


def delta_e(reference: ndarray, test: ndarray) -> ndarray:
    """(...) CIEDE2000 between sRGB colours (..., 3) uint8."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    return np.asarray(deltaE_ciede2000(rgb2lab(reference), rgb2lab(test)))


def ssim_map(reference: ndarray, test: ndarray) -> ndarray:
    """(h, w) SSIM about every pixel of two (h, w, 3) uint8 pictures; beyond their border
    they go on as their last pixels.
    """
    from skimage.metrics import structural_similarity

    half = 5  # of its window, a Gaussian of 1.5 px
    grey = [
        np.pad(
            cv2.cvtColor(np.ascontiguousarray(p), cv2.COLOR_RGB2GRAY),
            half,
            mode="edge",
        )
        for p in (reference, test)
    ]
    found = structural_similarity(
        *grey,
        full=True,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )[1]
    return np.asarray(found[half:-half, half:-half])


def mean_flicker(
    first: ndarray,
    second: ndarray,
    plate_first: ndarray,
    plate_second: ndarray,
    where: ndarray,
) -> float:
    """Mean grey levels by which the second picture, taken back along the footage's motion,
    differs from the first.

    The motion is that of the plates (DIS optical flow, OpenCV). All (h, w, 3) uint8 of one
    place. A steady effect changes no more than its reference does; 0 for an empty
    `where`."""
    if not where.any() or min(where.shape) < 16:
        return 0.0
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    a, b = (cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in (plate_first, plate_second))
    motion = np.asarray(flow.calc(a, b, None))  # type: ignore[call-overload]
    y, x = np.indices(a.shape, np.float32)
    back = cv2.remap(
        second,
        x + motion[..., 0],
        y + motion[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return float(level_difference(first, back)[where].mean())
