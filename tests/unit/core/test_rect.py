from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from arfx.core.rect import EMPTY, Rect

small = st.integers(-50, 50)
rects = st.builds(
    lambda x, y, w, h: Rect(x, y, x + w, y + h),
    small,
    small,
    st.integers(0, 40),
    st.integers(0, 40),
)


def pixels(r: Rect) -> set[tuple[int, int]]:
    return {(x, y) for x in range(r.x0, r.x1) for y in range(r.y0, r.y1)}


@given(rects, rects)
def test_clip_is_the_intersection_and_union_holds_both(a: Rect, b: Rect) -> None:
    assert pixels(a.clip(b)) == pixels(a) & pixels(b)
    assert a.union(b).contains(a) and a.union(b).contains(b)
    assert (a.union(EMPTY) == a and a.union(b) == b.union(a)) or a.empty or b.empty


@given(rects, st.integers(1, 8), st.integers(1, 8))
def test_align_grows_to_the_grid_and_no_further(r: Rect, sx: int, sy: int) -> None:
    g = r.align(sx, sy)
    assert g.contains(r)
    if not r.empty:
        assert g.x0 % sx == g.x1 % sx == g.y0 % sy == g.y1 % sy == 0
        assert (
            r.x0 - g.x0 < sx
            and g.x1 - r.x1 < sx
            and r.y0 - g.y0 < sy
            and g.y1 - r.y1 < sy
        )


@given(rects, rects)
def test_slices_in_cuts_the_same_pixels(a: Rect, b: Rect) -> None:
    outer = a.union(b)
    if a.empty or outer.empty:
        return
    yy, xx = np.mgrid[outer.y0 : outer.y1, outer.x0 : outer.x1]
    part = a.slices_in(outer)
    assert {
        (int(x), int(y))
        for x, y in zip(xx[part].ravel(), yy[part].ravel(), strict=True)
    } == pixels(a)


def test_around_holds_pixel_centres_and_ignores_what_is_not_finite() -> None:
    r = Rect.around(np.array([[1.4, 2.6], [5.0, 7.0], [np.nan, 3], [np.inf, 0]]))
    assert r == Rect(1, 3, 6, 8)
    assert Rect.around(np.full((3, 2), np.nan)) == EMPTY
    assert Rect.around(np.array([[1e300, -1e300]])).area == 1
