#version 330 core

// What every fragment shader needs to know of the surface it is on; joined in front of each by `drawing.Program`.

in vec3 world_position;
// Without centroid, a pixel whose middle lies beyond the silhouette would take a normal from outside the triangle.
centroid in vec3 world_normal;
centroid in vec2 texture_uv;

uniform vec3 eye;
uniform vec4 base_color;               // linear, alpha is the opacity
uniform sampler2D base_color_texture;  // sRGB, decoded before filtering

const float PI = 3.14159265358979;

// Linear base colour and opacity. Texels with less than half alpha are cut out.
vec4 surface_color() {
    vec4 texel = texture(base_color_texture, texture_uv);
    if (texel.a < 0.5) discard;
    return vec4(base_color.rgb * texel.rgb, base_color.a);
}

// Unit normal on the side of the viewer. The side is that of the flat triangle, whose screen derivatives always span a
// normal towards the viewer, so it depends neither on winding nor on how far an interpolated normal bends over.
vec3 surface_normal(vec3 to_eye) {
    vec3 flat_normal = cross(dFdx(world_position), dFdy(world_position));
    vec3 n = world_normal;
    if (dot(n, n) < 1e-12) n = flat_normal;
    if (dot(n, flat_normal) < 0.0) n = -n;
    n = normalize(n);
    float facing = dot(n, to_eye);
    if (facing < 0.0) n = normalize(n - facing * to_eye);  // bent beyond the horizon: put it on the horizon
    return n;
}
