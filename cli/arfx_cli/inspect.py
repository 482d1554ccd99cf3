"""`arfx inspect`: what is in a clip, and the `process` command for it."""

from pathlib import Path
from typing import Any

import click

from arfx_cli.console import (
    arfx_command,
    detail_template,
    print_table,
    tell,
    wrote_json,
)


@arfx_command("inspect")
def command(clip: Path, camera: Path | None, samples: int) -> None:
    """Stream properties of CLIP, the markers in it, blur and light, and the `process`
    command that fits.

    \b
    Example:
      arfx inspect clip.mp4 --camera camera.yaml"""
    from arfx.measure.inspection import inspect, suggestion
    from arfx.media.cameras import load_camera
    from arfx.media.clip import probe

    info = probe(clip)
    lens = (
        None
        if camera is None
        else load_camera(camera).scaled_to(info.width, info.height, info.pixel_aspect)
    )
    document = inspect(info, lens, samples)
    document["suggestion"] = suggestion(document, clip, camera)
    detail_template("measure/inspect_detail.jinja", d=document)
    if not wrote_json(document):
        _print(document)


def _print(document: dict[str, Any]) -> None:
    from arfx.analyse.markers.detect import SCANNED_FAMILIES
    from arfx.measure.inspection import size_names
    from arfx.run.pages import render

    markers = document["markers"]
    click.echo(render("measure/inspect_clip.jinja", d=document), nl=False)
    if markers:
        click.echo()
        print_table("measure/inspect_table.jinja", d=document)
    sizes = [*zip(markers, size_names(markers), strict=True)]
    click.echo(
        render(
            "measure/inspect_markers.jinja",
            d=document,
            sizes=sizes,
            families=SCANNED_FAMILIES,
        ),
        nl=False,
    )
    if not markers:
        tell(
            "help: a marker needs a white margin, sides of 12 px or more and even light;"
            " --samples looks at more frames"
        )
