"""Linear light of a rectangle and edits of stored samples, for every kind of plane."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arfx.core.colour import SRGB, Transfer, yuv_from_rgb
from arfx.core.rect import Rect
from arfx.errors import RenderError
from arfx.media.frame import Frame
from arfx.media.planes import (
    FrameFormat,
    Orientation,
    layout_named,
    orientation_of,
    planes_of,
    working_layout,
)

FORMATS = [
    "yuv420p",
    "yuvj420p",
    "yuv422p",
    "yuv444p",
    "yuv411p",
    "yuv420p10le",
    "yuv444p12le",
    "gray",
    "gray10le",
    "gbrp",
    "gbrp10le",
]
STEP_SHARE = (
    1 / 32
)  # of a step of the samples: the most by which a table's entry is off
TURNS = [
    Orientation(t, x, y)
    for t in (False, True)
    for x in (False, True)
    for y in (False, True)
]


def frame(
    name: str, width: int = 37, height: int = 29, seed: int = 0, *, full: bool = False, location: str = "left",
    turn: Orientation | None = None, transfer: Transfer = SRGB, smooth: bool = False,
) -> Frame:  # fmt: skip
    """Random legal samples, or smooth ones."""
    layout = layout_named(name)
    assert layout is not None
    full = full or name.startswith("yuvj") or layout.kind == "rgb"
    form = FrameFormat(
        layout, width, height, Fraction(1, 30), "bt709", full, transfer, location, turn or Orientation()
    )  # fmt: skip
    picture = av.VideoFrame(width, height, name)
    rng = np.random.default_rng(seed)
    (_, _, low, high), (_, _, c_low, c_high) = form.stored
    for k, p in enumerate(planes_of(picture, layout)):
        lo, hi = (c_low, c_high) if k and layout.kind == "yuv" else (low, high)
        if smooth:
            y, x = np.mgrid[: p.shape[0], : p.shape[1]]
            p[:] = (lo + hi) / 2 + (hi - lo) * 0.1 * np.sin(x / (11 + k) + y / 9)
        else:
            p[:] = rng.integers(lo, hi + 1, p.shape)
    return Frame(picture, form, 5, 7)


def samples(f: Frame) -> list[np.ndarray]:
    return [p.copy() for p in planes_of(f.picture, f.format.layout)]


def reference_linear(f: Frame) -> np.ndarray:
    """The coded picture by the textbook, in float64, with np.interp between chroma positions."""
    lay, form = f.format.layout, f.format
    p = [a.astype(float) for a in planes_of(f.picture, lay)]
    luma, chroma = form.stored
    y = (p[0][: form.height, : form.width] - luma[0]) / luma[1]
    out = [y]
    for c in p[1:3]:
        cw, ch = -(-form.width >> lay.sub_x), -(-form.height >> lay.sub_y)
        c = (c[:ch, :cw] - chroma[0]) / chroma[1]
        for axis, (n, sub, cosited) in enumerate(
            [
                (form.height, lay.sub_y, form.cosited[1]),
                (form.width, lay.sub_x, form.cosited[0]),
            ]
        ):
            at = (
                np.arange(n) / (1 << sub)
                if cosited
                else (np.arange(n) + 0.5) / (1 << sub) - 0.5
            )
            c = np.apply_along_axis(
                lambda v, at=at: np.interp(at, np.arange(len(v)), v), axis, c
            )
        out.append(c)
    rgb = np.stack(out, -1) @ np.linalg.inv(yuv_from_rgb(form.matrix)).T
    return form.transfer.decode(rgb)


@pytest.mark.parametrize("location", ["left", "center", "topleft"])
@pytest.mark.parametrize("name", [n for n in FORMATS if n.startswith("yuv")])
def test_linear_light_is_the_textbooks(name: str, location: str) -> None:
    f = frame(name, location=location)
    encode, steps = f.format.transfer.encode, f.format.layout.peak
    coded = [encode(x.astype(float)) for x in (f.linear(f.rect), reference_linear(f))]
    assert np.abs(coded[0] - coded[1]).max() < STEP_SHARE / steps + 1e-6


@pytest.mark.parametrize(
    "transfer", ["srgb", "bt709", "bt1886", "gamma:2.2", "hlg", "pq"]
)
def test_light_follows_the_transfer(transfer: str) -> None:
    f = frame("yuv444p10le", transfer=Transfer(transfer))
    linear, textbook = f.linear(f.rect), reference_linear(f)
    encode = f.format.transfer.encode
    assert (
        np.abs(encode(linear.astype(float)) - encode(textbook)).max()
        < STEP_SHARE / 876
    )


@pytest.mark.parametrize("name", ["gbrp", "gbrp10le", "gray", "gray10le"])
@pytest.mark.parametrize("transfer", ["srgb", "bt1886", "hlg", "pq"])
def test_every_value_is_written_as_the_nearest_step(name: str, transfer: str) -> None:
    """From black to white, through all steps: what is written is read as what was wanted."""
    f = frame(name, 64, 16, transfer=Transfer(transfer))
    wanted = np.linspace(0, 1, 1024, dtype=np.float32).reshape(16, 64, 1).repeat(3, 2)
    linear = f.format.transfer.decode(wanted)
    got = f.format.transfer.encode(
        f.edited(f.rect, f.linear(f.rect), linear).linear(f.rect)
    )
    steps = f.format.layout.peak * (1 if f.format.full_range else 219 / 255)
    assert np.abs(got - wanted)[:, 2:].max() < 0.6 / steps


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(FORMATS), st.sampled_from(TURNS), st.data())
def test_rectangles_agree_and_edits_stay_inside(
    name: str, turn: Orientation, data: st.DataObject
) -> None:
    f = frame(
        name, turn=turn, location=data.draw(st.sampled_from(["left", "center"]))
    )
    whole = f.rect
    x0, y0 = (
        data.draw(st.integers(0, whole.x1 - 1)),
        data.draw(st.integers(0, whole.y1 - 1)),
    )
    r = Rect(
        x0,
        y0,
        data.draw(st.integers(x0 + 1, whole.x1)),
        data.draw(st.integers(y0 + 1, whole.y1)),
    )
    all_linear = f.linear(whole)
    before = f.linear(r)
    assert np.array_equal(before, all_linear[r.slices])
    old = samples(f)
    after = np.random.default_rng(1).random(before.shape).astype(np.float32)
    g = f.edited(r, before, after)
    assert all(
        np.array_equal(a, b) for a, b in zip(samples(f), old, strict=True)
    )  # the frame itself never changes
    lay = f.format.layout
    coded = turn.coded_rect(r, whole.width, whole.height)
    for k, (a, b) in enumerate(zip(old, samples(g), strict=True)):
        sx, sy = (lay.sub_x, lay.sub_y) if k else (0, 0)
        inside = np.zeros(a.shape, bool)
        inside[
            coded.y0 >> sy : -(-coded.y1 >> sy), coded.x0 >> sx : -(-coded.x1 >> sx)
        ] = True
        w = f.format.width if not k or lay.kind != "yuv" else -(-f.format.width >> sx)
        h = a.shape[0]
        assert np.array_equal(a[:h, :w][~inside[:h, :w]], b[:h, :w][~inside[:h, :w]])
    same = f.edited(r, before, before.copy())
    assert all(
        np.array_equal(a[:, :16], b[:, :16])
        for a, b in zip(old, samples(same), strict=True)
    )


@pytest.mark.parametrize("name", ["yuv444p", "gbrp", "yuv444p12le", "gbrp10le"])
def test_an_edit_arrives_to_half_a_step(name: str) -> None:
    f = frame(name, smooth=True)
    r = Rect(4, 3, 30, 22)
    target = SRGB.decode(
        np.random.default_rng(2).uniform(0.2, 0.8, (r.height, r.width, 3))
    ).astype(np.float32)
    got = f.edited(r, f.linear(r), target).linear(r)
    steps = f.format.layout.peak * (1 if f.format.full_range else 219 / 255)
    assert (
        np.abs(SRGB.encode(got) - SRGB.encode(target)).max() < 1.9 / steps
    )  # rounding of Y, Cb and Cr together


@pytest.mark.parametrize("location", ["left", "center", "topleft"])
def test_a_smooth_edit_keeps_colour_with_subsampled_chroma(location: str) -> None:
    """A flat tint over the whole picture: chroma must not shift, darken at the borders, or leak."""
    f = frame("yuv420p", smooth=True, location=location)
    target = np.broadcast_to(
        SRGB.decode(np.array([0.7, 0.4, 0.3])), (*f.linear(f.rect).shape[:2], 3)
    ).astype(np.float32)
    got = SRGB.encode(f.edited(f.rect, f.linear(f.rect), target).linear(f.rect))
    assert np.abs(got - SRGB.encode(target)).max() < 0.02


def test_a_shadow_keeps_super_white_and_clips_new_light() -> None:
    f = frame("yuv420p", smooth=True)
    planes_of(f.picture, f.format.layout)[0][:8] = (
        250  # beyond legal white, as cameras store it
    )
    r = Rect(0, 0, 16, 8)
    b = f.linear(r)
    assert samples(f.edited(r, b, b * np.float32(0.99)))[0][:8, :16].max() > 240
    assert samples(f.edited(r, b, b * np.float32(9)))[0][:8, :16].max() == 250
    low = Rect(0, 16, 16, 24)
    bright = f.edited(low, f.linear(low), np.full((8, 16, 3), 50, np.float32))
    assert samples(bright)[0][16:24, :16].max() == 235


def test_bad_edits_are_errors() -> None:
    for name in ("yuv420p", "gbrp"):
        f = frame(name)
        r = Rect(2, 2, 10, 10)
        b = f.linear(r)
        a = b.copy()
        a[3, 3, 1] = np.nan
        with pytest.raises(RenderError, match="1 edited pixels"):
            f.edited(r, b, a)
        with pytest.raises(RenderError, match="not inside"):
            f.linear(Rect(0, 0, 38, 4))
        with pytest.raises(RenderError, match="given"):
            f.edited(r, b, a[1:])


@pytest.mark.parametrize("turn", TURNS)
def test_orientations_are_their_own_inverse(turn: Orientation) -> None:
    a = np.arange(5 * 7).reshape(5, 7)
    up = turn.upright(a)
    assert np.array_equal(turn.coded(up), a)
    r = Rect(1, 2, 4, 4)
    coded = turn.coded_rect(r, up.shape[1], up.shape[0])
    assert np.array_equal(turn.upright(a[coded.slices]), up[r.slices])


def test_display_matrices() -> None:
    one = 65536
    assert orientation_of(None) == (Orientation(), True)
    assert (
        orientation_of((0, one, 0, -one, 0, 0, 0, 0, 1 << 30))[0].rotation_deg == 270
    )
    assert (
        orientation_of((0, -one, 0, one, 0, 0, 0, 0, 1 << 30))[0].rotation_deg == 90
    )
    assert (
        orientation_of((-one, 0, 0, 0, -one, 0, 0, 0, 1 << 30))[0].rotation_deg == 180
    )
    assert orientation_of((-one, 0, 0, 0, one, 0, 0, 0, 1 << 30))[0] == Orientation(
        flip_x=True
    )
    assert (
        orientation_of((46341, 46341, 0, -46341, 46341, 0, 0, 0, 1 << 30))[1] is False
    )


@pytest.mark.parametrize(
    ("name", "working"),
    [("nv12", "yuv420p"), ("yuyv422", "yuv422p"), ("p010le", "yuv420p10le"), ("rgb24", "gbrp"), ("bgra", "gbrp"),
     ("pal8", "gbrp"), ("rgb48le", "gbrp16le"),
     ("nv16", "yuv422p"), ("nv24", "yuv444p"), ("ya8", "gray"), ("uyvy422", "yuv422p")],
)  # fmt: skip
def test_unusual_formats_get_a_working_one_with_a_notice(
    name: str, working: str
) -> None:
    layout, notice = working_layout(name)
    assert layout.name == working and name in notice
    assert working_layout(working) == (layout, "")
