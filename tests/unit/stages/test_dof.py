"""Stage dof, corrected formula: against the thin-lens reference, what must not change, and
inputs at the edge.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.core.numerics import divide
from arfx.core.pixels import Pixels
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage, level_named
from arfx.errors import InputError
from arfx.stages.dof import Dof
from arfx.stages.dof.params import DofParams
from tests.contract import stage_laws as laws
from tests.scenes import look_at
from tests.unit.stages.dof_scenes import (
    Shot,
    blurred,
    compose,
    shot,
    texture,
    with_layers,
)

LEVELS = ("draft", "standard")


def flat(plate: np.ndarray, distance_m: float = 0.5) -> Shot:
    """A frontal plane of one blur radius, without an object. plate : (h, w, 3)"""
    at = shot(width=plate.shape[1], height=plate.shape[0])
    empty = np.zeros(plate.shape[:2], np.float32)
    layers = {
        "plate": plate,
        "image": plate,
        "coverage": empty,
        "virtual": np.zeros_like(plate),
        "shadow": np.ones_like(plate),
    }
    bare = with_layers(at, **layers)
    return Shot(
        at.scene,
        at.facts.with_(
            camera_from_world=look_at(distance_m, 0, 0), model_box=Rect(0, 0, 0, 0)
        ),
        bare.layers,
    )


def aperture_for(
    radius_px: float, distance_m: float = 0.5, focus_m: float = 2.0
) -> float:
    """aperture_px that gives this radius at the distance."""
    return 2 * radius_px / focus_m / abs(1 / distance_m - 1 / focus_m)


def psnr(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    """Of coded values, dB."""
    d = (SRGB.encode(np.clip(a, 0, 1)) - SRGB.encode(np.clip(b, 0, 1)))[where]
    return float(-10 * np.log10((d**2).mean()))


SCENES = {
    "near": ("plain", {"aperture_px": 12.0, "focus": "2m"}),
    "far": ("plain", {"aperture_px": 40.0, "focus": "object", "background_m": 1.5}),
    "straddling": ("plain", {"aperture_px": 60.0, "focus": "48cm"}),
    "highlights": ("highlights", {"aperture_px": 24.0, "focus": "1.2m"}),
}


@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_a_thin_lens(name: str) -> None:
    """What is left is mostly what the object's edge lets through."""
    kind, params = SCENES[name]
    at = shot(kind, 240, 180)
    truth = blurred(at, "reference", **params)
    changed = np.abs(truth - at.layers[Layer.IMAGE]).max(-1) > 1e-4
    assert changed.mean() > 0.3
    made = {level: blurred(at, level, **params) for level in LEVELS}
    error = {level: psnr(made[level], truth, changed) for level in LEVELS}
    least = 30 if name == "highlights" else 33
    assert error["draft"] > 26 and error["standard"] > least, error
    assert error["draft"] + 1 < error["standard"], error
    for level in LEVELS:
        assert made[level].sum() == pytest.approx(truth.sum(), rel=0.01)


@pytest.mark.parametrize("level", LEVELS)
def test_a_part_is_as_in_the_whole_picture(level: str) -> None:
    """Whatever its borders."""
    at, params = shot("plain", 240, 180), {"aperture_px": 40.0, "focus": "object"}
    whole = blurred(at, level, **params)
    ready = ReadyStage.of(Dof(DofParams(**params)), at.scene, level)
    for part in (
        Rect(100, 60, 160, 120),
        Rect(101, 61, 159, 119),
        Rect(0, 64, 240, 66),
        Rect(201, 140, 240, 180),
    ):
        need = (
            ready.stage.needs(part, at.facts, at.scene, level)
            .union(part)
            .clip(at.layers.rect)
        )
        made = ready.run(at.layers.crop(need), at.facts, part)[Layer.IMAGE]
        np.testing.assert_allclose(
            made.part(part), whole[part.slices], rtol=0, atol=1e-5, err_msg=str(part)
        )


