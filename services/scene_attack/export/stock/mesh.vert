#version 330 core

// For pyrender, in place of its own mesh.vert; see render_exported.py.

layout(location = 0) in vec3 position;
#ifdef NORMAL_LOC
layout(location = NORMAL_LOC) in vec3 normal;
#endif
#ifdef TANGENT_LOC
layout(location = TANGENT_LOC) in vec4 tangent;
#endif
#ifdef TEXCOORD_0_LOC
layout(location = TEXCOORD_0_LOC) in vec2 texcoord_0;
#endif
#ifdef TEXCOORD_1_LOC
layout(location = TEXCOORD_1_LOC) in vec2 texcoord_1;
#endif
#ifdef COLOR_0_LOC
layout(location = COLOR_0_LOC) in vec4 color_0;
#endif

uniform mat4 clip_from_mesh;  // multiplied in float64 by render_exported.py
uniform mat4 M;
uniform mat3 normal_from_mesh;

out vec3 world_position;
out vec4 uvs;
// Without centroid, a pixel whose middle lies beyond the silhouette would take values from outside the triangle.
centroid out vec3 world_normal;
centroid out vec4 world_tangent;
centroid out vec4 vertex_color;

void main() {
    gl_Position = clip_from_mesh * vec4(position, 1.0);
    world_position = (M * vec4(position, 1.0)).xyz;
    world_normal = vec3(0.0);
    world_tangent = vec4(0.0);
    uvs = vec4(0.0);
    vertex_color = vec4(1.0);
#ifdef NORMAL_LOC
    world_normal = normal_from_mesh * normal;
#endif
#ifdef TANGENT_LOC
    world_tangent = vec4(mat3(M) * tangent.xyz, tangent.w);
#endif
#ifdef TEXCOORD_0_LOC
    uvs.xy = texcoord_0;
#endif
#ifdef TEXCOORD_1_LOC
    uvs.zw = texcoord_1;
#endif
#ifdef COLOR_0_LOC
    vertex_color = color_0;
#endif
}
