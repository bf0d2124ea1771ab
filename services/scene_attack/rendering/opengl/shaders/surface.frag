#version 330 core

// What every fragment shader needs to know of the surface it is on; joined in front of each by `Program`, with the
// constants of `surface.vert`. Where METALLIC_ROUGHNESS is 1, `metallic_roughness.frag` follows.

in vec3 world_position;
// Without centroid, a pixel whose middle lies beyond the silhouette would take a normal from outside the triangle.
centroid in vec3 world_normal;

uniform vec3 eye;
uniform vec3 base_colors[IMAGES];    // linear, one for each image
uniform float opacity;
#if TEXTURED
// In the pixel's middle, covered or not: the mipmap follows from differences to the pixels beside, which between covered
// places are uneven, and so are the texels of small triangles there.
in vec2 texture_uv;
uniform sampler2D base_color_texture;  // sRGB, decoded before filtering
#endif

const float PI = 3.14159265358979;

// The texture's linear colour, white without one. Texels with less than half alpha are cut out.
vec3 surface_texel() {
#if TEXTURED
    vec4 texel = texture(base_color_texture, texture_uv);
#if HOLES
    if (texel.a < 0.5) discard;  // only where it may happen: a surface that can be discarded is shaded even when hidden
#endif
    return texel.rgb;
#else
    return vec3(1.0);
#endif
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
