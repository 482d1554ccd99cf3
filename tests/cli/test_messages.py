"""What every command says: a result on standard output, the rest on standard error, more
with -v, only warnings with -q.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import click
import cv2
import pytest

from arfx.core import lens
from arfx_cli.main import COMMANDS, cli, main
from tests.cli.conftest import Material, Result, Run
from tests.unit.calibrate.boards import CHESS, poses, render

SCENE = """
[clip]
width = 160
height = 120
[[shot]]
frames = 4
path = { kind = "orbit", radius_m = "38cm", azimuth_deg = [-105, -85], elevation_deg = [48, 52] }
[[plane]]
position_m = [0, 0, "-0.2mm"]
[[marker]]
spec = "36h11:3:100mm"
[model]
shape = "block"
fit = "6cm"
"""


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_takes_json_verbose_and_quiet(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    flags = {flag for p in command.params for flag in p.opts}
    assert {"--json", "-v", "--verbose", "-q", "--quiet"} <= flags


def test_of_several_values_none_is_dropped_in_silence(arfx: Run) -> None:
    for words in (("--model", "b.glb"), ("--model=b.glb",)):
        r = arfx("process", "clip.mp4", "--model", "a.glb", *words)
        assert "note: --model takes one value and is given 2: b.glb is used" in r.err
    r = arfx("process", "clip.mp4", "-oa.mp4", "-o", "b.mp4")
    assert "--output takes one value and is given 2: b.mp4 is used" in r.err
    r = arfx(
        "plan",
        "no.mp4",
        "--crf",
        "20",
        "--set",
        "a.b=1",
        "--set",
        "a.c=1",
    )
    assert "takes one value" not in r.err


@pytest.fixture(scope="module")
def place(material: Material, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands below work on."""
    folder = tmp_path_factory.mktemp("messages")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "tolerance.toml").write_text('[truth.max]\n"arfx.flips" = 4\n')
    (folder / "board").mkdir()
    for i, pose in enumerate(poses(6)):
        cv2.imwrite(
            str(folder / "board" / f"p{i:02d}.png"), render(CHESS, pose, seed=i)
        )
    return folder


def says(arfx: Run, place: Path, detail: str, *arguments: str) -> Result:
    """-v adds `detail` on standard error, -q leaves only warnings there, --json is all of
    standard output: that is returned.
    """
    loud = arfx(*arguments, "-v", cwd=place)
    assert loud.code == 0 and detail in loud.err and detail not in loud.out, loud.err
    again = (*arguments, *(["--overwrite"] if "-o" in arguments else []))
    still = arfx(*again, "--quiet", "--json", cwd=place)
    assert still.code == 0 and json.loads(still.out)
    assert all(line.startswith("note: ") for line in still.err.splitlines()), (
        still.err
    )
    return still


def test_target(arfx: Run, place: Path) -> None:
    says(
        arfx,
        place,
        "36h11:3:100mm: 100 x 100 mm of black, ",
        "target",
        "36h11:3:100mm",
        "-o",
        "m.svg",
    )


def test_inspect(arfx: Run, place: Path, material: Material) -> None:
    says(
        arfx,
        place,
        "frames searched: 0, 35",
        "inspect",
        str(material.clip),
        "--samples",
        "2",
    )


def test_doctor(arfx: Run, place: Path) -> None:
    says(arfx, place, "FFmpeg: libavutil", "doctor")


def test_bench(arfx: Run, place: Path) -> None:
    says(
        arfx,
        place,
        "ns/px, median of",
        "bench",
        "--stage",
        "composite",
        "--level",
        "standard",
        "--size",
        "160x120",
    )


def test_calibrate_and_a_calibration_that_is_not_good_is_a_warning_with_quiet(
    arfx: Run, place: Path
) -> None:
    r = says(
        arfx,
        place,
        "held out",
        "calibrate",
        "board",
        "--board",
        "chessboard:9x6:25mm",
        "-o",
        "c.yaml",
    )
    assert r.json["verdict"] in ("usable", "poor")
    assert f"note: the calibration is {r.json['verdict']}" in r.err


def test_synth_and_verify(arfx: Run, place: Path) -> None:
    says(
        arfx,
        place,
        "marker 36h11:3: in sight in 4 of 4 frames",
        "synth",
        "scene.toml",
        "-o",
        "out",
    )
    (place / "out" / "tolerance.toml").write_text('[truth.max]\n"arfx.flips" = 4\n')
    says(arfx, place, "bound: arfx.flips at most 4", "verify", "out")


