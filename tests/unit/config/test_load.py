from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pydantic import field_validator

from arfx.config.given import parse_setting
from arfx.config.load import load
from arfx.config.sections import frozen, settings
from arfx.core.settings import Settings, from_dataclass, setting
from arfx.core.stage import Stage
from arfx.core.toml_text import line_of, to_toml
from arfx.errors import ConfigError, InputError


class Lens(Settings):
    formula: str = "corrected"
    aperture: float = setting(2.0, "f-number", ge=0, le=1e6)
    blades: int = setting(6, "0 = round")
    name: str = "a"

    @field_validator("blades")
    @classmethod
    def _blades(cls, value: int) -> int:
        if value < 3:
            raise ConfigError(f"must be 3 or more, is {value}", "three")
        return value


class PrintedLens(Lens):
    formula: str = "paper"
    near_m: float = 0.0


@dataclass(frozen=True)
class OldGrain:
    """strength : as older plug-ins write their settings"""

    strength: float = 0.5

    def __post_init__(self) -> None:
        if self.strength > 1:
            raise ConfigError(
                f"grain.strength must be at most 1, is {self.strength}", "1"
            )


TABLE = {"dof": {"corrected": Lens, "paper": PrintedLens}}
GOOD = """[input]
clip = "clip.mp4"
end = "1.5s"

[[marker]]
spec = "36h11:3:165mm"

[[marker]]
spec = "36h11:4:165.1mm"

[model]
file = "m odel.glb"
fit = "15cm"
offset = ["1cm", "0m", "2mm"]

[dof]
aperture = 4
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "job.toml"
    path.write_text(text)
    return path


def test_a_job_is_read_with_paths_relative_to_its_file(tmp_path: Path) -> None:
    job = load(write(tmp_path, GOOD), {}, TABLE)
    assert (
        job.input.clip == tmp_path / "clip.mp4"
        and job.model.file == tmp_path / "m odel.glb"
    )
    assert job.markers[1].size_m == pytest.approx(
        0.1651
    ) and job.model.offset == pytest.approx((0.01, 0, 0.002))
    assert job.input.end == 1.5 and job.params["dof"] == Lens(aperture=4.0)


def test_every_path_is_relative_to_the_file_that_names_it(tmp_path: Path) -> None:
    class Sky(Settings):
        picture: Path | None = None

    tree: dict = {"sky": {"picture": "a"}}
    for s in settings():
        if Path in s.kinds:
            tree.setdefault(s.section, {})[s.key] = "a"
    assert len(tree["input"]) >= 5 and {"path"} == tree["output"].keys()
    kept = frozen(
        load(
            write(tmp_path, to_toml(tree)),
            {},
            {"sky": {"corrected": Sky, "other": Sky}},
        )
    )
    assert {
        kept[section][key] for section, table in tree.items() for key in table
    } == {str(tmp_path / "a")}


def test_the_command_line_wins(tmp_path: Path) -> None:
    over = {
        "dof": {"aperture": 1.0},
        "input": {"end": "2s", "clip": "other.mp4"},
        "marker": [{"spec": "4X4_50:0:5cm"}],
    }
    job = load(write(tmp_path, GOOD), over, TABLE)
    assert (
        job.params["dof"].aperture == 1.0
        and job.input.end == 2
        and str(job.input.clip) == "other.mp4"
    )
    assert [m.key for m in job.markers] == ["4X4_50:0"]


def test_a_frozen_job_reads_back_as_the_same_job(tmp_path: Path) -> None:
    job = load(write(tmp_path, GOOD), {}, TABLE)
    text = to_toml(frozen(job))
    again = load(write(tmp_path, text), {}, TABLE)
    assert (
        frozen(again) == frozen(job)
        and tomllib.loads(text)["model"]["fit"] == "0.15m"
    )


def test_a_frozen_job_holds_from_wherever_it_is_read() -> None:
    told = {
        "input": {"clip": "c.mp4", "poses": "poses.txt", "depth": "maps"},
        "pipeline": {"tradeoff": "t.json"},
    }
    kept = frozen(load(None, told, TABLE))
    assert all(
        kept[section][key] == str(Path(path).absolute())
        for section, table in told.items()
        for key, path in table.items()
    )


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("aperture = 4", "apperture = 4", 17, "did you mean 'aperture'?"),
        ("aperture = 4", 'aperture = "wide"', 17, "valid number"),
        ("aperture = 4", "blades = 2", 17, "must be 3 or more"),
        ("[dof]", "[dov]", 16, "did you mean 'dof'?"),
        ("end =", "ende =", 3, "did you mean 'end'?"),
        ('"36h11:4:165.1mm"', '"36h11:4:165.1"', 9, "25mm"),
        ('"15cm"', "15", 13, "is not a length"),
        ('"2mm"]', '"2mm", "1mm"]', 14, "offset"),
    ],
)
def test_errors_point_at_the_line_and_say_what_would_be_right(
    tmp_path: Path, old: str, new: str, line: int, says: str
) -> None:
    with pytest.raises(ConfigError) as e:
        load(write(tmp_path, GOOD.replace(old, new)), {}, TABLE)
    assert f"job.toml:{line}" in str(e.value).splitlines()[1] and says in str(e.value)
    assert e.value.exit_code == 2


def two_files(tmp_path: Path, later: str) -> list[Path]:
    """GOOD, and a later file in a folder of its own."""
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "later.toml").write_text(later)
    return [write(tmp_path, GOOD), tmp_path / "more" / "later.toml"]


def test_of_several_files_the_later_wins_key_by_key(tmp_path: Path) -> None:
    later = (
        '[input]\ncamera = "c.yaml"\nend = "2s"\n[[marker]]\nspec ='
        ' "4X4_50:0:5cm"\n[dof]\nblades = 5\n'
    )
    files = two_files(tmp_path, later)
    job = load(files, {"input": {"start": "1s"}}, TABLE)
    assert (job.input.start, job.input.end, job.params["dof"]) == (
        1.0,
        2.0,
        Lens(aperture=4.0, blades=5),
    ) and job.sources == tuple(files)
    assert (
        job.input.clip == tmp_path / "clip.mp4"
        and job.input.camera == tmp_path / "more" / "c.yaml"
    )
    assert [m.key for m in job.markers] == ["4X4_50:0"], "lists are replaced"
    assert load(files[::-1], {}, TABLE).input.end == 1.5


@pytest.mark.parametrize(
    ("old", "new", "later", "where"),
    [
        ("aperture = 4", "apperture = 4", "[dof]\nblades = 5", "job.toml:17"),
        (
            "aperture = 4",
            "blades = 5",
            "[dof]\naperture = 2\nblades = 2",
            "later.toml:3",
        ),
        ("aperture = 4", "blades = 2", "[dof]\naperture = 2", "job.toml:17"),
        ('"15cm"', '"15"', "[input]\nend = 2\n[model]\nup = 'z'", "job.toml:13"),
        ('"15cm"', '"15"', "[model]\nfit = '15'", "later.toml:2"),
        ('spec = "36h11:4:165.1mm"', "", "[model]\nup = 'z'", "job.toml:8"),
        ("aperture", "aperture", "dof = 3", "later.toml:1"),
        ("[dof]", "[dov]", "[dof]\nblades = 5", "job.toml:16"),
    ],
)
def test_of_several_files_errors_name_the_one_that_is_wrong(
    tmp_path: Path, old: str, new: str, later: str, where: str
) -> None:
    files = two_files(tmp_path, later)
    files[0].write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError) as e:
        load(files, {}, TABLE)
    assert f"{where}\n" in f"{e.value}\n" and str(e.value).count(" --> ") == 1, (
        e.value
    )


def test_all_errors_are_told_at_once_and_the_command_line_is_named(
    tmp_path: Path,
) -> None:
    text = GOOD.replace("aperture", "apperture").replace("end =", "ende =")
    with pytest.raises(ConfigError) as e:
        load(write(tmp_path, text), {"pipeline": {"quality": "best"}}, TABLE)
    message = str(e.value)
    assert (
        "apperture" in message
        and "ende" in message
        and "command line: pipeline.quality" in message
    )


def test_the_formula_chooses_the_settings(tmp_path: Path) -> None:
    printed = {"formula": "paper", "near_m": 1, "blades": 5}
    job = load(None, {"dof": printed}, TABLE)
    assert type(job.params["dof"]) is PrintedLens and job.params[
        "dof"
    ] == PrintedLens(blades=5, near_m=1.0)
    assert frozen(load(None, {"dof": frozen(job)["dof"]}, TABLE)) == frozen(job)
    assert (
        type(load(None, {"dof": {"formula": "corrected"}}, TABLE).params["dof"])
        is Lens
    )
    for table, says in (
        (
            {"near_m": 1},
            (
                'dof.near_m belongs to formula = "paper"\n  --> command line:'
                ' dof.near_m\nhelp: dof.formula is "corrected"'
            ),
        ),
        (
            {"formula": "papper"},
            (
                "dof.formula 'papper' is unknown\n  --> command line: dof.formula\nhelp:"
                " one of corrected, paper"
            ),
        ),
        ({"formula": [1]}, "one of corrected, paper"),
    ):
        with pytest.raises(ConfigError, match=re.escape(says)):
            load(None, {"dof": table}, TABLE)


def test_settings_of_an_older_plug_in_may_be_a_dataclass(tmp_path: Path) -> None:
    class Grain(Stage):
        name, Params = "grain", OldGrain

        def run(self, view: Any, prepared: Any) -> dict:
            return {}

    table = {"grain": {"corrected": Grain.Params}}
    file = write(tmp_path, "[grain]\nstrength = 0.25\n")
    job = load(file, {}, table)
    assert job.params["grain"].strength == 0.25 and frozen(job)["grain"] == {
        "strength": 0.25
    }
    assert Grain().params.strength == 0.5
    for given, says in (
        ("strenght = 1", r"\[grain\] has no setting 'strenght'\n.*:2\n.*'strength'"),
        (
            "strength = 2",
            r"grain.strength must be at most 1, is 2.0\n.*job.toml:1\nhelp: 1",
        ),
        ('strength = "a"', r"grain.strength: .*valid number.*\n.*:2"),
    ):
        with pytest.raises(ConfigError, match=says):
            load(write(tmp_path, f"[grain]\n{given}\n"), {}, table)


def test_unreadable_and_invalid_files() -> None:
    with pytest.raises(InputError, match=r"none\.toml"):
        load(Path("none.toml"), {}, TABLE)


def test_invalid_toml(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not valid TOML"):
        load(write(tmp_path, "[a\n"), {}, TABLE)


def test_line_of_falls_back_to_the_nearest_parent() -> None:
    assert line_of(GOOD, ("marker", 1, "spec")) == 9
    assert line_of(GOOD, ("marker", 1)) == 8
    assert line_of(GOOD, ("dof", "blades")) == 16
    assert line_of(GOOD, ("nothing",)) == 0


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e300, 10**15])
def test_numbers_that_no_setting_can_have_are_refused_with_their_own_name(
    tmp_path: Path, value: float
) -> None:
    with pytest.raises(ConfigError) as e:
        load(None, {"dof": {"aperture": value}}, TABLE)
    assert "dof.aperture" in str(e.value) and "command line" in str(e.value)
    shown = (
        str(value) if math.isfinite(value) else f"{value}".replace("Infinity", "inf")
    )
    with pytest.raises(ConfigError) as e:
        load(
            write(tmp_path, GOOD.replace("aperture = 4", f"aperture = {shown}")),
            {"dof": {"blades": 5}},
            TABLE,
        )
    assert "dof.aperture" in str(e.value) and "job.toml:17" in str(e.value)


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "9" * 5000,
        "x = " + "[" * 2000,
        ".".join("a" * 200) + " = 1",
        "[input]\nend = 1979-99-99",
    ],
)
def test_toml_beyond_what_a_job_holds_is_one_message(
    tmp_path: Path, text: str
) -> None:
    with pytest.raises(ConfigError, match=r"job\.toml: not valid TOML") as e:
        load(write(tmp_path, text), {}, TABLE)
    assert len(str(e.value)) < 300
    if text.startswith("x"):
        with pytest.raises(ConfigError, match="--set"):
            parse_setting("dof.aperture=" + text[4:])


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("model", "scale", 1e300), ("model", "scale", 1e-300), ("model", "rotate", [1e300, 0, 0]), ("model", "fit", "1e300m"), ("model", "fit", "-5cm"), ("model", "fit", "0cm"),
        ("model", "offset", ["1e300m", "0m", "0m"]), ("input", "end", "9" * 400), ("input", "end", "9" * 5000 + ":00"),
        ("input", "start", "1e300"), ("input", "depth_scale", 1e-300), ("pipeline", "seed", 2**64), ("pipeline", "fps", 1e300),
        ("output", "crf", -1e300), ("pipeline", "budget", "9" * 400 + "h"),
    ],
)  # fmt: skip
def test_sections_refuse_absurd_numbers_by_name(
    section: str, key: str, value: object
) -> None:
    with pytest.raises(ConfigError, match=rf"{section}\.{key}"):
        load(None, {section: {key: value}}, TABLE)


def test_what_a_check_of_a_stage_refuses_is_told_beside_all_else(
    tmp_path: Path,
) -> None:
    text = GOOD + 'blades = 2\nname = 3\nnear = 1\n[[marker]]\nspec = "x"\n'
    with pytest.raises(ConfigError) as e:
        load(
            write(tmp_path, text.replace("aperture = 4", "aperture = -1")), {}, TABLE
        )
    for line, says in (
        (17, "dof.aperture: Input should be greater than or equal to 0, is -1"),
        (18, "dof.blades: must be 3 or more, is 2"),
        (19, "dof.name: Input should be a valid string, is 3"),
        (20, "[dof] has no setting 'near'"),
        (22, "marker.2.spec: marker 'x' is not FAMILY:ID:SIZE"),
    ):
        assert f"{says}\n  --> {tmp_path / 'job.toml'}:{line}" in str(e.value)


@pytest.mark.parametrize("key", ["aperture", "blades"])
def test_a_flag_is_no_number(key: str) -> None:
    with pytest.raises(ConfigError, match=rf"dof\.{key}: must be a number, is true"):
        load(None, {"dof": {key: True}}, TABLE)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_settings_of_a_dataclass_are_finite(value: float) -> None:
    table = {"grain": {"corrected": from_dataclass(OldGrain)}}
    with pytest.raises(ConfigError, match=r"grain\.strength: .*finite"):
        load(None, {"grain": {"strength": value}}, table)


def test_a_table_of_a_stage_that_cannot_be_loaded_says_why(tmp_path: Path) -> None:
    why = ConfigError("stage 'mist' of one 1.2 cannot be loaded", "uninstall it")
    file = write(tmp_path, "[mist]\ndensity = 1\n")
    with pytest.raises(
        ConfigError, match=r"(?s)mist.*cannot be loaded.*job.toml.*unin"
    ):
        load(file, {}, TABLE, {"mist": why})
    with pytest.raises(ConfigError, match="no section or stage 'mist'"):
        load(file, {}, TABLE)
