from __future__ import annotations

from pathlib import Path

import pytest

from arfx.core.naming import fixed_folder, has_field, named
from arfx.errors import ConfigError


def test_fields_are_the_sources_names(tmp_path: Path) -> None:
    folder = tmp_path / "day.1"
    folder.mkdir()
    assert named(Path("out/{parent}/{stem}_ar.mp4"), folder / "a b.ü.mov") == Path(
        "out/day.1/a b.ü_ar.mp4"
    )
    assert named(Path("cameras/{stem}.yaml"), folder) == Path("cameras/day.1.yaml"), (
        "a folder's name has no ending"
    )
    assert named(Path("{{x}}.mp4"), folder) == Path("{x}.mp4")


def test_the_parent_is_the_folders_own_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "day" / "cuts").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "day" / "cuts")
    assert named(Path("{parent}"), Path("a.mp4")) == Path("cuts") and named(
        Path("{parent}"), Path("../a.mp4")
    ) == Path("day")


def test_a_percent_sign_in_a_numbered_name_is_kept(tmp_path: Path) -> None:
    """Red where the stem goes into the format as it is: "50%d" would be a second number."""
    out = named(Path("{stem}/{stem}_%04d.png"), tmp_path / "50%d.mp4", numbered=True)
    assert out.parent.name == "50%d" and out.name % 7 == "50%d_0007.png"


@pytest.mark.parametrize(
    "pattern",
    [
        "{clip}.mp4",
        "{stem!r}.mp4",
        "{stem:>9}.mp4",
        "{stem.name}.mp4",
        "{}.mp4",
        "{stem.mp4",
        "a}.mp4",
    ],
)
def test_other_fields_are_refused(pattern: str) -> None:
    with pytest.raises(ConfigError, match="-o") as e:
        has_field(Path("out") / pattern)
    assert "{stem}" in e.value.hint and "{parent}" in e.value.hint


def test_the_folder_of_all_outputs() -> None:
    assert (
        fixed_folder(Path("out/{stem}.mp4"))
        == Path("out")
        == fixed_folder(Path("out/{stem}/{parent}/x.mp4"))
    )
    assert fixed_folder(Path("{stem}.mp4")) == Path() and fixed_folder(
        Path("a/b.mp4")
    ) == Path("a")


def test_a_source_without_a_name_for_a_field_is_refused() -> None:
    """A clip called "...mp4" would have its output go into the folder above."""
    with pytest.raises(ConfigError, match=r"\{stem\}, which is '\.\.'"):
        named(Path("out/{stem}/x.mp4"), Path("clips/...mp4"))
    with pytest.raises(ConfigError, match=r"\{parent\}, which is ''"):
        named(Path("{parent}.mp4"), Path("/a.mp4"))
