// Geometry of the visible surface, one sample per pixel of a grid finer than the image.

uniform vec3 forward;         // viewing direction
uniform float object_number;  // index + 1; 0 is where nothing was drawn
uniform int factor;           // samples per image pixel, in each direction
uniform float thresholds[16]; // opacity above which the sample (row, column) of a pixel sees the surface

layout(location = 0) out vec4 normal_and_depth;
layout(location = 1) out vec4 color_and_object;

void main() {
    vec3 from_eye = world_position - eye;
#if METALLIC_ROUGHNESS
    vec3 to_eye = -normalize(from_eye);
    vec3 n = mapped_normal(surface_normal(to_eye));
    float facing = dot(n, to_eye);
    if (facing < 0.0) n = normalize(n - facing * to_eye);
    Material material = surface_material();
    vec3 color = base_colors[0] * material.texel;
    float alpha = material.alpha;
#else
    vec3 color = base_colors[0] * surface_texel();
    float alpha = opacity;
#endif
    ivec2 cell = ivec2(gl_FragCoord.xy) % factor;
    if (alpha < 1.0 && alpha <= thresholds[cell.y * factor + cell.x]) discard;
#if !METALLIC_ROUGHNESS
    vec3 n = surface_normal(-normalize(from_eye));
#endif
    normal_and_depth = vec4(n, dot(from_eye, forward));
    color_and_object = vec4(color, object_number);
}