def test_a_draft_keeps_what_is_sharp_and_its_outline() -> None:
    """A sharp object before a blurred wall."""
    at, params = (
        shot("plain", 240, 180),
        {"aperture_px": 8.0, "focus": "object", "background_m": 50.0},
    )
    draft, standard = (
        blurred(at, level, **params) for level in ("draft", "standard")
    )
    covered = at.layers[Layer.COVERAGE]
    inside = minimum_filter(covered, 5) >= 1
    kept = inside & (np.abs(standard - at.layers[Layer.IMAGE]).max(-1) == 0)
    kept = minimum_filter(kept, 5)
    assert kept.sum() > 20
    np.testing.assert_allclose(draft[kept], standard[kept], rtol=0, atol=1e-6)
    outline = (maximum_filter(covered, 3) > 0) & ~inside
    assert psnr(draft, standard, outline) > 36


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
def test_what_shows_through_an_object_that_fades_is_as_in_the_composite(
    level: str,
) -> None:
    """Its shadow too: the picture does not jump where the blur sets in."""
    at = shot("plain", 240, 180)
    at = compose(
        at.scene, at.facts.with_(opacity=0.5), np.full((180, 240, 3), 0.6, np.float32)
    )
    image = at.layers[Layer.IMAGE]
    out = blurred(at, level, aperture_px=8.0, focus="1m", scope="virtual")
    inside = minimum_filter(at.layers[Layer.COVERAGE], 9) >= 1
    assert inside.sum() > 100 and (out != image)[inside].mean() > 0.5
    assert np.abs(out - image)[inside].mean() < 0.005


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
@pytest.mark.parametrize("radius", [0.7, 2.3, 3.0, 7.0, 15.0, 26.0])
def test_a_highlight_becomes_a_disc_and_keeps_its_energy(
    level: str, radius: float
) -> None:
    y, x = np.indices((240, 320))
    away = np.hypot(x - 160, y - 120)
    for brightness in (1.0, 1e4):
        plate = np.zeros((240, 320, 3), np.float32)
        plate[120, 160] = brightness
        out = blurred(
            flat(plate), level, aperture_px=aperture_for(radius), focus="2m"
        )
        assert out.sum() == pytest.approx(plate.sum(), rel=0.001)
        sharp = level == "reference"
        inside = away < radius - (0.75 if sharp else 2 + 0.3 * radius)
        if level != "draft" and radius > 4 and inside.any():  # even, not a hill
            even = brightness / (np.pi * radius**2)
            least, most = (0.85, 1.15) if sharp else (0.7, 1.5)
            assert (
                least * even < out[inside].min() and out[inside].max() < most * even
            )
        near = away <= radius + 1.5 if sharp else away <= 1.5 * radius + 3
        assert out[near].sum() > (0.8 if level == "draft" else 0.98) * plate.sum()
        # float64 sums along a row leave a rounding of what was there
        rest = 1e-7 * brightness if sharp else 0.0
        assert out[away > 2.5 * radius + 16].max(initial=0.0) <= rest


def test_blades_shape_the_highlight() -> None:
    plate = np.zeros((120, 160, 3), np.float32)
    plate[60, 80] = 100.0
    made = {}
    for level in ("standard", "reference"):
        at = {
            "aperture_px": aperture_for(15.9),
            "focus": "2m",
            "blades": 5,
            "blade_turn_deg": 10.0,
        }
        made[level] = blurred(flat(plate), level, **at)[..., 0]
        corner = 15.9 * np.sqrt(2 * np.pi / (5 * np.sin(2 * np.pi / 5)))
        for k in range(
            5
        ):  # bright towards each corner, dark beyond the middle of each side
            a = np.radians(10 + 72 * k)
            assert (
                made[level][
                    round(60 + 0.75 * corner * np.sin(a)),
                    round(80 + 0.75 * corner * np.cos(a)),
                ]
                > 0.06
            )
            a += np.radians(36)
            assert (
                made[level][
                    round(60 + 1.05 * corner * np.sin(a)),
                    round(80 + 1.05 * corner * np.cos(a)),
                ]
                < 0.03
            )
    assert (
        np.abs(made["standard"] - made["reference"]).mean()
        < 0.04 * made["reference"].max()
    )


