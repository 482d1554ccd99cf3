"""Lines, toon shading and pigment: the printed numbers, what was corrected, and how much
still flickers.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from arfx.core.layers import packed
from arfx.core.light import DirectionalLight, Light
from arfx.core.rect import Rect
from arfx.papers.s3_watercolor import eq4_edges
from arfx.stages.watercolor.labels import STILL, Wobble
from arfx.stages.watercolor.lines import (
    add_object_edges,
    measure_edges,
    object_edges,
    trace_lines,
    yuv_matrix,
)
from arfx.stages.watercolor.pigment import paper_grain, wobble_tile
from arfx.stages.watercolor.sites import STEPS, still_field
from arfx.stages.watercolor.toon import RAMP, tones, toon_light
from arfx.stages.watercolor.wobble import Wobbles, field_shift, object_shift
from tests.reference.labels import displacement
from tests.scenes import camera, facts, scene


def line_strength(
    image: np.ndarray, low: float, high: float, width_px: float, smooth_px: float,
    of_object: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    edges = measure_edges(packed(image.astype(np.float32)), smooth_px)
    if of_object is not None:
        add_object_edges(edges, of_object, 0, 0, high)
    return trace_lines(edges, low, high, width_px)


def test_yuv_is_the_analogue_one_of_bt601_and_bt709_is_another() -> None:
    np.testing.assert_allclose(yuv_matrix()[0], [0.299, 0.587, 0.114])
    np.testing.assert_allclose(yuv_matrix() @ [1, 1, 1], [1, 0, 0], atol=1e-12)
    assert yuv_matrix("bt709")[0, 1] == pytest.approx(0.7152)


def step_picture(contrast: float, width: int = 80) -> np.ndarray:
    """A coded step of `contrast` around the middle, upright."""
    coded = np.full((40, width, 3), 0.5, np.float32)
    coded[:, width // 2 :] += contrast
    return coded**2


def test_a_line_is_as_wide_as_asked_and_faint_steps_have_none() -> None:
    widths = []
    for asked in (2.0, 4.0):
        line = line_strength(step_picture(0.4), 0.02, 0.06, asked, 2.0)
        up = cv2.resize(line, (80, 40), interpolation=cv2.INTER_LINEAR)
        widths.append(float(up[20].sum()))
        assert (
            up[20].max() > 0.75
            and abs(float((up[20] * np.arange(80)).sum() / up[20].sum()) - 39.5) < 1
        )
    assert (
        1.5 < widths[0] < 3.5 and 3 < widths[1] < 5
    )  # the picture of half the size cannot draw finer
    assert line_strength(step_picture(0.01), 0.02, 0.06, 2, 2).max() == 0


def test_a_weak_line_lives_where_it_joins_a_strong_one() -> None:
    """Hysteresis: contrast fades along the edge; alone, the weak part would be fainter."""
    coded = np.full((80, 80, 3), 0.4, np.float32)
    coded[:, 40:] += np.linspace(0.4, 0.07, 80, dtype=np.float32)[:, None, None]
    joined = line_strength(coded**2, 0.01, 0.1, 2, 2)
    alone = line_strength(coded[50:] ** 2, 0.01, 0.1, 2, 2)
    assert joined[30:38].max(1).mean() > 1.5 * alone[5:13].max(1).mean() > 0


def flips(strengths: list[np.ndarray]) -> float:
    """Share of line pixels (over a half in either frame) that change by more than a half
    from frame to frame.
    """
    changed = lines = 0
    for a, b in itertools.pairwise(strengths):
        changed += int((np.abs(a - b) > 0.5).sum())
        lines += int((np.maximum(a, b) > 0.5).sum())
    return changed / max(lines, 1)


def test_lines_hold_still_in_noise_where_printed_edges_flip() -> None:
    """Noise of 2/255 on steps of every contrast: the printed threshold flips, ours at most
    in 2 % of its pixels.
    """
    g = np.random.default_rng(0)
    base = np.full((120, 160, 3), 0.45)
    for k, contrast in enumerate(np.linspace(0.03, 0.3, 10)):
        base[:, 16 * k + 8 :] += contrast * (1 if k % 2 else -1)
    base = cv2.GaussianBlur(np.clip(base, 0.02, 0.98), (0, 0), 0.8)
    frames = [
        np.clip(base + g.normal(0, 2 / 255, base.shape), 0, 1).astype(np.float32)
        for _ in range(6)
    ]
    ours = flips([line_strength(f**2, 0.02, 0.06, 2, 2) for f in frames])
    printed = flips([(eq4_edges(f, 0.5, 0.5) > 0.04).astype(float) for f in frames])
    assert ours <= 0.02 < 0.1 < printed


def test_an_object_of_the_colour_of_its_background_keeps_its_outline_and_creases() -> (
    None
):
    grey = np.full((60, 60, 3), 0.3, np.float32)
    coverage = np.zeros((60, 60), np.float32)
    coverage[16:44, 16:44] = 1
    normal = np.zeros((60, 60, 3), np.float32)
    normal[16:44, 16:30], normal[16:44, 30:44] = (1, 0, 0), (0, 0, 1)
    depth = np.where(coverage > 0, 1.0, np.inf).astype(np.float32)
    line = lambda c, n, d: line_strength(  # noqa: E731
        grey, 0.02, 0.06, 2, 2, object_edges(c, n, d, 1.0)
    )
    whole = line(coverage, normal, depth)
    assert (
        whole[15, 7:9].max() > 0.7
        and whole[15, 14:16].max() > 0.5
        and whole[15, 3] == 0
    )
    normal[..., :] = (0, 0, 1)
    smooth = line(coverage, normal, depth)
    assert smooth[15, 12:18].max() == 0 and smooth[15, 7:9].max() > 0.7
    depth[16:44, 30:44] = 1.2
    assert line(coverage, normal, depth)[15, 14:16].max() > 0.5
    assert np.isfinite(line(coverage, normal, np.full_like(depth, np.nan))).all()
    assert line_strength(grey, 0.02, 0.06, 2, 2).max() == 0


def test_toon_has_three_tones_of_the_printed_factors() -> None:
    c = np.cos(np.linspace(0, np.pi, 2001))
    hard, soft = (
        0.5 * tones(c, (0.5, 0.2), (1, 0.4, 0.1), ramp) for ramp in (0.0, RAMP)
    )
    np.testing.assert_allclose(hard[c > 0.5 + 1e-5], 0.5, rtol=1e-5)
    np.testing.assert_allclose(
        hard[(c > 0.2 + 1e-5) & (c < 0.5 - 1e-5)], 0.2, rtol=1e-5
    )
    np.testing.assert_allclose(hard[c < 0.2 - 1e-5], 0.05, rtol=1e-4)
    assert len(np.unique(hard.round(5))) == 3
    assert (
        np.abs(np.diff(soft)).max() < 0.02
        and np.abs(soft - hard)[np.abs(c - 0.5) > 0.04].max() < 0.16
    )


def test_toon_light_is_the_strongest_of_the_clip() -> None:
    up = np.array([0.0, 0, 1])
    lights = (
        DirectionalLight((1, 0, 0), (0.2, 0.2, 0.2)),
        DirectionalLight((0, 1, 0), (0.5, 0.4, 0.3)),
    )
    direction, radiance = toon_light(Light((0.1, 0.1, 0.1), lights), up)
    np.testing.assert_allclose(direction, [0, 1, 0])
    np.testing.assert_allclose(radiance, [0.6, 0.5, 0.4])
    assert np.array_equal(toon_light(Light((0.3, 0.3, 0.3), ()), up)[0], up)


def test_paper_and_wobble_repeat_without_a_seam_and_keep_to_their_bounds() -> None:
    for tile in (paper_grain(1), wobble_tile(1, 1.5)[0] / 8):
        inner = np.abs(np.diff(tile.astype(float), axis=1)).mean()
        assert np.abs(tile[:, 0].astype(float) - tile[:, -1]).mean() < 1.3 * inner
        assert np.abs(tile).max() <= 1.5


def test_borders_stray_with_the_things_between_pixels_too() -> None:
    """What a place is displaced by differs from what the thing there was displaced by
    before by less than a twelfth of a pixel; moved by whole pixels, by up to a seventh."""
    wobbles, nodes = Wobbles(1, 1.5), still_field(200, 160, 8, 32)

    def seen(wobble: Wobble) -> np.ndarray:
        return displacement(wobble, Rect.of(200, 160)) / STEPS

    first = seen(wobbles.at(*field_shift(nodes)))
    rows, columns = np.indices((160, 200)).astype(np.float32)
    for x, y in ((0.4, 0.0), (3.6, -1.3), (-0.5, 2.0)):
        shift = field_shift(replace(nodes, u=nodes.u + x, v=nodes.v + y))
        now = seen(wobbles.at(*shift))
        for was, shown in zip(first, now, strict=True):
            true = cv2.remap(was, columns + x, rows + y, cv2.INTER_CUBIC)[8:-8, 8:-8]
            assert np.sqrt(np.mean((shown[8:-8, 8:-8] - true) ** 2)) < 1 / 12
    cam, pose = camera(200, 160), facts(scene(camera(200, 160))).camera_from_world
    assert pose is not None
    near = replace(pose, translation_m=pose.translation_m + np.array([0.05, 0, 0]))
    (x, y), (x2, y2) = (cam.project(p.translation_m[None])[0] for p in (pose, near))
    one, other = (
        wobbles.at(*object_shift(cam, p, np.zeros(3))) for p in (pose, near)
    )
    assert (
        abs(other.x - one.x - (x - x2)) < 1.3
        and abs(other.y - one.y - (y - y2)) < 1.3
        and abs(x - x2) > 5
    )
    behind = replace(pose, translation_m=-pose.translation_m)
    assert (
        wobbles.at(*object_shift(cam, behind, np.zeros(3))).x,
        Wobbles(1, 0.0).at(5.5, 1),
    ) == (
        0,
        STILL,
    )
