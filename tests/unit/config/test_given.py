from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from arfx.config.given import overrides, parse_setting, section_overrides
from arfx.config.load import load
from arfx.config.sections import PipelineSection, settings
from arfx.errors import ConfigError

NOTHING: dict[str, Any] = {s.name: None for s in settings()}


def given(**options: Any) -> dict[str, Any]:
    return overrides(section_overrides({**NOTHING, **options}), ())


def test_no_two_settings_have_the_same_option() -> None:
    flags = [flag for s in settings() for flag in s.flags]
    assert len(set(flags)) == len(flags) and len(NOTHING) >= 25
    assert not overrides(
        section_overrides({**NOTHING, "marker": (), "no_skip": False}), ()
    )


def test_an_empty_text_is_given_but_for_a_list_of_effects() -> None:
    assert given(start="", camera="")["input"] == {"start": "", "camera": ""}
    assert not given(pipeline="")
    assert PipelineSection.model_validate({"stages": "lightmap,"}).stages == [
        "lightmap"
    ]


@pytest.mark.parametrize(
    ("option", "value", "tree"),
    [
        ("clip", Path("c.mp4"), {"input": {"clip": Path("c.mp4")}}),
        ("model", Path("m.glb"), {"model": {"file": Path("m.glb")}}),
        (
            "marker",
            ("36h11:3:5cm", "36h11:4:5cm"),
            {"marker": [{"spec": "36h11:3:5cm"}, {"spec": "36h11:4:5cm"}]},
        ),
        ("rotate", "0, 0,90", {"model": {"rotate": "0, 0,90"}}),
        ("offset", "1cm,0,0", {"model": {"offset": "1cm,0,0"}}),
        ("pipeline", "gi, dof", {"pipeline": {"stages": "gi, dof"}}),
        ("pipeline", "auto", {"pipeline": {"stages": "auto"}}),
        ("pipeline", "", {}),
        ("no_skip", True, {"pipeline": {"skip": False}}),
        ("crf", 0.0, {"output": {"crf": 0.0}}),
    ],
)
def test_options_become_keys_of_a_job_file(
    option: str, value: Any, tree: dict[str, Any]
) -> None:
    assert given(**{option: value}) == tree
    load(None, tree, {})


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("offset", "1cm,2cm", "'1cm,2cm' is not three values"),
        ("rotate", "0,0,x", "valid number"),
    ],
)
def test_lists_that_cannot_be_read_are_named(key: str, value: str, says: str) -> None:
    with pytest.raises(ConfigError, match=rf"(?s)model\.{key}.*{says}.*command line"):
        load(None, given(**{key: value}), {})


def test_lists_are_written_as_after_an_option() -> None:
    written = {"rotate": "0, 0,90", "offset": "1cm,0,0"}
    job = load(None, {"model": written, "pipeline": {"stages": "gi, dof"}}, {})
    assert job.model.rotate == (0, 0, 90) and job.model.offset == (0.01, 0, 0)
    assert job.pipeline.stages == ["gi", "dof"]


def test_an_option_and_a_setting_of_one_key_are_refused() -> None:
    options = [*section_overrides({**NOTHING, "fit": "15cm"})]
    assert overrides(options, ["model.scale=1"])["model"] == {
        "fit": "15cm",
        "scale": 1,
    }
    with pytest.raises(ConfigError, match=r"both give model\.fit"):
        overrides(options, ["model.fit=16cm"])


def test_settings_of_the_command_line() -> None:
    assert parse_setting("output.crf=20") == (("output", "crf"), 20)
    assert parse_setting("raster.backend=rays") == (("raster", "backend"), "rays")
    assert parse_setting("a.b.c=[1, 2]") == (("a", "b", "c"), [1, 2])
    for bad in ("crf=20", "output.crf", "=1", ".x=1"):
        with pytest.raises(ConfigError, match=r"STAGE\.KEY=VALUE"):
            parse_setting(bad)


def test_a_set_key_of_many_parts_is_refused() -> None:
    with pytest.raises(ConfigError, match="5000 parts"):
        parse_setting(".".join("a" * 5000) + "=1")
