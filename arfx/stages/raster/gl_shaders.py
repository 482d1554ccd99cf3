"""GLSL of the geometry buffer, and the folder pyrender loads it from.

Kept as text here, so that an installed wheel needs no package data; written once to the user's cache folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

from arfx.core.places import cache_folder

VERTEX = """#version 330 core
layout(location = 0) in vec3 position;
layout(location = NORMAL_LOC) in vec3 normal;
#ifdef TEXCOORD_0_LOC
layout(location = TEXCOORD_0_LOC) in vec2 texcoord_0;
out vec2 uv_0;
#endif
#ifdef COLOR_0_LOC
layout(location = COLOR_0_LOC) in vec4 color_0;
out vec4 colour;
#endif
layout(location = INST_M_LOC) in mat4 inst_m;
uniform mat4 V;
uniform mat4 P;
out vec3 place;
out vec3 shading_normal;
out float depth_m;
void main() {
    vec4 world = inst_m * vec4(position, 1.0);
    vec4 view = V * world;
    gl_Position = P * view;
    place = world.xyz;
    depth_m = -view.z;
    shading_normal = normal;
#ifdef TEXCOORD_0_LOC
    uv_0 = texcoord_0;
#endif
#ifdef COLOR_0_LOC
    colour = color_0;
#endif
}
"""

# Three targets, four where something glows: normal and depth; albedo and opacity; material and part number; emission.
FRAGMENT = """#version 330 core
in vec3 place;
in vec3 shading_normal;
in float depth_m;
#ifdef TEXCOORD_0_LOC
in vec2 uv_0;
#endif
#ifdef COLOR_0_LOC
in vec4 colour;
#endif
uniform vec3 eye;
uniform vec4 base_factor;
uniform vec3 surface;
uniform vec3 emissive_factor;
uniform vec3 kind;
#ifdef BASE_TEX
uniform sampler2D base_tex;
#endif
#ifdef MR_TEX
uniform sampler2D mr_tex;
#endif
#ifdef EMISSIVE_TEX
uniform sampler2D emissive_tex;
#endif
#ifdef PEEL
uniform sampler2D peel;
#endif
layout(location = 0) out vec4 g_geometry;
layout(location = 1) out vec4 g_albedo;
layout(location = 2) out vec4 g_material;
#ifdef GLOWS
layout(location = 3) out vec4 g_emissive;
#endif
vec3 linear(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
}
void main() {
#ifdef PEEL
    if (depth_m <= texelFetch(peel, ivec2(gl_FragCoord.xy), 0).r * 1.000001) discard;
#endif
    vec4 base = base_factor;
#ifdef COLOR_0_LOC
    base *= colour;
#endif
#ifdef BASE_TEX
    vec4 t = texture(base_tex, uv_0);
    base *= vec4(linear(t.rgb), t.a);
#endif
    // kind: 1 + part, alpha mode (0 opaque, 1 mask, 2 blend), cutoff
    if (kind.y == 0.0) base.a = 1.0;
    else if (kind.y == 1.0) { if (base.a < kind.z) discard; base.a = 1.0; }
    else if (base.a <= 1.0 / 512.0) discard;
    vec3 material = surface;
#ifdef MR_TEX
    material.xy *= texture(mr_tex, uv_0).rg;
#endif
    vec3 to_surface = normalize(place - eye);
    vec3 n = shading_normal;
    n = dot(n, n) > 1e-12 ? normalize(n) : -to_surface;
    if (!gl_FrontFacing) n = -n;
    float away = dot(n, to_surface);
    if (away > 0.0) { n -= away * to_surface; n = dot(n, n) > 1e-12 ? normalize(n) : -to_surface; }
    g_geometry = vec4(n, depth_m);
    g_albedo = base;
    g_material = vec4(material, kind.x / 65535.0);
#ifdef GLOWS
    vec3 e = emissive_factor;
#ifdef EMISSIVE_TEX
    e *= linear(texture(emissive_tex, uv_0).rgb);
#endif
    g_emissive = vec4(e, 1.0);
#endif
}
"""

_folder: tempfile.TemporaryDirectory | None = None


def shader_folder() -> str:
    """A folder that holds the two shaders: in the cache, where it is made once; where that cannot be written, one that lives
    as long as this process does."""
    global _folder
    name = f"glsl-{hashlib.blake2b((VERTEX + FRAGMENT).encode(), digest_size=6).hexdigest()}"
    with contextlib.suppress(OSError, RuntimeError):
        kept = cache_folder() / name
        for file, text in (("gbuffer.vert", VERTEX), ("gbuffer.frag", FRAGMENT)):
            path = kept / file
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                kept.mkdir(parents=True, exist_ok=True)
                aside = path.with_suffix(f".{os.getpid()}.part")
                aside.write_text(text, encoding="utf-8")
                aside.replace(path)
        return str(kept)
    if _folder is None:
        _folder = tempfile.TemporaryDirectory(prefix="arfx-glsl-")
        Path(_folder.name, "gbuffer.vert").write_text(VERTEX)
        Path(_folder.name, "gbuffer.frag").write_text(FRAGMENT)
    return _folder.name
