"""The laws that every stage keeps, as functions that raise AssertionError.

Used on real and on broken stages.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers, neutral
from arfx.core.pixels import Pixels
from arfx.core.rect import Rect
from arfx.core.stage import ReadyStage
from arfx.stages import RENDERER
from tests.scenes import layers_of


def random_layers(rect: Rect, seed: int) -> Layers:
    """Content that hides nothing: random everywhere, no flat background for a wrong border
    to disappear in.
    """
    g = np.random.default_rng(seed)
    h, w = rect.height, rect.width
    out: dict[Layer, np.ndarray] = {}
    for name in Layer:
        if name in (Layer.PLATE, Layer.IMAGE):
            out[name] = g.random((h, w, 3), dtype=np.float32)
        elif name is Layer.NORMAL:
            v = g.normal(size=(h, w, 3))
            out[name] = (v / np.linalg.norm(v, axis=-1, keepdims=True)).astype(
                np.float32
            )
        elif name is Layer.DEPTH:
            out[name] = g.uniform(0.2, 4, (h, w)).astype(np.float32)
        elif name is Layer.OBJECT_ID:
            out[name] = g.integers(0, 3, (h, w)).astype(np.int32)
        else:
            out[name] = g.random(neutral(name, rect).shape, dtype=np.float32)
    return layers_of(rect, out)


def hard_layers(rect: Rect) -> Layers:
    """Legal but nasty: black, very bright, zero normals, infinite and tiny depth, zero
    positions.
    """
    g = np.random.default_rng(0)
    out = {}
    random = random_layers(rect, 1)
    for name in Layer:
        b = random[name].copy()
        values = {Layer.DEPTH: [np.inf, 1e-4, 1e6], Layer.OBJECT_ID: [0]}.get(
            name, [0.0, 1.0]
        )
        if name in (Layer.PLATE, Layer.IMAGE, Layer.VIRTUAL, Layer.EMISSIVE):
            values = [0.0, 1e4]
        pick = g.integers(0, len(values) + 1, b.shape[:2])
        for k, v in enumerate(values):
            b[pick == k] = v
        out[name] = b
    return layers_of(rect, out)


def run(at: ReadyStage, layers: Layers, f: FrameFacts) -> Mapping[Layer, np.ndarray]:
    made = at.stage.run(at.view(layers, f), at.prepared)
    return {
        name: Layers(layers.rect, {**layers.written, name: a})[name]
        if isinstance(a, Pixels)
        else a
        for name, a in made.items()
    }


def check_roi_law(
    at: ReadyStage, f: FrameFacts, seed: int, atol: float = 1e-6
) -> None:
    """run(crop(needs(out))) == crop(run(all)) on `out`."""
    stage, scene = at.stage, at.scene
    frame = scene.camera.rect
    g = np.random.default_rng(seed)
    x, y = int(g.integers(0, frame.width - 40)), int(g.integers(0, frame.height - 32))
    out = Rect(x, y, x + 37, y + 29)
    whole = random_layers(frame, seed)
    need = stage.needs(out, f, scene, at.level).union(out).clip(frame)
    a = run(at, whole, f)
    b = run(at, whole.crop(need), f)
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_allclose(
            b[name][out.slices_in(need)],
            a[name][out.slices_in(frame)],
            rtol=0,
            atol=atol,
            err_msg=name,
        )


def check_pure(at: ReadyStage, f: FrameFacts) -> None:
    """Inputs stay unchanged, an effect writes the picture alone, the same seed gives the
    same bits.
    """
    stage, rect = at.stage, Rect(20, 15, 95, 80)
    layers = random_layers(rect, 5)
    before = {k: layers[k].copy() for k in Layer}
    first = run(at, layers, f)
    second = run(at, layers, f)
    if stage.name not in RENDERER:
        assert set(first) <= {Layer.IMAGE}, (
            f"{stage.name} writes more than the picture"
        )
    for name in Layer:
        assert np.array_equal(layers[name], before[name]), (
            f"{stage.name} changed its input {name}"
        )
    for name, array in first.items():
        assert array.shape[:2] == (rect.height, rect.width)
        assert np.array_equal(array, second[name], equal_nan=True), (
            f"{stage.name} gives other bits for the same seed: {name}"
        )


def check_finite(at: ReadyStage, f: FrameFacts) -> None:
    """Hard but legal layers give finite values (depth may be infinite where nothing is)."""
    stage = at.stage
    made = run(at, hard_layers(Rect(20, 15, 95, 80)), f)
    for name, array in made.items():
        assert not np.isnan(array).any(), f"{stage.name} makes NaN in {name}"
        if name is not Layer.DEPTH:
            assert np.isfinite(array).all(), f"{stage.name} makes infinity in {name}"
