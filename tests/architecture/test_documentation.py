"""What is promised in help, settings and files is there."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest
from annotated_types import Ge, Gt

from arfx.core.stage import Stage
from arfx.run.catalogue import page
from arfx.run.parameters import parameters
from arfx.stages import STAGES
from arfx_cli.main import COMMANDS, EXIT_CODES, cli
from tests.architecture.test_wheel import project_files

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_help_with_a_real_example(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None and command.help
    assert "Example:" in command.help and f"arfx {name}" in command.help
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{name} {parameter.opts[0]} has no help"


@pytest.mark.parametrize("section", sorted(parameters()))
def test_every_setting_is_documented(section: str) -> None:
    for kind in parameters()[section].values():
        for key, field in kind.model_fields.items():
            assert key == "formula" or field.description, (
                f"{section}.{key} has no text"
            )
            bounded = {type(limit) for limit in field.metadata} & {Ge, Gt}
            assert bounded or field.annotation not in (int, float), (
                f"{section}.{key}: limits"
            )
        assert kind.model_config["frozen"]


@pytest.mark.parametrize("name", sorted(STAGES))
def test_every_stage_keeps_the_contract_by_type(name: str) -> None:
    stage = STAGES[name]()
    assert isinstance(stage, Stage) and stage.name == name and stage.levels


def test_the_page_of_stages_is_what_the_stages_say() -> None:
    assert (ROOT / "docs" / "stages.md").read_text(encoding="utf-8") == page(), (
        "arfx stages all > docs/stages.md"
    )


def test_exit_codes_agree_with_the_errors() -> None:
    from arfx import errors

    codes = {
        e.exit_code
        for e in vars(errors).values()
        if isinstance(e, type) and issubclass(e, errors.ArfxError)
    }
    assert codes <= {int(c) for c in re.findall(r"\b(\d+)\b", EXIT_CODES)}


def test_readme_names_only_commands_that_exist() -> None:
    text = (ROOT / "README.md").read_text()
    assert text.index("make demo") < 900 and text.index("make test") < 900, (
        "the two commands are on the first screen"
    )
    for name in re.findall(r"^arfx (\w+)", text, re.MULTILINE):
        assert name in COMMANDS
    for target in re.findall(r"^make (\w+)", text, re.MULTILINE):
        assert re.search(
            rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE
        )
    for link in re.findall(r"\]\((?!https:)([^)#]+)\)", text):
        assert (ROOT / link).exists(), f"README links to {link}"


_STILTED = re.compile(
    r"\b(tells?|told|called for|calls? for|dear|stands? in)\b(?! the middle)",
    re.IGNORECASE,
)
_LONGEST = 25  # words of a sentence on the first screen


def test_readme_begins_with_short_sentences() -> None:
    first = "\n".join(
        (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[:40]
    )
    prose = re.sub(
        r"^```.*?^```|^\|.*?$|^#.*?$", ".", first, flags=re.DOTALL | re.MULTILINE
    )
    sentences = [s.split() for s in re.split(r"[.:;!?]\s|\n\n", prose)]
    assert len(sentences) > 10 and not [
        " ".join(s) for s in sentences if len(s) > _LONGEST
    ]


def test_readme_and_help_are_in_plain_words() -> None:
    texts = {"README.md": (ROOT / "README.md").read_text(encoding="utf-8")}
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        texts[name] = command.get_help(click.Context(command, info_name=name))
    assert not [
        f"{name}: {found[0]}"
        for name, text in texts.items()
        if (found := _STILTED.search(text))
    ]


def test_no_machine_paths_in_tracked_files() -> None:
    wrong = re.compile(r"/(?:work|root|home)/\w")
    listed = project_files()
    assert "README.md" in listed and "arfx/errors.py" in listed
    for name in listed:
        path = ROOT / name
        if (
            path.suffix in (".py", ".md", ".toml", ".txt", "")
            and path.is_file()
            and path.name != Path(__file__).name
        ):
            assert not wrong.search(
                path.read_text(encoding="utf-8", errors="ignore")
            ), name


def test_every_sample_scene_is_complete() -> None:
    scenes = sorted(p for p in (ROOT / "sample_scenes").iterdir() if p.is_dir())
    assert len(scenes) >= 8 and sum(p.name.startswith("09") for p in scenes) >= 4
    for scene in scenes:
        assert re.fullmatch(r"\d{4}-[a-z0-9-]+", scene.name)
        for name in ("scene.toml", "expected.png", "tolerance.toml", "README.md"):
            assert (scene / name).is_file(), f"{scene.name} lacks {name}"
