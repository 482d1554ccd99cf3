"""`--set` of every setting of every stage, found in the code, with values that nobody expects."""

from __future__ import annotations

import random
from pathlib import Path

from arfx.config.sections import section_models
from arfx.run.parameters import parameters
from arfx.stages import ALWAYS, STAGES
from tests.fuzz.case import NUMBERS, REFUSED, WORDS, Build, Case, process

COSTLY = ("gi",)  # a stage that takes seconds: in few cases
SHORT = [w for w in (*NUMBERS, *WORDS) if len(w) < 1000 and "\0" not in w]
LISTS = (
    "[]",
    "[1]",
    "[nan, nan, nan]",
    "[1e308, 1e308, 1e308]",
    "[0, 0, 0]",
    "[-1, -1, -1]",
    "[[1]]",
    '["a", "b", "c"]',
    "[1, 2]",
    "{}",
    "{a = 1}",
)


def every() -> list[tuple[str, str]]:
    """(section, key) of every setting."""
    kinds = (
        (name, kind)
        for name, formulas in parameters().items()
        for kind in formulas.values()
    )
    out = {
        (name, key)
        for name, kind in [*kinds, *section_models().items()]
        for key in kind.model_fields
    }
    return sorted(out)


def setting(
    *given: str, pipeline: str | None = None, codes: frozenset[int] = REFUSED
) -> Build:
    def build(rng: random.Random, folder: Path, material: Path) -> Case:
        args = process(folder, material, pipeline=pipeline)
        return Case(
            folder,
            args + [word for g in given for word in ("--set", g)],
            codes=codes,
            note=" ".join(given)[:200],
        )

    return build


def any_case(rng: random.Random, folder: Path, material: Path) -> Case:
    settings = every()
    chosen = [rng.choice(settings)]
    while chosen[0][0] in COSTLY and rng.random() < 0.7:
        chosen = [rng.choice(settings)]
    if rng.random() < 0.3:
        chosen.append(rng.choice([s for s in settings if s[0] == chosen[0][0]]))
    given = [
        f"{section}.{key}={rng.choice(SHORT if rng.random() < 0.8 else LISTS)}"
        for section, key in chosen
    ]
    effect = chosen[0][0]
    pipeline = (
        f"lightmap,{effect}" if effect in STAGES and effect not in ALWAYS else None
    )
    case = setting(*given, pipeline=pipeline)(rng, folder, material)
    if chosen[0][0] in ("holdout", "hide"):
        import shutil

        shutil.copytree(material / "depth", folder / "depth")
        case.args += ["--depth", "depth"]
    return case


SEEDS: dict[str, Build] = {
    "smoothing inf": setting("analyse.smoothing=inf"),
    "max_gap_s 1e308": setting("analyse.max_gap_s=1e308"),
    "fade_frames huge": setting("analyse.fade_frames=9999999999"),
    "samples huge": setting("raster.samples=1000000"),
    "mean_px huge": setting(
        "dof.mean_px=1000000",
        "dof.aperture_px=10",
        "dof.formula=paper",
        pipeline="lightmap,dof",
    ),
    "aperture 1e6": setting("dof.aperture_px=1e6", pipeline="lightmap,dof"),
    "map_level 60": setting("light.map_level=60"),
    "cell 1e-6 px": setting(
        "watercolor.cell_px=1e-6", pipeline="lightmap,watercolor"
    ),
    "line width 1e9 px": setting(
        "watercolor.line_width_px=1e9", pipeline="lightmap,watercolor"
    ),
    "gi samples huge": setting("gi.samples=1000000000", pipeline="lightmap,gi"),
    "crf 1e308": setting("output.crf=1e308"),
    "crf nan": setting("output.crf=nan"),
    "a preset that is none": setting("output.preset=--help"),
    "a pixel format that is none": setting("output.pixel_format=%s"),
    "min side 1e308": setting("analyse.min_side_px=1e308"),
    "environment outside": setting("light.environment=/etc/hostname"),
}