@pytest.mark.parametrize("fnumber", [1e12, 400.0, "inf"])
def test_a_closed_aperture_is_the_identity_bit_for_bit(fnumber: float | str) -> None:
    at = shot()
    stage = Dof(DofParams(fnumber=fnumber))
    demand = stage.demand(at.facts, at.scene, at.scene.camera.rect)
    assert (
        demand.rect.empty
        and demand.reason.startswith("largest blur circle 0.")
        and demand.reason.endswith("px < 1 px")
    )
    for level in LEVELS:
        np.testing.assert_array_equal(
            blurred(at, level, fnumber=fnumber), at.layers[Layer.IMAGE]
        )


@pytest.mark.parametrize("level", LEVELS)
def test_only_what_a_circle_reaches_changes(level: str) -> None:
    at = shot(fit_m=0.02, tilt_deg=60.0)  # beyond 52 cm all is in focus
    frame = at.scene.camera.rect
    params = {"aperture_px": 30.0, "focus": "52cm", "background_m": 0.52}
    demand = Dof(DofParams(**params)).demand(at.facts, at.scene, frame)  # type: ignore[arg-type]
    assert (
        not demand.rect.empty
        and demand.rect.area < 0.9 * frame.area
        and "blur circles up to" in demand.reason
    )
    out, image = blurred(at, level, **params), at.layers[Layer.IMAGE]
    outside = np.ones(image.shape[:2], bool)
    outside[demand.rect.slices] = False
    assert outside.any()
    np.testing.assert_array_equal(out[outside], image[outside])
    assert not np.array_equal(out, image)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("aperture_px", [50.0, 150.0])
def test_the_objects_blur_ends_within_what_is_called_for(
    level: str, aperture_px: float
) -> None:
    """A white box before a black plate, to 1/8 of a code."""
    at = shot("bright", tilt_deg=0.0, fit_m=0.05)
    black = np.zeros((*at.layers[Layer.COVERAGE].shape, 3), np.float32)
    image = np.repeat(at.layers[Layer.COVERAGE][..., None], 3, 2)
    at = with_layers(
        at, plate=black, image=image, virtual=image, shadow=np.ones_like(black)
    )
    params = {"aperture_px": aperture_px, "focus": "1.5m", "scope": "virtual"}
    asked = (
        Dof(DofParams(**params)).demand(at.facts, at.scene, at.scene.camera.rect).rect
    )  # type: ignore[arg-type]
    outside = np.ones(black.shape[:2], bool)
    outside[asked.slices] = False
    assert outside.sum() > 1000, "the picture goes on"
    out = blurred(at, level, **params)
    assert out[outside].max() < 4e-5 and out.sum() == pytest.approx(
        image.sum(), rel=0.06
    )


@pytest.mark.parametrize("level", [*LEVELS, "reference"])
def test_a_crop_gives_the_same_bits(level: str) -> None:
    """Also what the contract's laws ask for, here exactly and with every kind of layer."""
    at = shot(width=320, height=240)
    params = DofParams(aperture_px=8.0, focus="45cm", background_m=2.0)
    stage, le = Dof(params), level_named(Dof.levels, level)
    ready = ReadyStage.of(stage, at.scene, le)
    out = Rect(150, 130, 201, 171)
    need = stage.needs(out, at.facts, at.scene, le)
    whole = laws.run(ready, at.layers, at.facts)[Layer.IMAGE]
    part = laws.run(ready, at.layers.crop(need), at.facts)[Layer.IMAGE]
    assert need.area < at.scene.camera.rect.area
    np.testing.assert_allclose(
        part[out.slices_in(need)], whole[out.slices], rtol=0, atol=2e-6
    )


@pytest.mark.parametrize(
    "params",
    [
        {"aperture_px": 40.0, "focus": "1.2m", "scope": "virtual"},
        {"aperture_px": 40.0, "focus": "45cm", "background_m": 2.0},
    ],
    ids=["sharp around the object", "blurred all over"],
)
def test_only_the_pixels_that_are_kept_are_made_with_the_same_bits(
    params: dict,
) -> None:
    at = shot()
    stage = Dof(DofParams(**params))
    le = level_named(Dof.levels, "standard")
    out = Rect(101, 67, 230, 187)
    need = stage.needs(out, at.facts, at.scene, le).union(out)
    made = ReadyStage.of(stage, at.scene, le).run(
        at.layers.crop(need), at.facts, out
    )[Layer.IMAGE]
    assert isinstance(made, Pixels) and made.rect == out
    whole = blurred(at, "standard", **params)
    np.testing.assert_array_equal(made.part(out), whole[out.slices])
    assert np.abs(whole - at.layers[Layer.IMAGE])[out.slices].max() > 0.1


