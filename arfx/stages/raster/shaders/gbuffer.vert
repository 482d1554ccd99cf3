#version 330 core
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
