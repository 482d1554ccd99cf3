"""Tables of a batch: what each job gets, and messages with file, line and key."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from arfx.config.load import load
from arfx.config.manifest import read_manifest
from arfx.config.sections import JobConfig
from arfx.errors import ConfigError, InputError
from arfx.run.parameters import parameters

TOML = """
[model]
file = "duck.glb"
fit = "15cm"

[[job]]
clip = "a b.mp4"

[[job]]
clip = "sub/ü.mov"
output = "{stem}.mkv"
fit = "10cm"
marker = ["36h11:3:165mm", "36h11:4:165mm"]
rotate = [0, 0, 90]
[job.light]
most_lights = 1
[job.model]
up = "z"
"""
CSV = """clip,camera,output,marker,fit,light.most_lights,offset,pipeline.skip
"a, b.mp4",left.yaml,,36h11:3:165mm,10cm,1,"0cm,2cm,0cm",

sub/ü.mov,,x.mkv,,,,,false
"""


def read(
    path: Path, text: str, over: dict[str, Any] | None = None
) -> list[JobConfig]:
    path.write_text(text, encoding="utf-8")
    return [
        load(files, over or {}, parameters())
        for files in read_manifest(path, parameters())
    ]


def test_a_job_is_laid_over_what_all_share(tmp_path: Path) -> None:
    first, second = read(tmp_path / "m.toml", TOML)
    assert (
        first.input.clip == tmp_path / "a b.mp4"
        and first.model.fit == 0.15
        and first.model.file == tmp_path / "duck.glb"
    )
    assert first.output.path is None and not first.markers
    assert (
        second.input.clip == tmp_path / "sub/ü.mov"
        and second.output.path == tmp_path / "{stem}.mkv"
    )
    assert (
        second.model.fit == 0.1
        and second.model.up == "z"
        and second.model.rotate == (0, 0, 90)
    )
    assert [m.key for m in second.markers] == [
        "36h11:3",
        "36h11:4",
    ] and second.params["light"].most_lights == 1
    assert second.sources == (tmp_path / "m.toml",)


def test_the_command_line_wins(tmp_path: Path) -> None:
    jobs = read(tmp_path / "m.toml", TOML, {"model": {"fit": "1cm"}})
    assert [job.model.fit for job in jobs] == [0.01, 0.01]


@pytest.mark.parametrize("suffix", ["toml", "csv"])
def test_a_job_may_have_a_job_file(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "orbit").mkdir()
    (tmp_path / "orbit/job.toml").write_text(
        "[input]\nclip = 'clip.mp4'\n[model]\nfit = '3cm'\nup = 'x'\n"
    )
    toml = "[[job]]\nconfig = ['lossless', 'orbit/job.toml']\nfit = '4cm'\n"
    (job,) = read(
        tmp_path / f"m.{suffix}",
        toml if suffix == "toml" else "config,fit\norbit/job.toml,4cm\n",
    )
    assert (
        job.input.clip == tmp_path / "orbit/clip.mp4"
        and job.model.fit == 0.04
        and job.model.up == "x"
    )
    assert (job.output.codec == "ffv1") == (
        suffix == "toml"
    ) and tmp_path / "orbit/job.toml" in job.sources


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_columns_are_options_and_settings(tmp_path: Path, separator: str) -> None:
    text = (
        CSV
        if separator == ","
        else CSV.replace("a, b", "a b")
        .replace('"0cm,2cm,0cm"', "0cm/2cm/0cm")
        .replace(",", separator)
    )
    first, second = read(
        tmp_path / "m.csv", text.replace("0cm/2cm/0cm", "0cm,2cm,0cm")
    )
    assert (
        first.input.camera == tmp_path / "left.yaml"
        and first.model.fit == 0.1
        and first.model.offset == (0, 0.02, 0)
    )
    assert (
        first.params["light"].most_lights == 1
        and first.markers[0].key == "36h11:3"
        and first.output.path is None
    )
    assert first.pipeline.skip and not second.pipeline.skip
    assert (
        second.input.clip == tmp_path / "sub/ü.mov"
        and second.output.path == tmp_path / "x.mkv"
        and second.model.fit is None
    )


def test_a_name_that_reads_as_a_number_stays_a_name(tmp_path: Path) -> None:
    (job,) = read(tmp_path / "m.csv", "clip,output\n1,true\n")
    assert job.input.clip == tmp_path / "1" and job.output.path == tmp_path / "true"


WRONG = {
    "m.toml: no job": ("m.toml", "[model]\nfit = '1cm'\n", ["holds no [[job]]", "--config"]),
    "m.toml: one table": ("m.toml", "[job]\nclip = 'a'\n", ["'job' must be tables", "m.toml:1"]),
    "m.toml: syntax": ("m.toml", "[[job]\n", ["not valid TOML"]),
    "m.toml: no clip": ("m.toml", "[[job]]\nclip = 'a'\n\n[[job]]\nfit = '1cm'\n", ["no clip is named", "m.toml:4"]),
    "m.toml: unknown": ("m.toml", "[[job]]\nclip = 'a'\nfitt = '1cm'\n", ["no setting 'fitt'", "m.toml:3", "did you mean 'fit'"]),
    "m.toml: in a section": (
        "m.toml", "[[job]]\nclip='a'\n[[job]]\nclip='b'\n[job.model]\nfitt = 1\n", ["no setting 'fitt'", "m.toml:6", "'fit'"]
    ),
    "m.toml: a value": ("m.toml", "[[job]]\nclip='a'\nfit = '15'\n[[job]]\nclip='b'\n", ["model.fit", "a length", "m.toml:1"]),
    "m.toml: twice": ("m.toml", "[[job]]\nclip='a'\nfit='1cm'\nmodel={fit='2cm'}\n", ["model.fit is given twice", "m.toml:4"]),
    "m.toml: config": ("m.toml", "[[job]]\nclip='a'\nconfig = 3\n", ["config must be", "m.toml:3"]),
    "m.toml: three values": ("m.toml", "[[job]]\nclip='a'\noffset = '1cm'\n", ["model.offset", "is not three values", "m.toml:1"]),
    "m.csv: no rows": ("m.csv", "clip,fit\n\n", ["no row"]),
    "m.csv: unknown": ("m.csv", "clip,fitt\na,1cm\nb,2cm\n", ["no setting 'fitt'", "m.csv:1", "did you mean 'fit'"]),
    "m.csv: a value": ("m.csv", "clip,fit\na,1cm\n\nb,15\n", ["model.fit", "not a length", "m.csv:4"]),
    "m.csv: a stage's": ("m.csv", "clip,dof.fnumbr\na,2\n", ["[dof] has no setting 'fnumbr'", "m.csv:2", "'fnumber'"]),
    "m.csv: too many cells": ("m.csv", "clip,fit\na,1cm,x\n", ["3 cells under 2 heads", "m.csv:2"]),
    "m.csv: two columns": ("m.csv", "clip,clip\na,b\n", ["column 'clip' is there twice", "m.csv:1"]),
    "m.csv: quote": ("m.csv", 'clip,fit\na,"1cm\n', ["not valid CSV", "m.csv:2"]),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_with_file_line_and_key(
    tmp_path: Path, name: str
) -> None:
    file, text, parts = WRONG[name]
    with pytest.raises(ConfigError) as e:
        read(tmp_path / file, text)
    assert all(part in str(e.value) for part in parts), e.value


def test_a_column_that_is_wrong_in_every_row_is_said_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as e:
        read(tmp_path / "m.csv", "clip,fitt\n" + "a,1\n" * 50)
    assert str(e.value).count("fitt") == 1


def test_many_problems_are_counted(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as e:
        read(tmp_path / "m.csv", "clip,fit\n" + ",1cm\n" * 50)
    assert "and 40 more" in str(e.value)


def test_a_manifest_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_manifest(tmp_path / "none.csv", parameters())


@pytest.mark.parametrize("name", ["m.csv", "m.toml"])
def test_a_misspelt_head_of_20000_rows_is_told_within_seconds(
    tmp_path: Path, name: str
) -> None:
    rows = range(20_000)  # each looked the whole table through: minutes
    csv = "clip,outptu\n" + "".join(f"c{i}.mp4,o{i}.mp4\n" for i in rows)
    toml = "".join(f'[[job]]\nclip = "c{i}.mp4"\noutptu = "o{i}.mp4"\n' for i in rows)
    began = time.process_time()
    with pytest.raises(ConfigError, match="did you mean 'output'"):
        read(tmp_path / name, csv if name == "m.csv" else toml)
    assert time.process_time() - began < 5
