"""How plainly a decoded marker can be read: whether it is a print of that code, or texture
that happened to be taken for one; and what markers of all families are in a clip in which the
configured ones are not seen, for the message that says so.

OpenCV's detector corrects wrong bits and asks for no white around the print, so that codes
of few bits turn up everywhere."""

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.markers.detect import SCANNED_FAMILIES, Candidate, MarkerDetector
from arfx.core.marker import FAMILIES, smallest_family
from arfx.core.marker_codes import UNIT_SQUARE, cells_per_side, marker_cells
from arfx.core.numerics import divide

# Numbers of the frames that are searched: all of a photo, few of a long clip.
SCANS = (0, 1, 2, *(6 << k for k in range(9)))
MIN_SIDE_PX = 14.0  # smaller squares of weak dictionaries are found in any texture
SAMPLES = 4  # a side of a cell; those at its border are mixed with its neighbour
CLEAN = (
    0.95  # share of the cells around that are paper, and of the border's that are ink
)
MARGIN = 0.25  # of the bits from half way between ink and paper; 1 = as ink and paper themselves
HOLDS_FRAMES = 3  # a reading that is not sure by itself has to be in so many frames
HOLDS, SURE = (
    1e-2,
    1e-4,
)  # chance at which a reading counts, and at which one is enough


def legible(luma: ndarray, seen: Candidate) -> tuple[bool, bool]:
    """Whether this reading counts as one of several, and whether it is sure by itself: a
    quiet zone, a black border and bits that are all clear; or a code so long that chance
    does not make it."""
    from scipy.special import bdtr

    n = cells_per_side(seen.family)
    corners = SAMPLES * (1 + n * UNIT_SQUARE) - 0.5
    warp = cv2.getPerspectiveTransform(corners, seen.quad_px.astype(np.float32))
    side, flags = SAMPLES * (n + 2), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    flat = cv2.warpPerspective(
        luma, warp, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    cells = flat.reshape(n + 2, SAMPLES, n + 2, SAMPLES)[:, 1:-1, :, 1:-1].mean(
        (1, 3), dtype=float
    )
    at = np.minimum(np.arange(n + 2), np.arange(n + 2)[::-1])
    depth = np.minimum(
        at[:, None], at
    )  # 0 around the print, 1 its border, from 2 on its bits
    ink, paper = (float(np.median(cells[depth == k])) for k in (1, 0))
    paper_like = 2 * divide(cells - ink, paper - ink) - 1
    code = marker_cells(seen.family, seen.id)[1:-1, 1:-1]
    bits = paper_like[depth > 1] * np.where(code.ravel(), 1, -1)
    wrong = int((bits <= 0).sum())
    clean = (
        min((paper_like[depth == 0] > 0).mean(), (paper_like[depth == 1] < 0).mean())
        >= CLEAN
    )
    # that bits by chance are one of the family's codes with so many wrong ones, in one of
    # four turns
    codes = FAMILIES[smallest_family(seen.family, seen.id)]
    chance = 4 * codes * float(bdtr(wrong, code.size, 0.5))
    sure = bool(clean and bits.min() >= MARGIN) or chance <= SURE
    return sure or wrong == 0 or chance <= HOLDS, sure


def scan(luma: ndarray) -> list[str]:
    """Keys of the plain markers of all families in a picture (h, w) uint8, of nested
    dictionaries by the smallest."""
    seen = MarkerDetector(SCANNED_FAMILIES, MIN_SIDE_PX).search(luma)
    plain = [c for c in seen if legible(luma, c)[1]]
    return sorted({f"{smallest_family(c.family, c.id)}:{c.id}" for c in plain})