def test_a_blurred_object_before_a_sharp_plane() -> None:
    at = shot()
    out, image = (
        blurred(at, "standard", aperture_px=40.0, focus="object", scope="virtual"),
        at.layers[Layer.IMAGE],
    )
    near = blurred(at, "standard", aperture_px=6.0, focus="3m", scope="virtual")
    box = at.facts.model_box
    far_off = np.ones(image.shape[:2], bool)
    far_off[box.pad(40).clip(at.scene.camera.rect).slices] = False
    np.testing.assert_array_equal(near[far_off], image[far_off])
    np.testing.assert_array_equal(out[far_off], image[far_off])
    truth = blurred(at, "reference", aperture_px=6.0, focus="3m", scope="virtual")
    assert psnr(near, truth, ~far_off) > 35
    # inside, by more than the radius from the edge, nothing of the plane shines through
    deep = _deep(at.layers[Layer.COVERAGE], 24)
    assert deep.any()
    dark = with_layers(at, plate=np.zeros_like(image))
    np.testing.assert_allclose(
        blurred(dark, "standard", aperture_px=6.0, focus="3m", scope="virtual")[deep],
        near[deep],
        atol=1e-4,
    )


def test_a_sharp_object_before_a_blurred_plane() -> None:
    at = shot(fit_m=0.05)
    params = {"aperture_px": 60.0, "focus": "object", "background_m": 0.52}
    out, image = blurred(at, "standard", **params), at.layers[Layer.IMAGE]
    deep = _deep(at.layers[Layer.COVERAGE], 8)
    assert deep.any()
    assert np.abs(out[deep] - image[deep]).mean() < 0.02
    # nothing of the object's colour leaks into the plane: another object, the same surroundings
    other = with_layers(at, virtual=np.asarray(at.layers[Layer.VIRTUAL]) * 0.1)
    beyond = ~_deep(at.layers[Layer.COVERAGE] > 0, -10)
    assert beyond.any()
    np.testing.assert_array_equal(
        blurred(other, "standard", **params)[beyond], out[beyond]
    )


def _deep(mask: np.ndarray, by: int) -> np.ndarray:
    """Pixels at least `by` px inside the mask; of the mask grown, if negative."""
    from scipy.ndimage import binary_dilation, binary_erosion

    square = np.ones((2 * abs(by) + 1,) * 2, bool)
    full = np.asarray(mask) >= 1 if by > 0 else np.asarray(mask) > 0
    return binary_erosion(full, square) if by > 0 else binary_dilation(full, square)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0, 1e6, 1e-9])
def test_depths_that_are_none(value: float) -> None:
    at = shot()
    depth = np.array(at.layers[Layer.DEPTH])
    depth[::2, ::3] = value
    for level in LEVELS:
        out = blurred(
            with_layers(at, depth=depth), level, aperture_px=15.0, focus="48cm"
        )
        assert np.isfinite(out).all() and out.min() >= -1e-5 and out.max() <= 1.0


@pytest.mark.parametrize(("width", "height"), [(161, 119), (97, 211)])
def test_a_bounded_blur_and_odd_sizes(width: int, height: int) -> None:
    at = shot(width=width, height=height)
    for level in LEVELS:
        out = blurred(at, level, aperture_px=3000.0, focus="3m")
        assert np.isfinite(out).all() and out.min() >= 0 and out.max() <= 1


@pytest.mark.parametrize("level", LEVELS)
def test_a_part_narrower_than_a_cell(level: str) -> None:
    """Two columns at the end of a row of cells: light of the rest is missing, evenly."""
    plate = np.full((120, 160, 3), 0.3, np.float32)
    at = flat(plate)
    stage = Dof(DofParams(aperture_px=aperture_for(15.0), focus="2m"))
    for x in (61, 63, 126):
        part = at.layers.crop(Rect(x, 0, x + 2, 120))
        out = laws.run(ReadyStage.of(stage, at.scene, level), part, at.facts)[
            Layer.IMAGE
        ]
        np.testing.assert_allclose(out, 0.3, atol=1e-5)


