from __future__ import annotations

from pathlib import Path

import pytest

from arfx.config.load import find_job_file, load, presets
from arfx.errors import InputError
from arfx.run.parameters import parameters


@pytest.mark.parametrize("name", sorted(presets()))
def test_every_preset_loads(name: str) -> None:
    load(find_job_file(Path(name)), {}, parameters())


def test_presets_are_found_by_name_and_typos_are_answered() -> None:
    assert {"preview", "final", "lossless"} <= set(presets())
    with pytest.raises(InputError, match="did you mean 'preview'"):
        find_job_file(Path("preveiw"))


def test_a_name_that_cannot_be_looked_up_is_no_preset() -> None:
    with pytest.raises(InputError, match="no job file or preset"):
        find_job_file(Path("n" * 300))
