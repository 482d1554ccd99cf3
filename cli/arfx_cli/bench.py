"""`arfx bench`: cost of each stage and level on this machine."""

import re
from pathlib import Path
from typing import Any

from arfx_cli.console import (
    Progress,
    arfx_command,
    detail_template,
    print_table,
    say,
    wrote_json,
)


def parse_size(text: str) -> tuple[int, int]:
    """'1280x720' to (1280, 720). Raises ConfigError."""
    from arfx.errors import ConfigError

    m = re.fullmatch(r"\s*(\d{1,6})\s*[x×X]\s*(\d{1,6})\s*", text)
    if not m:
        raise ConfigError(
            f"size {text!r} is not WIDTHxHEIGHT", "for example 1280x720"
        )
    return int(m[1]), int(m[2])


@arfx_command("bench")
def command(
    stage: str | None,
    level: str | None,
    sizes: tuple[str, ...],
    calibrate: bool,
    tradeoff: Path | None,
) -> None:
    """Time each stage at each level on a standard scene: a ball of 6,000 triangles over a
    tenth of the picture.

    The ratio is to one Gaussian blur (float32, 3 channels, sigma 5) of a whole picture of
    that size, in turns in the same run: compare ratios, not times. The error beside it is
    the mean difference from the stage's best level, in grey levels of 255: upper end of
    many clips, or of the --tradeoff of one.

    \b
    Example:
      arfx bench --stage raster --size 1920x1080
      arfx bench --calibrate
      arfx bench --calibrate --stage dof"""
    if calibrate:
        _calibrate(stage, level)
        return
    from arfx.measure.bench import bench
    from arfx.plan.errors import errors_of_clip, shipped_errors

    errors = shipped_errors() if tradeoff is None else errors_of_clip(tradeoff)
    parsed = [parse_size(s) for s in sizes]
    with Progress("timed") as progress:
        rows = bench(parsed, stage, level, progress, errors=errors)
    detail_template("measure/bench_detail.jinja", rows=rows)
    if wrote_json(rows):
        return
    print_table("measure/bench.jinja", words=3, rows=rows)
    say(f"errors: {errors.source}")


def _calibrate(stage: str | None, level: str | None) -> None:
    from arfx.core.cost import TERMS, load_prices
    from arfx.errors import ConfigError
    from arfx.measure.costs import calibrate, save_prices

    if level is not None:
        raise ConfigError("--calibrate measures every level", "leave out --level")
    with Progress("done") as progress:
        prices = calibrate(progress, stage=stage)
    if stage is not None:
        prices = load_prices().with_stage(stage, prices)
    path = save_prices(prices)
    rows: list[dict[str, Any]] = [
        {"entry": key, "runs": p.runs, "spread": p.spread, **p.coefficients}
        for key, p in sorted(prices.prices.items())
        if stage in (None, key.removeprefix("prepare ").partition("/")[0])
    ]
    document = {
        "file": str(path),
        "source": prices.source,
        "threads": prices.threads,
        "prices": rows,
    }
    if wrote_json(document):
        return
    print_table("measure/prices.jinja", d=document, terms=TERMS)
    say(f"kept in {path}")
