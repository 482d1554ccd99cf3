"""Render the scenes of tests/outside with Blender's Cycles, which reads the same models and
surroundings as arfx does.

    python3.11 -m venv JUDGE && JUDGE/bin/pip install "bpy==4.5.*" "numpy<2"    # an
    environment of its own
    .venv/bin/python -m tests.outside.scenes FOLDER
    JUDGE/bin/python tools/outside_render.py FOLDER tests/outside [--only NAME] [--samples 1024]

Run by hand when a scene changes: the tests compare with the pictures that this writes, and
need no Blender. A picture is sRGB, 8 bit: an object alone, premultiplied by its coverage;
or the plane as it would look if it were evenly grey without the object, which itself is not
shown. Shading is Blender's own, by its glTF importer; nothing is denoised, no view
transform is applied."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

PLANE_ALBEDO, PLANE_M = 0.5, 200.0
SENSOR_MM = 36.0
EVEN_SAMPLES = 16  # of each pixel of the bare plane, whose mean is taken


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--samples", type=int, default=1024)
    args = parser.parse_args()
    for scene in json.loads((args.folder / "scenes.json").read_text()):
        if args.only in scene["name"]:
            picture = rendered(scene, args.folder, args.samples)
            write_png(args.output / f"{scene['name']}.png", picture)


def rendered(scene: dict[str, Any], folder: Path, samples: int) -> np.ndarray:
    """(h, w, 3) linear, what the scene shows."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(folder / f"{scene['model']}.glb"))
    objects = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    surround_with(folder / f"{scene['environment']}.hdr")
    place_camera(scene["camera"])
    settings = bpy.context.scene.cycles
    bpy.context.scene.render.engine = "CYCLES"
    settings.device, settings.samples, settings.seed = "CPU", samples, 1
    settings.use_adaptive_sampling = settings.use_denoising = False
    settings.sample_clamp_indirect = 0.0
    settings.pixel_filter_type, settings.filter_width = "BOX", 1.0
    bpy.context.scene.view_settings.view_transform = "Raw"
    bpy.context.scene.render.film_transparent = True
    if scene["shows"] == "object":
        return picture()
    add_plane()
    for o in objects:
        o.visible_camera = False
    with_object = picture()
    for o in objects:
        o.hide_render = True
    settings.samples = (
        EVEN_SAMPLES  # distant light: each place of a bare plane has the same
    )
    even = picture().mean((0, 1))
    return PLANE_ALBEDO * with_object / even


def surround_with(path: Path) -> None:
    world = bpy.data.worlds.new("surroundings")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes = world.node_tree.nodes
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(path.resolve()))
    texture.image.colorspace_settings.name = "Linear Rec.709"
    world.node_tree.links.new(
        texture.outputs["Color"], nodes["Background"].inputs["Color"]
    )
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 1024


def place_camera(view: dict[str, Any]) -> None:
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = (
        view["width"],
        view["height"],
    )
    scene.render.resolution_percentage = 100
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", SENSOR_MM
    lens.lens = view["focal_px"] * SENSOR_MM / view["width"]
    lens.clip_start, lens.clip_end = 1e-3, 1e4
    camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(camera)
    eye = Vector(view["eye_m"])
    turn = (Vector(view["target_m"]) - eye).to_track_quat("-Z", "Y")
    camera.matrix_world = Matrix.Translation(eye) @ turn.to_matrix().to_4x4()
    scene.camera = camera


def add_plane() -> None:
    bpy.ops.mesh.primitive_plane_add(size=PLANE_M)
    paint = bpy.data.materials.new("paper")
    paint.use_nodes = True
    nodes, links = paint.node_tree.nodes, paint.node_tree.links
    matt = nodes.new("ShaderNodeBsdfDiffuse")
    matt.inputs["Color"].default_value = (PLANE_ALBEDO,) * 3 + (1.0,)
    links.new(matt.outputs[0], nodes["Material Output"].inputs["Surface"])
    bpy.context.object.data.materials.append(paint)


def picture() -> np.ndarray:
    """(h, w, 3) linear radiance, premultiplied by the coverage, of the scene as it stands."""
    path = Path(bpy.app.tempdir) / "picture.exr"
    render = bpy.context.scene.render
    render.image_settings.file_format, render.image_settings.color_mode = (
        "OPEN_EXR",
        "RGBA",
    )
    render.image_settings.color_depth = "32"
    render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    values = np.array(image.pixels[:], np.float32).reshape(
        image.size[1], image.size[0], 4
    )
    bpy.data.images.remove(image)
    return values[::-1, :, :3]


def write_png(path: Path, linear: np.ndarray) -> None:
    """sRGB, 8 bit, by Blender, as this environment has no other writer."""
    low = np.clip(linear, 0, 1)
    coded = np.where(low <= 0.0031308, 12.92 * low, 1.055 * low ** (1 / 2.4) - 0.055)
    image = bpy.data.images.new(
        path.stem, coded.shape[1], coded.shape[0], alpha=False
    )
    image.colorspace_settings.name = "Non-Color"
    image.pixels = (
        np.concatenate([coded, np.ones_like(coded[..., :1])], -1)[::-1]
        .ravel()
        .tolist()
    )
    image.filepath_raw, image.file_format = str(path.resolve()), "PNG"
    image.save()


if __name__ == "__main__":
    main()
