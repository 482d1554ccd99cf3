"""Errors of `gi` where light is hardest: thin and concave models, metal, glass, leaves, a small
sun, several planes, a floating object, many faces.

    python tools/gi_cases.py -o out/gi_cases             # all, as a table
    python tools/gi_cases.py -o out/gi_cases --case sun  # those whose name begins so

Each case is a model on the marker of a sample clip; errors and processor times are those of
`arfx tradeoff` for the stage `gi` alone, over the pixels that any level changes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from measure_errors import SAMPLES, WINDOW_PX, measured
from trimesh.visual.material import PBRMaterial

ROOT = Path(__file__).parents[1]
SIZE = "12cm"
FRAMES = 2


def revolved(profile: np.ndarray, sections: int = 96) -> trimesh.Trimesh:
    return trimesh.creation.revolve(profile, sections=sections)


def ball(subdivisions: int = 4) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions)


def torus() -> trimesh.Trimesh:
    return trimesh.creation.torus(1.0, 0.4, 96, 48)


def bowl() -> trimesh.Trimesh:
    """A thin half ball, open above."""
    angle = np.linspace(np.pi / 2, np.pi, 40)
    rim = np.column_stack([np.sin(angle), 1 + np.cos(angle)])
    profile = np.concatenate([rim[::-1], 0.97 * (rim - [0, 1]) + [0, 1]])
    profile[[0, -1], 0] = 0
    return revolved(profile)


def thin_wall() -> trimesh.Trimesh:
    """Two walls and a floor of 1 % of their size."""
    floor = trimesh.creation.box((1, 1, 0.01))
    wall = trimesh.creation.box((1, 0.01, 0.8))
    wall.apply_translation((0, 0.2, 0.4))
    side = trimesh.creation.box((0.01, 1, 0.8))
    side.apply_translation((-0.3, 0, 0.4))
    return trimesh.util.concatenate([floor, wall, side])


def bush() -> trimesh.Trimesh:
    """Sixty upright cards."""
    rng = np.random.default_rng(7)
    cards = []
    for _ in range(60):
        card = trimesh.Trimesh(
            [[-0.2, 0, 0], [0.2, 0, 0], [0.2, 0, 0.4], [-0.2, 0, 0.4]],
            [[0, 1, 2], [0, 2, 3]],
            process=False,
        )
        turn = trimesh.transformations.random_rotation_matrix(rng.random(3))
        turn[:3, 3] = rng.uniform((-0.5, -0.5, 0), (0.5, 0.5, 1))
        card.apply_transform(turn)
        cards.append(card)
    return trimesh.util.concatenate(cards)


@dataclass(frozen=True)
class Case:
    """shape : makes the model;  material : of glTF;  scene : folder of sample_scenes
    model : more of the job's table;  sun : a panorama with a small sun is given"""

    shape: Callable[[], trimesh.Trimesh]
    material: dict[str, object] = field(default_factory=dict)
    scene: str = "0001-orbit"
    model: dict[str, object] = field(default_factory=dict)
    sun: bool = False


RED = {
    "baseColorFactor": (204, 30, 20, 255),
    "metallicFactor": 0.0,
    "roughnessFactor": 0.9,
}
GREY = {
    "baseColorFactor": (150, 150, 150, 255),
    "metallicFactor": 0.0,
    "roughnessFactor": 0.9,
}
GLASS = {**GREY, "baseColorFactor": (220, 230, 230, 60), "alphaMode": "BLEND"}
LEAVES = {
    "baseColorFactor": (60, 150, 40, 255),
    "metallicFactor": 0.0,
    "roughnessFactor": 0.8,
    "doubleSided": True,
}


def metal(roughness: float) -> dict[str, object]:
    return {
        "baseColorFactor": (240, 220, 190, 255),
        "metallicFactor": 1.0,
        "roughnessFactor": roughness,
    }


CASES = {
    "ball": Case(ball, RED),
    "torus": Case(torus, RED),
    "bowl": Case(bowl, GREY),
    "bowl-metal": Case(bowl, metal(0.3)),
    "thin-wall": Case(thin_wall, RED),
    "leaves": Case(bush, LEAVES),
    "leaves-sun": Case(bush, LEAVES, sun=True),
    "glass": Case(ball, GLASS),
    "metal-0": Case(ball, metal(0.0)),
    "metal-0.1": Case(ball, metal(0.1)),
    "metal-0.3": Case(ball, metal(0.3)),
    "metal-0.6": Case(ball, metal(0.6)),
    "torus-metal": Case(torus, metal(0.2)),
    "sun": Case(ball, GREY, sun=True),
    "floating": Case(ball, RED, model={"offset": ["0cm", "0cm", "4cm"]}),
    "planes": Case(ball, RED, scene="0003-several-tilted-markers"),
    "faces-300000": Case(lambda: ball(7), GREY),
}


def panorama(file: Path) -> None:
    """An even sky, a dark ground and a sun of three pixels."""
    sky = np.full((128, 256, 3), 0.6, np.float32)
    sky[64:] = 0.15
    sky[30:33, 90:93] = 4000
    cv2.imwrite(str(file), sky)


def job_of(scene: str, folder: Path) -> Path:
    """Job file of a sample scene, whose clip is made where it is not there."""
    from arfx.synth.clip import make_clip
    from arfx.synth.description import load_scene

    made = folder / scene
    if not (made / "job.toml").is_file():
        source = ROOT / "sample_scenes" / scene
        make_clip(
            load_scene(source / "scene.toml"),
            made,
            overwrite=True,
            truth_pictures=False,
        )
    return made / "job.toml"


def measure(name: str, case: Case, folder: Path) -> dict[str, dict[str, float]]:
    """level -> {error in grey levels, seconds a frame}"""
    from arfx.config.load import load
    from arfx.run.folder import JobFolder
    from arfx.run.inputs import open_inputs
    from arfx.run.job import Options, plan_job
    from arfx.run.parameters import parameters

    shape = case.shape()
    shape.visual = trimesh.visual.TextureVisuals(
        material=PBRMaterial(**case.material)
    )
    shape.apply_transform(
        trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
    )
    model = folder / f"{name}.glb"
    shape.export(model)
    more: dict[str, Any] = {
        "output": {"path": str(folder / "none.mkv")},
        "model": {"file": str(model), "fit": SIZE, **case.model},
        "pipeline": {"stages": ["lightmap", "gi"]},
        "light": {"given": [40, 50, 0.5, 0.5, 0.5]},
        "gi": {"samples": SAMPLES},
    }
    if case.sun:
        panorama(folder / "sun.hdr")
        more["light"] = {"environment": str(folder / "sun.hdr")}
    work = JobFolder(folder / name)
    work.path.mkdir(exist_ok=True)
    work.open(resume=False)
    options = Options(progress=lambda *_: None, notice=lambda _: None)
    inputs = open_inputs(load(job_of(case.scene, folder), more, parameters()))
    job = plan_job(inputs, work, options)
    return measured(job, list(job.stages), ["gi"], FRAMES, WINDOW_PX)["gi"]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=ROOT / "out" / "gi_cases"
    )
    parser.add_argument("--case", default="", help="only cases whose name begins so")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    print("| case | draft | standard |\n|---|---|---|")
    for name, case in CASES.items():
        if name.startswith(given.case):
            levels = measure(name, case, given.output)
            row = (f"{levels[level]['error']:.2f}" for level in ("draft", "standard"))
            print(f"| {name} | {' | '.join(row)} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
