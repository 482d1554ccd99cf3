"""A setting that is gone is an error that says what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from arfx.config.load import GONE, load
from arfx.errors import ConfigError
from arfx.run.parameters import parameters


@pytest.mark.parametrize(
    ("section", "key"),
    [(section, key) for section, keys in GONE.items() for key in keys],
)
def test_a_setting_that_is_gone_is_told_with_its_line_and_what_replaces_it(
    section: str, key: str, tmp_path: Path
) -> None:
    usual = next(iter(parameters()[section].values()))
    assert key not in usual.model_fields, (
        "it is a setting again: take it off the list"
    )
    file = tmp_path / "job.toml"
    file.write_text(
        f'[input]\nclip = "clip.mp4"\n\n[{section}]\n{key} = 1\n', encoding="utf-8"
    )
    with pytest.raises(ConfigError) as error:
        load(file, {}, parameters())
    text = str(error.value)
    assert (
        f"has no setting {key!r}" in text
        and "job.toml:5" in text
        and GONE[section][key] in text
    )
