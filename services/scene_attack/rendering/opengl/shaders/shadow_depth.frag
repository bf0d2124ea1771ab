// The depth of the nearest surface as a light sees it, linear: 0 at the light, 1 at the farthest caster.

uniform vec3 forward;
uniform float far;

void main() {
#if METALLIC_ROUGHNESS
    surface_material();  // cuts out what a mask does
#elif HOLES
    surface_texel();
#endif
    gl_FragDepth = clamp(dot(world_position - eye, forward) / far, 0.0, 1.0);
}