def test_a_black_frame_stays_black() -> None:
    black = np.zeros((120, 160, 3), np.float32)
    for level in LEVELS:
        assert not blurred(flat(black), level, aperture_px=20.0, focus="2m").any()


def test_a_plane_that_is_exactly_in_focus_is_not_touched() -> None:
    at = flat(texture(120, 160))
    stage = Dof(DofParams(fnumber=0.5, focus="50cm"))
    assert "< 1 px" in stage.demand(at.facts, at.scene, at.scene.camera.rect).reason
    np.testing.assert_array_equal(
        blurred(at, "standard", fnumber=0.5, focus="50cm"), at.layers[Layer.IMAGE]
    )
    at_infinity = blurred(at, "standard", fnumber=0.5, focus="inf")
    assert (
        np.isfinite(at_infinity).all()
        and np.abs(at_infinity - at.layers[Layer.IMAGE]).max() > 0.1
    )


def test_a_focus_within_the_focal_length_is_an_input_error() -> None:
    at = shot()
    with pytest.raises(InputError, match="cannot be focused at 40 mm"):
        Dof(DofParams(focal_mm=50.0, focus="4cm")).demand(
            at.facts, at.scene, at.scene.camera.rect
        )
    demand = Dof(DofParams(focal_mm=50.0, focus="50.0001mm")).demand(
        at.facts, at.scene, at.scene.camera.rect
    )
    assert not demand.rect.empty  # finite, bounded by a tenth of the width


PULL_LIMIT = 0.06  # mean change of linear light from frame to frame of the pull below; measured .03


def test_a_focus_pull_through_the_object_does_not_pop() -> None:
    at = shot(width=240, height=180)
    focus = [1 / (1 / 0.38 + (1 / 0.65 - 1 / 0.38) * k / 9) for k in range(10)]
    pull = [
        blurred(at, "standard", aperture_px=40.0 * f, focus=f"{100 * f:.6g}cm")
        for f in focus
    ]
    steps = [float(np.abs(b - a).mean()) for a, b in pairwise(pull)]
    assert max(steps) < PULL_LIMIT
    assert max(steps) < 3 * np.median(steps)


@pytest.mark.parametrize("level", LEVELS)
def test_a_slowly_growing_circle_does_not_jump(level: str) -> None:
    """Through the first hand-overs between resolutions: a hundredth of a pixel more changes
    next to nothing.
    """
    plate = texture(120, 160)
    for radius in (0.5, 1.6, 2.2, 2.4, 3.2, 6.0, 8.0, 12.0, 14.0, 16.0, 18.0):
        a, b = (
            blurred(
                flat(plate), level, aperture_px=aperture_for(radius + d), focus="2m"
            )
            for d in (-0.05, 0.05)
        )
        assert np.abs(a - b).mean() < 0.004, radius


def test_opacity_opens_the_lens_without_a_step() -> None:
    at = shot()
    image = at.layers[Layer.IMAGE]
    faint = Shot(at.scene, at.facts.with_(opacity=0.02), at.layers)
    assert (
        Dof(DofParams(aperture_px=12.0))
        .demand(faint.facts, faint.scene, at.scene.camera.rect)
        .rect.empty
    )
    half = Shot(at.scene, at.facts.with_(opacity=0.5), at.layers)
    away = np.ones(image.shape[:2], bool)
    away[at.facts.model_box.pad(30).clip(at.scene.camera.rect).slices] = False
    change = [
        np.abs(blurred(s, "standard", aperture_px=12.0, focus="1m") - image)[
            away
        ].mean()
        for s in (faint, half, at)
    ]
    assert change[0] == 0.0 < change[1] < change[2]


def test_the_highlight_boost_adds_light_to_clipped_pixels_only() -> None:
    plate = np.full((120, 160, 3), 0.2, np.float32)
    plate[60, 80] = 1.0
    kept, more = (
        blurred(
            flat(plate),
            "standard",
            aperture_px=aperture_for(6),
            focus="2m",
            highlight_boost=b,
        )
        for b in (0.0, 9.0)
    )
    added = (more - kept).sum(axis=(0, 1))
    np.testing.assert_allclose(added, 9.0, rtol=0.02)
    assert float(divide(np.abs(more - kept)[:30].max(), 1.0)) == 0.0
