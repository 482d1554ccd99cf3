"""`arfx synth`: a synthetic clip with exact truth."""

from pathlib import Path
from typing import Any

from arfx_cli.console import (
    Progress,
    arfx_command,
    detail_template,
    say,
    wrote_json,
)


@arfx_command("synth")
def command(scene: Path, folder: Path, kinds: str | None, overwrite: bool) -> None:
    """Render SCENE (a scene.toml, or the folder that holds one) into a folder.

    The folder holds the clip, camera.yaml, model.glb, job.toml (`arfx process --config`),
    depth maps if the scene has a [depth] part, truth.jsonl (poses, corners, visibility,
    lights, exposure of every frame) and truth/ with depth, masks and flow.

    \b
    Example:
      arfx synth sample_scenes/0001-orbit/scene.toml -o out/orbit"""
    from arfx.errors import ConfigError
    from arfx.synth.clip import make_clip
    from arfx.synth.description import load_scene

    path = scene / "scene.toml" if scene.is_dir() else scene
    description = load_scene(path)
    if kinds is not None:
        chosen: Any = tuple(
            k.strip() for k in kinds.split(",") if k.strip() and k.strip() != "none"
        )
        wrong = [k for k in chosen if k not in ("depth", "mask", "flow")]
        if wrong:
            raise ConfigError(
                f"--truth: there is no {wrong[0]!r}", "depth, mask, flow, or none"
            )
        description = description.model_copy(update={"truth": chosen})
    with Progress() as progress:
        truth = make_clip(description, folder, path.parent, progress, overwrite)
    files = sorted(str(p.relative_to(folder)) for p in folder.iterdir())
    say(f"{len(truth.frames)} frames in {folder}: {', '.join(files)}")
    keys = sorted({key for f in truth.frames for key in f.markers})
    seen = {
        key: [f.markers[key] for f in truth.frames if key in f.markers]
        for key in keys
    }
    detail_template(
        "measure/synth_detail.jinja",
        sizes={
            p.name: p.stat().st_size for p in sorted(folder.iterdir()) if p.is_file()
        },
        markers=seen,
        frames=len(truth.frames),
    )
    if truth.world is not None:
        say(
            f"next: arfx process --config {folder / 'job.toml'} -o {folder / 'out.mp4'}  "
            f" or   arfx verify {folder}"
        )
    wrote_json(
        {
            "folder": str(folder),
            "frames": len(truth.frames),
            "world": truth.world,
            "files": files,
        }
    )
