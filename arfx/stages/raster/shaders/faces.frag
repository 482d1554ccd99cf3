#version 330 core
// The number of the face among all: those of this draw begin with `first`.
uniform int first;
layout(location = 0) out int face;
void main() {
    face = first + gl_PrimitiveID;
}
