"""Light on the command line: given, from a panorama, refused, and the published formula."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import Material, Run


def panorama(path: Path) -> Path:
    sky = np.full((32, 64, 3), 0.3, np.float32)
    sky[6:9, 14:17] = 40.0  # high on the left half: from +y
    cv2.imwrite(str(path), sky)
    return path


def light(arfx: Run, material: Material, *more: str) -> dict:
    r = arfx(*material.arguments("-o", "out.mkv", "--end", "0.3", "--json", *more))
    assert r.code == 0, r.err
    found: dict = r.json["light"]
    return found


def test_one_marker_at_rest_is_refused_out_loud(
    material: Material, arfx: Run
) -> None:
    r = arfx(*material.arguments("-o", "out.mkv", "--end", "0.3", "--json"))
    assert r.json["light"]["verdict"] == "refused" and r.json["light"]["lights"] == []
    assert "light: no direction is known" in r.err and "--light AZ,EL" in r.err
    assert any(
        row["check"] == "light direction" and row["verdict"] == "warn"
        for row in r.json["health"]
    )
    assert [s["name"] for s in r.json["stages"]] == [
        "raster",
        "lightmap",
        "composite",
    ]


def test_a_given_light_is_assumed(material: Material, arfx: Run) -> None:
    found = light(arfx, material, "--light", "90,30")
    assert found["verdict"] == "assumed" and found["source"] == "given"
    assert found["lights"][0]["direction"] == pytest.approx(
        [0, np.cos(np.radians(30)), 0.5], abs=1e-6
    )


def test_a_panorama_is_assumed(material: Material, arfx: Run, tmp_path: Path) -> None:
    found = light(
        arfx, material, "--environment", str(panorama(tmp_path / "room.hdr"))
    )
    assert found["verdict"] == "assumed" and found["lights"][0]["direction"][1] > 0.5


def test_the_papers_formula_runs(material: Material, arfx: Run) -> None:
    found = light(arfx, material, "--formula", "paper")
    assert found["formula"] == "paper" and "no confidence" in found["reason"]


def three_markers(path: Path) -> Path:
    """A scene of 2 frames: markers of three tilts, 45 degrees and more apart."""
    stand = {
        1: ([0, -0.03, 0], [0, 0, 0]),
        2: ([-0.15, 0.12, 0.065], [48, 0, 24]),
        5: ([0.16, 0.1, 0.065], [60, 0, -28]),
    }
    markers = "".join(
        f'[[marker]]\nspec = "36h11:{k}:75mm"\nposition_m = {at}\nrotate_deg = {turn}\n'
        for k, (at, turn) in stand.items()
    )
    path.write_text(
        "seed = 3\n[clip]\nwidth = 256\nheight = 144\nfps = 24\n[lens]\nfov_deg ="
        ' 50\n[[shot]]\nframes = 2\n[shot.path]\nkind = "dolly"\nposition_m = [-0.02,'
        " -0.42, 0.36]\nend_m = [0.02, -0.42, 0.36]\ntarget_m = [0, 0.02,"
        ' 0.03]\n[[plane]]\nname = "desk"\nsize_m = [1.6, 1.2]\nposition_m = [0, 0.1,'
        ' -0.0002]\ntexture = { kind = "plain", colour = [0.3, 0.25, 0.2]'
        f" }}\n{markers}[light]\nambient_rgb = [0.3, 0.3, 0.3]\nlamps = [{{ azimuth_deg ="
        " -150, elevation_deg = 48, rgb = [0.5, 0.5, 0.5], angular_size_deg = 3"
        ' }]\n[model]\nshape = "robot"\nfit = "7cm"\n[job]\nstages = ["lightmap"]\n'
    )
    return path


def test_every_effect_takes_more_than_two_lights(arfx: Run, tmp_path: Path) -> None:
    """The paper's map has as many lights as peaks: here one for each marker."""
    made = arfx("synth", str(three_markers(tmp_path / "scene.toml")), "-o", "clip")
    assert made.code == 0, made.err
    r = arfx("process", "--config", "clip/job.toml", "--set", "light.formula=paper", "--set", "light.peak=0.1",
             "--pipeline", "lightmap,gi,watercolor", "-o", "out.mkv", "--report", "report", "--json")  # fmt: skip
    assert r.code == 0, r.err
    assert len(r.json["light"]["lights"]) == 3
    assert {s["name"] for s in r.json["stages"] if s["frames_run"] == 2} >= {
        "lightmap",
        "gi",
        "watercolor",
    }


@pytest.mark.parametrize(
    ("options", "says", "code"),
    [
        (("--light", "45"), "AZ,EL", 2),
        (("--light", "45,100"), "elevation", 2),
        (("--environment", "nowhere.hdr"), "image nowhere.hdr: no such file", 3),
        (
            ("--light", "45,50", "--set", "light.given=[1,2]"),
            "--light 45,50 and --set light.given=[1,2] both give light.given",
            2,
        ),
    ],
)
def test_what_is_wrong_is_said(
    material: Material, arfx: Run, options: tuple[str, ...], says: str, code: int
) -> None:
    r = arfx(*material.arguments("-o", "out.mkv", *options))
    assert r.code == code and says in r.err


def test_a_panorama_of_another_shape_is_refused(
    material: Material, arfx: Run, tmp_path: Path
) -> None:
    cv2.imwrite(str(tmp_path / "square.hdr"), np.full((32, 32, 3), 0.5, np.float32))
    r = arfx(
        *material.arguments(
            "-o", "out.mkv", "--environment", str(tmp_path / "square.hdr")
        )
    )
    assert r.code == 3 and "twice as wide as high" in r.err


def test_without_effects_the_light_is_read_all_the_same(
    material: Material, arfx: Run
) -> None:
    found = light(arfx, material, "--set", "pipeline.stages=[]")
    assert (
        found == light(arfx, material, "--overwrite") and found["source"] != "default"
    )
