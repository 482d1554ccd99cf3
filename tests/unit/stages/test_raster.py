"""The raster stage against closed forms: where things land, how far they are, what covers what."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from arfx.core.colour import SRGB
from arfx.core.layers import Layer
from arfx.core.model import (
    BLEND,
    CLAMP,
    MASK,
    MIRROR,
    REPEAT,
    Material,
    Model,
    Part,
    Texture,
)
from arfx.core.pose import Pose
from arfx.core.rect import EMPTY, Rect
from arfx.core.scene import Placement, Scene
from arfx.errors import ConfigError, InputError, RenderError
from arfx.stages.raster import Raster, RasterParams, backend_report, choose_backend
from arfx.stages.raster import backends as backends_module
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.texture_filter import filtered
from arfx.stages.raster.textures import FULL, OFFSETS, texture_stack, write_pyramid
from arfx.stages.raster.visible import lattice
from tests.reference.raster import ReferenceRenderer
from tests.scenes import box_model, facts
from tests.unit.stages.raster_scenes import (
    BOTH,
    LENSES,
    PLAIN,
    camera,
    in_front,
    quad,
    render,
    scene_of,
    square,
)


def projected(scene: Scene, pose: Pose, points: np.ndarray) -> np.ndarray:
    c = scene.camera
    return cv2.projectPoints(
        points,
        cv2.Rodrigues(pose.rotation)[0],
        pose.translation_m,
        c.matrix,
        c.distortion,
    )[0].reshape(-1, 2)


@pytest.mark.parametrize("backend", BOTH)
@pytest.mark.parametrize("lens", list(LENSES))
def test_a_vertex_lands_where_opencv_projects_it(backend: str, lens: str) -> None:
    places = [(-0.38, -0.25), (0.0, 0.0), (0.4, 0.2), (-0.3, 0.28), (0.35, -0.2)]
    scene = scene_of([square(0.01, 0, PLAIN, p) for p in places], lens)
    pose = in_front(1.0)
    out = render(scene, pose, backend, samples=64)
    centre = projected(scene, pose, np.array([[x, y, 0.0] for x, y in places]))
    ys, xs = np.mgrid[:240, :320]
    for k, want in enumerate(centre):
        w = out[Layer.COVERAGE] * (np.hypot(xs - want[0], ys - want[1]) < 9)
        got = np.array([(w * xs).sum(), (w * ys).sum()]) / w.sum()
        assert np.abs(got - want).max() < 0.1, (k, got, want)


@pytest.mark.parametrize("backend", BOTH)
@pytest.mark.parametrize("lens", ["ideal", "barrel"])
def test_a_large_quads_coverage_is_its_area(backend: str, lens: str) -> None:
    scene = scene_of([square(0.25)], lens)
    pose = in_front(1.0, 25, 20)
    out = render(scene, pose, backend)
    t = np.linspace(0, 1, 200, endpoint=False)[:, None]
    c = scene.model.parts[0].vertices
    outline = np.concatenate([c[i] * (1 - t) + c[(i + 1) % 4] * t for i in range(4)])
    x, y = projected(scene, pose, outline).T
    area = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    border = np.hypot(np.diff(x, append=x[0]), np.diff(y, append=y[0])).sum()
    # an edge off by .05 px all along would show
    assert abs(out[Layer.COVERAGE].sum() - area) < 0.02 * border
    inside = (
        cv2.erode((out[Layer.COVERAGE] > 0).astype(np.uint8), np.ones((5, 5))) > 0
    )
    assert inside.sum() > 5000 and (out[Layer.COVERAGE][inside] == 1).all(), (
        "a seam between triangles"
    )


@pytest.mark.parametrize("backend", BOTH)
@pytest.mark.parametrize("lens", ["ideal", "rational"])
def test_plane_depth_position_normal_and_material(backend: str, lens: str) -> None:
    scene = scene_of([square(0.25)], lens)
    pose = in_front(1.0, 30, -15)
    out = render(scene, pose, backend)
    inner = (
        cv2.erode((out[Layer.COVERAGE] == 1).astype(np.uint8), np.ones((3, 3))) > 0
    )
    ys, xs = np.mgrid[:240, :320]
    d = scene.camera.directions(np.stack([xs, ys], -1).astype(float))
    n, p0 = pose.rotation[:, 2], pose.translation_m
    z = (n @ p0) / (d @ n)
    assert (np.abs(out[Layer.DEPTH] - z) < 2e-5)[inner].all()
    assert np.isinf(out[Layer.DEPTH][out[Layer.COVERAGE] == 0]).all()
    assert np.abs(out[Layer.POSITION][inner][:, 2]).max() < 3e-3
    back = scene.camera.project(pose.apply(out[Layer.POSITION][inner].astype(float)))
    assert np.abs(back - np.stack([xs, ys], -1)[inner]).max() < 0.02
    np.testing.assert_allclose(
        out[Layer.NORMAL][inner], np.tile([0, 0, 1], (inner.sum(), 1)), atol=1e-5
    )
    covered = (
        out[Layer.COVERAGE] > 0
    )  # edge pixels too: never mixed with the background
    np.testing.assert_allclose(
        out[Layer.ALBEDO][covered],
        np.tile([0.2, 0.4, 0.6], (covered.sum(), 1)),
        atol=2e-5,
    )
    np.testing.assert_allclose(
        out[Layer.MATERIAL][covered],
        np.tile([0.25, 0.5, 0.5, 1], (covered.sum(), 1)),
        atol=2e-5,
    )
    assert (out[Layer.OBJECT_ID][covered] == 1).all() and (
        out[Layer.OBJECT_ID][~covered] == 0
    ).all()


@pytest.mark.parametrize("backend", BOTH)
def test_sphere_depth_and_normals(backend: str) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.2)
    n = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    scene = scene_of([Part(n * 0.2, ball.faces.astype(np.int32), n, PLAIN)], "barrel")
    pose = in_front(0.9)
    out = render(scene, pose, backend)
    ys, xs = np.mgrid[:240, :320]
    d = scene.camera.directions(np.stack([xs, ys], -1).astype(float))
    c, r = pose.translation_m, 0.2
    a, b = (d * d).sum(-1), d @ c
    root = b * b - a * (c @ c - r * r)
    hit = root > 0.02
    z = (b - np.sqrt(np.where(hit, root, 0))) / a
    assert np.abs(out[Layer.DEPTH] - z)[hit].max() < 1e-3
    want = (out[Layer.POSITION] / 0.2)[hit]
    assert ((out[Layer.NORMAL][hit] * want).sum(1) > np.cos(np.radians(1.5))).all()
    assert abs(out[Layer.COVERAGE].sum() - (root > 0).sum()) < 40


@pytest.mark.parametrize("backend", BOTH)
def test_sides(backend: str) -> None:
    one = Material(double_sided=False)
    pose = Pose(
        in_front().rotation @ np.diag([1.0, -1, -1]), np.array([0, 0, 1.0])
    )  # from behind
    assert (
        render(scene_of([square(0.2, 0, one)]), pose, backend)[Layer.COVERAGE].max()
        == 0
    )
    out = render(scene_of([square(0.2, 0, PLAIN)]), pose, backend)
    assert out[Layer.COVERAGE].max() == 1
    np.testing.assert_allclose(
        out[Layer.NORMAL][131, 151], [0, 0, -1], atol=1e-6
    )  # towards the camera


@pytest.mark.parametrize("backend", BOTH)
@pytest.mark.parametrize("level", ["standard", "reference"])
def test_blend_is_ordered_whatever_the_order_in_the_file(
    backend: str, level: str
) -> None:
    if (backend, level) == ("pyrender", "reference"):
        pytest.skip("the reference level has rays only")
    red = square(
        0.2,
        0.10,
        Material(base_colour=(1, 0, 0, 0.5), alpha_mode=BLEND, double_sided=True),
    )
    green = square(
        0.2,
        0.05,
        Material(base_colour=(0, 1, 0, 0.25), alpha_mode=BLEND, double_sided=True),
    )
    blue = square(
        0.1, 0.0, Material(base_colour=(0, 0, 1, 0.3), double_sided=True)
    )  # OPAQUE ignores alpha
    for parts in ([red, green, blue], [blue, green, red], [green, blue, red]):
        out = render(
            scene_of(parts), in_front(), backend, level, rect=Rect(140, 120, 210, 140)
        )
        at = (131 - 120, 151 - 140)
        assert out[Layer.COVERAGE][at] == pytest.approx(1, abs=1e-4)
        np.testing.assert_allclose(
            out[Layer.ALBEDO][at], [0.5, 0.125, 0.375], atol=1e-3
        )
        assert out[Layer.DEPTH][at] == pytest.approx(0.9, abs=1e-4)
        assert out[Layer.OBJECT_ID][at] == 1 + parts.index(red)
        side = (131 - 120, 151 - 140 + 48)  # beside the blue one
        assert out[Layer.COVERAGE][side] == pytest.approx(1 - 0.5 * 0.75, abs=1e-3)
        np.testing.assert_allclose(
            out[Layer.ALBEDO][side], [0.5 / 0.625, 0.125 / 0.625, 0], atol=2e-3
        )


@pytest.mark.parametrize("backend", BOTH)
def test_mask_is_cut_out(backend: str) -> None:
    picture = np.full((64, 64, 4), 255, np.uint8)
    picture[:, 32:, 3] = 100  # right half below the cutoff
    part = square(
        0.2,
        0,
        Material(
            base_colour=(1, 1, 1, 1),
            base_texture=Texture(picture),
            alpha_mode=MASK,
            alpha_cutoff=0.5,
            double_sided=True,
        ),
    )
    out = render(scene_of([part]), in_front(), backend)
    c = out[Layer.COVERAGE][131]
    assert c[151 - 50 : 151 - 3].min() == 1 and c[151 + 4 : 151 + 50].max() == 0
    # between the last solid texel's centre and the first clear one's, opacity falls through
    # .5 after .823 of the way
    edge_m = ((31.5 + (255 - 127.5) / 155) / 64 - 0.5) * 0.4
    assert abs(c[120:200].sum() - (151.3 + 300 * edge_m + 0.5 - 120)) < 0.2


@pytest.mark.parametrize("backend", BOTH)
def test_texture_is_upright_linear_and_filtered(backend: str) -> None:
    picture = np.zeros((256, 256, 3), np.uint8)
    picture[:128, :128] = [188, 0, 0]  # top left: .503 linear
    picture[128:, 128:] = (
        np.indices((128, 128)).sum(0)[..., None] % 2 * 255
    )  # checker far finer than a pixel
    part = square(
        0.2,
        0,
        Material(
            base_colour=(1, 1, 1, 1), base_texture=Texture(picture), double_sided=True
        ),
    )
    out = render(scene_of([part]), in_front(), backend)
    np.testing.assert_allclose(
        out[Layer.ALBEDO][131 - 30, 151 - 30], [0.503, 0, 0], atol=0.01
    )
    fine = out[Layer.ALBEDO][131 + 20 : 131 + 40, 151 + 20 : 151 + 40]
    assert (
        fine.mean() == pytest.approx(0.5, abs=0.03) and fine.std() < 0.09
    )  # averaged in linear light


@pytest.mark.parametrize("backend", BOTH)
def test_camera_inside_and_across_the_camera_plane(backend: str) -> None:
    box = box_model(0.4, PLAIN)
    scene = Scene(camera("barrel"), box, np.eye(4))
    for pose in (
        in_front(0.0),
        in_front(0.19, 20),
        in_front(0.2),
        in_front(-0.1),
        Pose(np.eye(3), np.array([0, 0, 5.0])),
    ):
        out = render(scene, pose, backend)
        for name, array in out.items():
            assert not np.isnan(array).any(), name
        assert np.isfinite(out[Layer.POSITION]).all()
    inside = render(scene, in_front(0.0), backend)
    assert inside[Layer.COVERAGE].min() == 1, "the walls are all around"
    assert render(scene, in_front(-3.0), backend)[Layer.COVERAGE].max() == 0, (
        "behind the camera"
    )


def test_a_wire_thinner_than_a_pixel_is_not_missed() -> None:
    w = 0.3 / 300 / 2  # .3 px wide
    wire = quad(
        np.array(
            [
                [-0.3, -0.1 - w, 0],
                [0.3, 0.1 - w, 0],
                [0.3, 0.1 + w, 0],
                [-0.3, -0.1 + w, 0],
            ]
        )
    )
    out = render(scene_of([wire]), in_front(), "rays", samples=64)
    c = out[Layer.COVERAGE]
    per_column = c[:, 80:220].sum(0)
    assert abs(per_column.mean() - 0.3 * 310 / 300) < 0.03 and per_column.min() > 0.1


@pytest.mark.parametrize("lens", list(LENSES))
def test_rays_give_the_same_bits_over_any_rectangle(lens: str) -> None:
    scene = Scene(camera(lens), box_model(0.3, PLAIN), np.eye(4))
    pose = in_front(0.9, 35, 25)
    whole = render(scene, pose, "rays")
    for rect in (
        Rect(100, 80, 190, 150),
        Rect(0, 0, 160, 132),
        Rect(131, 100, 132, 101),
    ):
        part = render(scene, pose, "rays", rect=rect)
        for name in part:
            assert np.array_equal(part[name], whole[name][rect.slices]), name


@cache
def barrel_box(backend: str, level: str) -> dict[Layer, np.ndarray]:
    scene = Scene(camera("barrel"), box_model(0.3, PLAIN), np.eye(4))
    return render(
        scene, in_front(0.9, 35, 25), backend, level, rect=Rect(60, 50, 250, 220)
    )


@pytest.mark.parametrize("backend", BOTH)
def test_standard_is_near_the_reference(backend: str) -> None:
    best = barrel_box("rays", "reference")
    errors = [
        np.abs(barrel_box(backend, le)[Layer.COVERAGE] - best[Layer.COVERAGE]).mean()
        for le in ("draft", "standard")
    ]
    assert (2 if backend == "rays" else 1) * errors[1] < errors[0], (
        "a higher level must be nearer to the reference"
    )
    out = barrel_box(backend, "standard")
    assert np.abs(out[Layer.COVERAGE] - best[Layer.COVERAGE]).mean() < (
        0.0005 if backend == "rays" else 0.003
    )
    flat = (
        cv2.erode((best[Layer.COVERAGE] == 1).astype(np.uint8), np.ones((3, 3))) > 0
    )
    assert np.median(np.abs(out[Layer.DEPTH][flat] - best[Layer.DEPTH][flat])) < 1e-6


def test_the_references_positions_lie_on_the_surface() -> None:
    """Not in it: rays that indirect light sends from there would meet the object at once,
    and find it dark.
    """
    scene = scene_of([square(0.4)])
    out = render(
        scene,
        in_front(1.0, 50, 20),
        "rays",
        "reference",
        rect=Rect(120, 100, 190, 150),
    )
    inside = (
        cv2.erode((out[Layer.COVERAGE] == 1).astype(np.uint8), np.ones((3, 3))) > 0
    )
    assert (
        inside.sum() > 1000 and np.abs(out[Layer.POSITION][inside][:, 2]).max() < 1e-6
    )


def test_lens_table_is_exact_to_a_thousandth_of_a_pixel() -> None:
    for lens in LENSES:
        c = camera(lens)
        d = LensTable(c).directions(c.rect).astype(float)
        want = c.normalised(
            np.stack(np.meshgrid(np.arange(c.width), np.arange(c.height)), -1).astype(
                float
            )
        )
        assert (np.abs(d - want) * [c.fx, c.fy]).max() < 1e-3, lens


def test_samples_lie_in_every_row_and_column_and_cover_edges_as_they_are() -> None:
    angle, offset = (
        g.ravel()
        for g in np.meshgrid(np.linspace(0, np.pi, 60), np.linspace(-0.45, 0.45, 31))
    )
    normal, grid = (
        np.stack([np.cos(angle), np.sin(angle)]),
        (np.indices((100, 100)).reshape(2, -1).T + 0.5) / 100 - 0.5,
    )
    covered = (grid @ normal < offset).mean(0)
    for n, most in ((4, 0.1), (16, 0.035), (64, 0.011)):
        p = lattice(n)
        for k in range(2):
            assert sorted(np.floor((p[:, k] + 0.5) * n).astype(int)) == list(range(n))
        assert np.abs(p.mean(0)).max() < 1e-9
        assert np.abs((p @ normal < offset).mean(0) - covered).mean() < most, n


def stripes_scene(lens: str = "ideal") -> Scene:
    """A square with stripes three pixels wide, seen at a slant; a smaller one passes through it."""
    picture = np.zeros((256, 256, 3), np.uint8)
    picture[:, np.arange(256) % 8 < 4] = 230, 40, 40
    fine = square(
        0.3,
        0,
        Material(
            base_colour=(1, 1, 1, 1), base_texture=Texture(picture), double_sided=True
        ),
    )
    a = np.array(
        [
            [-0.15, -0.1, -0.1],
            [0.15, -0.1, -0.1],
            [0.15, 0.15, 0.12],
            [-0.15, 0.15, 0.12],
        ]
    )
    return scene_of([fine, quad(a)], lens)


def test_standard_is_near_the_mean_over_each_pixel() -> None:
    """Of what is seen, colour times coverage, sRGB coded: fine textures, and where parts
    pass through each other.
    """
    pose, rect = in_front(0.9, 50, 15), Rect(90, 108, 200, 138)
    best, *made = (
        render(stripes_scene(), pose, "rays", level, rect=rect)
        for level in ("reference", "draft", "standard")
    )

    def seen(out: dict[Layer, np.ndarray]) -> np.ndarray:
        return 255 * SRGB.encode(out[Layer.ALBEDO] * out[Layer.COVERAGE][..., None])

    draft, standard = (
        np.abs(seen(out) - seen(best)).max(-1)[best[Layer.COVERAGE] > 0]
        for out in made
    )
    assert standard.mean() < 1.5 < 5 * standard.mean() < draft.mean()
    assert standard.max() < 40, "an edge between parts was not sampled"


def test_a_sample_is_the_mean_over_its_texels() -> None:
    """White noise in samples of up to three texels, beside the mean over all of each."""
    numbers, nothing = np.random.default_rng(7), np.zeros(2, np.float32)
    noise = Texture(numbers.integers(0, 256, (64, 64, 3), np.uint8))
    stack = texture_stack([(noise, False)])

    def seen(place: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
        sample = (tuple(np.float32(a) for a in v) for v in (place, across, down))
        return 255 * np.array(filtered(*stack, 0, *sample, 4)[:3])

    within = (np.arange(12) + 0.5) / 12 - 0.5
    off = []
    for _ in range(200):
        turns = numbers.uniform(0, 2 * np.pi) + np.array([0, numbers.uniform(1, 2)])
        across, down = (
            side * np.array([np.cos(turn), np.sin(turn)]) / 64
            for side, turn in zip(numbers.uniform(0.75, 3, 2), turns, strict=True)
        )
        place = numbers.uniform(0.2, 0.8, 2)
        whole = [
            seen(place + a * across + b * down, nothing, nothing)
            for a in within
            for b in within
        ]
        off.append(np.abs(seen(place, across, down) - np.mean(whole, 0)).mean())
    assert np.mean(off) < 1.2


def grey(out: dict[Layer, np.ndarray]) -> np.ndarray:
    """(h, w, 7) grey levels of colour, metallic and normal before a grey wall."""
    values = np.concatenate(
        [
            out[Layer.ALBEDO],
            out[Layer.MATERIAL][..., :1],
            out[Layer.NORMAL] / 2 + 0.5,
        ],
        -1,
    )
    coverage = out[Layer.COVERAGE][..., None]
    return 255 * SRGB.encode((values * coverage + 0.2 * (1 - coverage)).clip(0, 1))


def independent_scenes() -> dict[str, tuple[Scene, Pose, Rect]]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    colours = np.pad(ball.vertices * 2 + 0.5, ((0, 0), (0, 1)), constant_values=1.0)
    part = Part(
        ball.vertices,
        ball.faces.astype(np.int32),
        ball.vertices / 0.2,
        PLAIN,
        None,
        colours,
    )
    glass = Material(
        base_colour=(0.9, 0.1, 0.1, 0.4), alpha_mode=BLEND, double_sided=True
    )
    behind = Model((square(0.2, 0.2, glass), *box_model(0.2, PLAIN).parts), "z")
    cut = np.full((16, 16, 4), 255, np.uint8)
    cut[4:9, 3:12, 3] = 0
    leaf = square(
        0.2,
        0,
        Material(
            base_colour=(1, 1, 1, 1),
            base_texture=Texture(cut),
            alpha_mode=MASK,
            double_sided=True,
        ),
    )
    return {
        "box": (
            Scene(camera("barrel"), box_model(0.3, PLAIN), np.eye(4)),
            in_front(0.9, 35, 25),
            Rect(60, 90, 250, 130),
        ),
        "ball": (
            scene_of([part], "rational"),
            in_front(0.9, 20, 10),
            Rect(80, 120, 210, 150),
        ),
        "stripes": (
            stripes_scene("barrel"),
            in_front(0.9, 50, 15),
            Rect(90, 108, 200, 138),
        ),
        "glass": (
            Scene(camera(), behind, np.eye(4)),
            in_front(1.0, 25, 15),
            Rect(100, 100, 200, 140),
        ),
        "cut-out": (scene_of([leaf]), in_front(0.8, 30, 40), Rect(80, 100, 220, 130)),
    }


@pytest.mark.parametrize("name", list(independent_scenes()))
def test_the_reference_level_is_what_an_independent_renderer_finds(name: str) -> None:
    scene, pose, rect = independent_scenes()[name]
    out = render(scene, pose, "rays", "reference", rect=rect)
    other = ReferenceRenderer(scene.mesh, scene.camera, 2048, 0.0015).render(
        rect, pose
    )
    covered = (out[Layer.COVERAGE] > 0) | (other[Layer.COVERAGE] > 0)
    assert covered.sum() > 1000
    assert np.abs(grey(out) - grey(other))[covered].mean() < 0.1


def test_pyramid_averages_in_linear_light() -> None:
    checker = (
        (np.indices((4, 4)).sum(0) % 2 * 255).astype(np.uint8)[..., None].repeat(3, 2)
    )
    texels, texture = np.empty((61, 4), np.uint16), Texture(checker)
    levels = write_pyramid(texture, True, texels)
    assert [x.shape[:2] for x in levels] == [(4, 4), (2, 2), (1, 1)]
    for srgb in (True, False):
        assert (
            np.abs(
                write_pyramid(texture, srgb, texels)[1][0, 0]
                - [FULL / 2, FULL / 2, FULL / 2, FULL]
            ).max()
            <= 1
        )
    stack = texture_stack([(Texture(checker), srgb) for srgb in (True, True, False)])
    starts = stack.table[:, OFFSETS].tolist()
    assert starts == [0, 0, 61] and len(stack.texels) == 122, (
        "one picture is stored once"
    )


@pytest.mark.parametrize(
    ("wrap", "shown"),
    [(REPEAT, [0, 1, 0, 1]), (CLAMP, [0, 0, 0, 1]), (MIRROR, [1, 0, 0, 1])],
)
@pytest.mark.parametrize("backend", BOTH)
def test_textures_go_on_beyond_their_edges(
    backend: str, wrap: str, shown: list[int]
) -> None:
    stripes = np.zeros((1, 8, 3), np.uint8)
    stripes[:, 4:] = 255
    uv = np.array([[-1.0, 1], [1, 1], [1, 0], [-1, 0]])  # twice across, from -1 to 1
    base = Texture(stripes, wrap=(wrap, wrap))
    part = square(
        0.2,
        0,
        Material(base_colour=(1, 1, 1, 1), base_texture=base, double_sided=True),
    )
    part = Part(part.vertices, part.faces, part.normals, part.material, uv)
    row = render(scene_of([part]), in_front(), backend)[Layer.ALBEDO][131, :, 0]
    at = 151.3 + 120 * (np.arange(4) - 1.5) / 4  # the middles of the four halves
    np.testing.assert_allclose(row[np.round(at).astype(int)], shown, atol=1e-3)


def test_demand_says_why() -> None:
    scene = scene_of([square(0.2)])
    f = facts(scene, in_front())
    stage = Raster()
    frame = scene.camera.rect
    assert "px" in stage.demand(f, scene, frame).reason and frame.contains(
        stage.demand(f, scene, frame).rect
    )
    assert (
        stage.demand(f.with_(model_box=EMPTY), scene, frame).reason
        == "model out of view"
    )


def test_a_model_in_millimetres_read_as_metres_is_refused() -> None:
    model = box_model(300.0)
    scene = Scene(camera(), model, Placement().world_from_model(model))
    stage = Raster(RasterParams(backend="rays"))
    with pytest.raises(InputError, match="300 m large") as e:
        stage.prepare(scene, stage.levels[0])
    assert "--fit" in e.value.hint


def test_settings_and_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValidationError, match="'rays'"):
        RasterParams(backend="opengl")  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="samples"):
        RasterParams(samples=1000)
    with pytest.raises(ConfigError, match="unknown"):
        choose_backend("vulkan")
    from arfx.stages.raster import gl_context

    def refuse() -> None:
        raise RenderError(
            "no OpenGL context opens here (egl: libEGL.so.1 is not installed)",
            gl_context.FIX,
        )

    monkeypatch.setattr(gl_context, "open_context", refuse)
    monkeypatch.setattr(backends_module, "_graphics_card", lambda: True)
    chosen = choose_backend("auto")
    assert chosen.name == "rays" and "libEGL" in chosen.why
    with pytest.raises(RenderError, match="libEGL"):
        choose_backend("pyrender")
    state = {s.name: s for s in backend_report()}
    assert (
        not state["pyrender"].opens
        and "apt-get" in state["pyrender"].fix
        and state["rays"].opens
    )
    assert (
        state["auto"].opens
        and "takes rays: no OpenGL context opens here" in state["auto"].detail
    )


@pytest.mark.parametrize(
    ("card", "software", "taken"),
    [
        (True, False, "takes pyrender: OpenGL runs on a graphics card here"),
        (True, True, "takes rays: OpenGL runs in software here"),
        (False, True, "takes rays: there is no graphics card here"),
    ],
)
def test_auto_takes_opengl_on_a_graphics_card_alone(
    monkeypatch: pytest.MonkeyPatch, card: bool, software: bool, taken: str
) -> None:
    from arfx.stages.raster import gl_context

    opened = gl_context.GlContext(None, None, "egl, OpenGL 4.6", software)
    monkeypatch.setattr(gl_context, "open_context", lambda: opened)
    monkeypatch.setattr(backends_module, "_graphics_card", lambda: card)
    state = {s.name: s for s in backend_report()}
    assert state["auto"].detail == taken and state["auto"].opens


def test_empty_where_nothing_is(monkeypatch: pytest.MonkeyPatch) -> None:
    out = render(
        Scene(camera(), Model((square(0.1),), "z"), np.eye(4)),
        in_front(),
        "rays",
        rect=Rect(0, 0, 20, 10),
    )
    assert (
        out[Layer.COVERAGE].shape == (10, 20)
        and out[Layer.COVERAGE].max() == 0
        and np.isinf(out[Layer.DEPTH]).all()
    )


def test_textures_take_no_more_than_their_own_types() -> None:
    import tracemalloc

    image = np.random.default_rng(0).integers(0, 256, (2048, 2048, 4), dtype=np.uint8)
    expected = (
        SRGB.decode(image[:64, :64, :3] / 255).reshape(32, 2, 32, 2, 3).mean((1, 3))
    )
    tracemalloc.start()
    stack = texture_stack([(Texture(image), True)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * image.size / 4  # texels 10.7, the picture with four channels 4
    first = (
        stack.texels[stack.table[0, OFFSETS + 1] :][: 1026 * 1026, :3].reshape(
            1026, 1026, 3
        )[1:33, 1:33]
        / FULL
    )
    assert np.abs(first - expected).max() < 1e-4
