"""What is said of a plug-in's stage and its settings."""

from __future__ import annotations

import pytest
from pydantic import Field

from arfx.config.sections import option_of
from arfx.core.settings import Settings
from arfx.errors import ConfigError
from arfx.run.catalogue import describe
from arfx.stages import STAGES


def test_a_setting_with_marks_of_its_own_has_no_option() -> None:
    class Params(Settings):
        density: float = Field(1.0, json_schema_extra={"unit": "m"})

    assert option_of(Params.model_fields["density"]) == ([], None, "")


def test_a_stage_that_cannot_be_loaded_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wrong = ConfigError("stage 'mist' of two 1.0 cannot be loaded", "uninstall it")
    monkeypatch.setitem(STAGES.__dict__, "broken", {"mist": wrong})
    with pytest.raises(ConfigError, match="cannot be loaded"):
        describe("mist")
    with pytest.raises(ConfigError, match="no stage or section 'must'"):
        describe("must")
