#version 330 core
// Three targets, four where something glows: normal and depth; albedo and opacity; material and part number; emission.
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
    material.xy *= texture(mr_tex, uv_0).bg;
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
