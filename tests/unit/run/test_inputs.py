from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from arfx.config.load import load
from arfx.config.sections import frozen
from arfx.core.marker import anchor_marker
from arfx.core.pose import Pose
from arfx.errors import ConfigError, InputError
from arfx.run.folder import digest
from arfx.run.inputs import job_model, marker_map, open_inputs, placement
from arfx.run.parameters import (
    make_stages,
    parameters,
    pipeline,
    quality_notices,
)
from arfx.stages.raster.backends import BACKENDS, Backend
from tests.clips import MARKER, write_camera, write_clip


def job(tmp_path: Path, layout: Path) -> object:
    over = {
        "input": {"marker_map": str(layout)},
        "marker": [{"spec": "36h11:3:165mm"}, {"spec": "36h11:4:165mm"}],
    }
    return load(None, over, parameters())


def test_a_toml_layout(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(
        '[[marker]]\nspec = "36h11:3"\nposition = ["0m","0m","0m"]\n\n[[marker]]\nspec ='
        ' "36h11:4:165mm"\nposition = ["53cm","0m","-1cm"]\nrotate_deg = [0, 90, 0]\n'
    )
    poses = marker_map(job(tmp_path, path))  # type: ignore[arg-type]
    assert poses is not None
    np.testing.assert_allclose(
        poses["36h11:4"].apply(np.array([0, 0, 1.0])), [1.53, 0, -0.01], atol=1e-12
    )


def test_a_layout_names_a_pattern_by_its_file(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(
        '[[marker]]\nspec = "wall poster.png"\nposition = ["1m","0m","0m"]\n'
    )
    config = load(
        None,
        {
            "input": {"marker_map": str(path)},
            "pattern": [{"spec": "prints/wall poster.png:20cm"}],
        },
        parameters(),
    )
    poses = marker_map(config)
    assert poses is not None and poses["wall poster.png"].translation_m[0] == 1.0


def test_a_wpilib_layout_has_z_out_and_is_turned_like_opencv(tmp_path: Path) -> None:
    path = tmp_path / "field.json"
    pose = {
        "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
        "rotation": {"quaternion": {"W": 1.0, "X": 0.0, "Y": 0.0, "Z": 0.0}},
    }
    path.write_text(
        json.dumps({"tags": [{"ID": 3, "pose": pose}, {"ID": 4, "pose": pose}]})
    )
    poses = marker_map(job(tmp_path, path))  # type: ignore[arg-type]
    assert poses is not None and np.linalg.det(
        poses["36h11:3"].rotation
    ) == pytest.approx(1)
    np.testing.assert_allclose(
        poses["36h11:3"].apply(np.eye(3)),
        [[1, 1, 3], [1, 2, 2], [2, 2, 3]],
        atol=1e-12,
    )


@pytest.mark.parametrize(
    "text",
    [
        '[[marker]]\nspec = "36h11:3"\n',
        "x = 1\n",
        "not toml",
        '[[marker]]\nspec = "36h11:3"\nposition=["0m","0m","0m"]\n',
    ],
)
def test_layouts_that_do_not_serve_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"map\.toml"):
        marker_map(job(tmp_path, path))  # type: ignore[arg-type]


def test_the_anchor_is_the_first_configured_marker_with_a_place(
    tmp_path: Path,
) -> None:
    path = tmp_path / "map.toml"
    path.write_text("")
    config = job(tmp_path, path)
    assert (
        anchor_marker(config.markers, {"36h11:4": Pose.identity()}).key == "36h11:4"
    )  # type: ignore[attr-defined]


def test_pipelines_name_existing_effects_in_order() -> None:
    config = load(None, {"pipeline": {"stages": ["watercolour"]}}, parameters())
    with pytest.raises(ConfigError, match="watercolour"):
        pipeline(config)
    for stages in (
        "auto",
        [],
        ["lightmap"],
    ):  # light and shadow are part of every job
        assert pipeline(
            load(None, {"pipeline": {"stages": stages}}, parameters())
        ) == (
            "raster",
            "lightmap",
            "composite",
        )
    painted = load(None, {"pipeline": {"stages": ["watercolor"]}}, parameters())
    assert pipeline(painted) == ("raster", "lightmap", "composite", "watercolor")


@pytest.mark.parametrize(
    ("up", "tip"), [("z", (0, 0, 1)), ("y", (0, 1, 0)), ("x", (1, 0, 0))]
)
def test_the_middle_of_the_base_stands_on_the_marker_whichever_axis_is_up(
    up: str, tip: tuple
) -> None:
    from arfx.core.model import Model, Part

    t = np.array(tip, float)
    side = np.roll(t, 1)
    vertices = np.array([5 * t * 0 + 3, 3 + side, 3 + np.roll(t, 2), 3 + 4 * t])
    model = Model(
        (
            Part(
                vertices,
                np.array([[0, 1, 3], [1, 2, 3]], np.int32),
                np.tile(t, (4, 1)),
            ),
        ),
        up=up,
    )
    config = load(
        None, {"model": {"fit": "8cm", "offset": ["1cm", "0m", "0m"]}}, parameters()
    )
    m = placement(config).world_from_model(model)
    world = vertices @ m[:3, :3].T + m[:3, 3]
    assert (
        world[:, 2].min() == pytest.approx(0)
        and world[3, 2] == pytest.approx(0.08)
        and np.linalg.det(m[:3, :3]) > 0
    )
    np.testing.assert_allclose(
        (world.min(0) + world.max(0))[:2] / 2, [0.01, 0], atol=1e-12
    )


@pytest.mark.parametrize("key", ["smoothing", "max_gap_s"])
@pytest.mark.parametrize("value", ["inf", "nan", "1e300", "-1"])
def test_analysis_numbers_are_refused_before_the_analysis(
    tmp_path: Path, key: str, value: str
) -> None:
    (tmp_path / "job.toml").write_text(f"[analyse]\n{key} = {value}\n")
    with pytest.raises(ConfigError, match=rf"analyse\.{key}") as e:
        load(tmp_path / "job.toml", {}, parameters())
    assert "job.toml:2" in str(e.value)


@pytest.mark.parametrize("size", ["1e-300m", "1e300m", "0.00001mm"])
def test_a_marker_of_absurd_size_is_refused(size: str) -> None:
    with pytest.raises(ConfigError, match=r"the size|out of range"):
        load(None, {"marker": [{"spec": f"36h11:3:{size}"}]}, parameters())


@pytest.mark.parametrize(
    "text",
    [
        (
            '[[marker]]\nspec = "36h11:3"\nposition = ["0m","0m","0m"]\nrotate_deg = [inf,'
            " 0, 0]\n"
        ),
        '[[marker]]\nspec = "36h11:3"\nposition = [1, 2, 3]\n',
        (
            '{"tags": [{"ID": 3, "pose": {"translation": {"x": 1e308, "y": 0, "z": 0},'
            ' "rotation": {"quaternion": {"W": 1, "X": 0, "Y": 0, "Z": 0}}}}]}'
        ),
        (
            '{"tags": [{"ID": 3, "pose": {"translation": {"x": 0, "y": 0, "z": 0},'
            ' "rotation": {"quaternion": {"W": 5, "X": 0, "Y": 9, "Z": 0}}}}]}'
        ),
        (
            '{"tags": [{"ID": 3, "pose": {"translation": {"x": 0, "y": 0, "z": 0},'
            ' "rotation": {"quaternion": {"W": 1e200, "X": 0, "Y": 1e200, "Z": 0}}}}]}'
        ),
        '{"tags": [' + "[" * 5000,
        '{"tags": [{"ID": ' + "9" * 5000 + "}]}",
        '{"tags": 5}',
        "x = " + "[" * 5000,
    ],
)
@pytest.mark.filterwarnings("error")
def test_hostile_layouts_are_one_message(tmp_path: Path, text: str) -> None:
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises((InputError, ConfigError)) as e:
        marker_map(job(tmp_path, tmp_path / "map.toml"))  # type: ignore[arg-type]
    assert "map.toml" in str(e.value) and len(str(e.value)) < 600


@pytest.mark.parametrize("w", [0.5, 5.0])
def test_a_quaternion_that_is_not_unit_is_no_pose(tmp_path: Path, w: float) -> None:
    quaternion = {"W": w, "X": 0.5, "Y": 0.0, "Z": 0.0}
    place = {
        "translation": {"x": 0, "y": 0, "z": 0},
        "rotation": {"quaternion": quaternion},
    }
    (tmp_path / "map.json").write_text(
        json.dumps({"tags": [{"ID": 3, "pose": place}]})
    )
    with pytest.raises(InputError, match="is not a valid pose"):
        marker_map(job(tmp_path, tmp_path / "map.json"))  # type: ignore[arg-type]


def test_what_auto_renders_with_is_chosen_once_and_part_of_the_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_clip(tmp_path / "clip.mp4", 1)
    write_camera(tmp_path / "camera.yaml")
    (tmp_path / "model.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    files = {
        "input": {
            "clip": str(tmp_path / "clip.mp4"),
            "camera": str(tmp_path / "camera.yaml"),
        },
        "marker": [{"spec": MARKER}],
        "model": {"file": str(tmp_path / "model.obj"), "fit": "5cm"},
        "output": {"path": str(tmp_path / "out.mkv")},
    }
    trees = []
    for name in BACKENDS:
        monkeypatch.setattr(
            "arfx.stages.raster.stage.choose_backend",
            lambda wanted, name=name: Backend(name, None, {}, ""),
        )
        trees.append(frozen(open_inputs(load(None, files, parameters())).config))
    assert [tree["raster"]["backend"] for tree in trees] == list(BACKENDS)
    assert digest(trees[0]) != digest(trees[1])


def test_a_model_is_read_once_by_whatever_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.chdir(tmp_path)
    first, again = (
        job_model(load(None, {"model": {"file": str(p)}}, parameters()))
        for p in (Path("a.obj"), tmp_path / "a.obj")
    )
    assert first is again


@pytest.mark.parametrize(("stages", "notices"), [(["dof"], 1), (["watercolor"], 0)])
def test_high_is_said_to_be_standard_where_no_effect_has_it(
    stages: list[str], notices: int
) -> None:
    pipeline = {"stages": stages, "quality": "high"}
    config = load(
        None, {"input": {"clip": "clip.mp4"}, "pipeline": pipeline}, parameters()
    )
    assert len(quality_notices("high", make_stages(config))) == notices
