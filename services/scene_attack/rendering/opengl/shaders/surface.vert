#version 330 core

// Compiled for: TEXTURED (1: the surface has a texture), HOLES (1: with texels of less than half alpha), IMAGES (drawn
// at once, one to each output), LIGHTS (point lights), DIRECTIONAL_LIGHTS, SPOT_LIGHTS, SHADOWS (1: they are drawn), and METALLIC_ROUGHNESS (1: a
// material of a glTF file, see `metallic_roughness.frag` for the constants that it has besides).
//
// Matrices are multiplied on the host in float64, so that a small move of an object survives the rounding to float32.
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
#if METALLIC_ROUGHNESS
layout(location = 2) in vec4 tangent;  // and the sign of the bitangent
layout(location = 3) in vec2 uv;
layout(location = 4) in vec2 second_uv;
layout(location = 5) in vec4 color;
#else
layout(location = 2) in vec2 uv;
#endif

uniform mat4 clip_from_object;
uniform mat4 world_from_object;
uniform mat3 normal_from_object;

invariant gl_Position;  // the same in all programs: what one draws another draws to the same samples
out vec3 world_position;
centroid out vec3 world_normal;
#if TEXTURED
out vec2 texture_uv;
#endif
#if METALLIC_ROUGHNESS
out vec4 texture_uvs;
centroid out vec4 vertex_color;
centroid out vec4 world_tangent;
#endif

void main() {
    gl_Position = clip_from_object * vec4(position, 1.0);
    world_position = (world_from_object * vec4(position, 1.0)).xyz;
    world_normal = normal_from_object * normal;
#if TEXTURED
    texture_uv = uv;
#endif
#if METALLIC_ROUGHNESS
    texture_uvs = vec4(uv, second_uv);
    vertex_color = color;
    world_tangent = vec4(mat3(world_from_object) * tangent.xyz, tangent.w);
#endif
}
