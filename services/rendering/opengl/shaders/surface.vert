#version 330 core

// Compiled for: TEXTURED (1: the surface has a texture), HOLES (1: with texels of less than half alpha), PICTURES (drawn
// at once, one to each output) and LIGHTS (point lights).
//
// Matrices are multiplied on the host in float64, so that a small move of an object survives the rounding to float32.
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;

uniform mat4 clip_from_object;
uniform mat4 world_from_object;
uniform mat3 normal_from_object;

invariant gl_Position;  // the same in all programs: what one draws another draws to the same samples
out vec3 world_position;
centroid out vec3 world_normal;
#if TEXTURED
centroid out vec2 texture_uv;
#endif

void main() {
    gl_Position = clip_from_object * vec4(position, 1.0);
    world_position = (world_from_object * vec4(position, 1.0)).xyz;
    world_normal = normal_from_object * normal;
#if TEXTURED
    texture_uv = uv;
#endif
}
