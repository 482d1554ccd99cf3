#version 330 core
// The number of the face. The first ones are not seen from behind.
uniform int one_sided;
layout(location = 0) out int face;
void main() {
    if (gl_PrimitiveID < one_sided && !gl_FrontFacing) discard;
    face = gl_PrimitiveID;
}