def test_plan(arfx: Run, place: Path, material: Material) -> None:
    more = ("--end", "0.2", "--codec", "h264", "--crf", "20")
    says(
        arfx,
        place,
        "frames 0–6: raster standard",
        "plan",
        *material.arguments(*more)[1:],
    )


def test_process_and_report(arfx: Run, place: Path, material: Material) -> None:
    says(
        arfx,
        place,
        "stage raster: 7 frames",
        *material.arguments("--end", "0.2", "-o", "out.mp4", "--job", "job"),
    )
    says(arfx, place, "seconds: decode", "report", "job", "-o", "report")


def test_demo(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With a shorter and smaller clip than its own, which takes minutes to make."""
    from arfx.synth import description

    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    monkeypatch.setattr(description, "DEMO_SCENE", tmp_path / "scene.toml")
    with pytest.raises(SystemExit) as e:
        main(["demo", "--json", "-v"])
    out, err = capsys.readouterr()
    assert e.value.code == 0 and "stage raster: 4 frames" in err, err
    document = json.loads(out)
    assert {"picture", "clip_before", "clip_after", "report"} == document.keys() - {
        "job"
    }
    assert all(
        (tmp_path / document[name]).is_file() for name in document.keys() - {"job"}
    )
    assert document["job"]["output"]["frames"] == 4
    with pytest.raises(SystemExit):
        main(["demo", "--overwrite", "-q"])
    out, err = capsys.readouterr()
    assert "demo/picture.png" in out and all(
        line.startswith("note: ") for line in err.splitlines()
    ), err


def test_the_options_of_the_codec_reach_the_output(
    arfx: Run, place: Path, material: Material
) -> None:
    more = (
        "--codec",
        "ffv1",
        "--pixel-format",
        "yuv444p",
        "--end",
        "0.1",
        "-o",
        "lossless.mkv",
        "--json",
    )
    r = arfx(*material.arguments(*more), cwd=place)
    assert r.code == 0, r.err
    assert (r.json["output"]["codec"], r.json["output"]["pixel_format"]) == (
        "ffv1",
        "yuv444p",
    )


def test_verbose_and_quiet_contradict_each_other(arfx: Run) -> None:
    r = arfx("doctor", "-v", "-q")
    assert r.code == 2 and "--verbose and --quiet" in r.err and not r.out


def test_a_fault_of_arfx_is_one_message_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from arfx.measure import machine

    def fail(_: Path) -> None:
        raise KeyError("a fault")

    monkeypatch.setattr(machine, "examine", fail)
    monkeypatch.delenv("ARFX_DEBUG", raising=False)
    with pytest.raises(SystemExit) as e:
        main(["doctor"])
    err = capsys.readouterr().err
    assert (
        e.value.code == 5
        and err.startswith("error: arfx failed: KeyError: 'a fault'")
        and "ARFX_DEBUG=1" in err
    )
    monkeypatch.setenv("ARFX_DEBUG", "1")
    with pytest.raises(KeyError):
        main(["doctor"])


def test_terminated_leaves_no_temporary_folder(tmp_path: Path) -> None:
    code = (
        "import os, signal, tempfile, time\nfrom arfx_cli import main as m\n"
        "def work(**_):\n with tempfile.TemporaryDirectory(prefix='arfx-'):\n"
        "  os.kill(os.getpid(), signal.SIGTERM); time.sleep(30)\n"
        "m.cli.main = work\nm.main([])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        check=False,
    )
    assert done.returncode == 143 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("raised", [EOFError("Ran out of input"), SystemExit(0)])
def test_what_a_library_raises_is_neither_an_interruption_nor_success(
    raised: BaseException,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(**_: object) -> None:
        raise raised

    monkeypatch.setattr("arfx_cli.doctor.command.callback", fail)
    with pytest.raises(SystemExit) as ended:
        main(["doctor"])
    assert (
        ended.value.code == 5
        and f"arfx failed: {type(raised).__name__}" in capsys.readouterr().err
    )


def test_what_is_printed_on_the_way_does_not_spoil_json(
    arfx: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "arfx.papers.s2_lens.printed_limits",
        lambda *_: print("hello") or lens.depth_of_field(*_),
    )
    r = arfx(
        "lens", "--focal", "50mm", "--fnumber", "2.8", "--distance", "2m", "--json"
    )
    assert r.json["fnumber"] == 2.8 and "hello" in r.err


def test_the_shell_completes_without_an_error() -> None:
    asked = {
        "_ARFX_COMPLETE": "bash_complete",
        "COMP_WORDS": "arfx pro",
        "COMP_CWORD": "1",
    }
    done = subprocess.run(
        [sys.executable, "-m", "arfx_cli"],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "process" in done.stdout
