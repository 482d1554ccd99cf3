"""Help answers for every command, and a wrong word gets the nearest right one."""

from __future__ import annotations

from pathlib import Path

import pytest

from arfx_cli.main import COMMANDS
from tests.cli.conftest import Run


def test_help_lists_every_command_and_the_exit_codes(arfx: Run) -> None:
    r = arfx("--help", apart=True)
    assert r.code == 0 and not r.err
    assert all(f"  {name} " in r.out for name in COMMANDS)
    assert "Exit codes: 0 done" in r.out
    assert arfx("-h").out == r.out


def test_the_version_is_the_packages(arfx: Run) -> None:
    from arfx import __version__

    assert arfx("--version", apart=True).out.split()[-1] == __version__


@pytest.mark.parametrize(
    ("word", "near"),
    [("proces", "process"), ("inpsect", "inspect"), ("docter", "doctor")],
)
def test_a_misspelt_command_gets_the_nearest(arfx: Run, word: str, near: str) -> None:
    r = arfx(word)
    assert (
        r.code == 2 and "Did you mean" in r.err and f"'{near}'" in r.err and not r.out
    )


def test_an_unknown_option_is_a_usage_error(arfx: Run) -> None:
    r = arfx("inspect", "--nonsense")
    assert r.code == 2 and "--nonsense" in r.err and "Traceback" not in r.err


def test_a_number_below_zero_is_the_value_of_its_option(arfx: Run) -> None:
    r = arfx("plan", "--crf", "-5000")
    assert r.code == 2 and "output.crf" in r.err and "-1000" in r.err


def test_every_config_that_is_given_counts(arfx: Run, tmp_path: Path) -> None:
    (tmp_path / "first.toml").write_text('[model]\nfit = "15"\n')
    (tmp_path / "second.toml").write_text("[dof]\nfnumbr = 2\n")
    r = arfx(
        "plan",
        "--config",
        "first.toml",
        "--config",
        "second.toml",
        "--config",
        "final",
    )
    assert (
        r.code == 2
        and "first.toml:2" in r.err
        and "second.toml:2" in r.err
        and "Traceback" not in r.err
    ), r.err


def test_help_says_what_the_pipeline_auto_is(arfx: Run) -> None:
    from arfx.config.load import load
    from arfx.run.parameters import parameters, pipeline

    text = " ".join(arfx("process", "--help").out.split())
    assert (
        "Default auto: those that the job has a setting for. Light and shadow always run."
        in text
    )
    usual, lens, printed = (
        pipeline(load(None, tree, parameters()))
        for tree in ({}, {"dof": {"fnumber": 4}}, {"dof": {"formula": "paper"}})
    )
    assert (
        "lightmap" in usual and {*lens} - {*usual} == {"dof"} and printed == usual
    ), "a formula alone asks for no effect"
