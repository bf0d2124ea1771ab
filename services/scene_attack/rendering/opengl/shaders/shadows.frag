// The share of each light that reaches a fragment past the scene's objects: percentage-closer soft shadows (Fernando
// 2005). Joined before `radiance.frag` by `Program` where SHADOWS is 1.
//
// The lights of all images that are drawn at once share maps: `shadow_of` says which light of the maps each one is. A
// light is a disc that faces the fragment. Its samples look for what is in the way at up to the distance that the
// nearest caster allows; the mean depth of that says how far from the fragment's own place in the map the light's
// samples then fall. A texel is compared with the depth of the fragment's tangent plane at the texel's middle, so that
// a plane casts no shadow on itself, and over one texel of depth, so that nothing jumps.

#define N_SHADOWS (IMAGES * (LIGHTS + DIRECTIONAL_LIGHTS + SPOT_LIGHTS))

// The units are those of `shadow_maps.py`. Set here, as samplers of two kinds on one unit would not pass validation.
layout(binding = 13) uniform sampler2DArray shadow_depths;  // share of the view's far depth
layout(binding = 14) uniform sampler2DArray shadow_least;   // of a block and those around, the least of these
layout(binding = 15) uniform sampler2D shadow_views;        // a row for each layer, see `ShadowView.row`

uniform int shadow_lights;             // number of different lights
uniform vec3 shadow_maps[N_SHADOWS];   // of each its first layer, number of layers, and radius (angle if parallel)
uniform float shadow_of[N_SHADOWS];    // the light of the maps that each light of each image is
uniform int shadow_samples;

const float NOTHING = 1e9;  // depth where no caster is

float seen[N_SHADOWS];

#define POINT_SEEN(i) seen[int(shadow_of[i])]
#define DIRECTIONAL_SEEN(i) seen[int(shadow_of[IMAGES * LIGHTS + (i)])]
#define SPOT_SEEN(i) seen[int(shadow_of[IMAGES * (LIGHTS + DIRECTIONAL_LIGHTS) + (i)])]

struct ShadowView {
    int layer;
    vec3 right, up, forward, origin;
    float extent, near, far, reach;
    bool parallel;
};

// A fragment as a map sees it: its place on the map and its depth; the map's texel there; and its tangent plane, whose
// depth at a place is dot(over, (place, 1)) / dot(under, (place, 1)).
struct Receiver {
    vec2 place;
    float depth, texel;
    vec3 over, under;
};

ShadowView shadow_view(int layer) {
    vec4 a = texelFetch(shadow_views, ivec2(0, layer), 0), b = texelFetch(shadow_views, ivec2(1, layer), 0);
    vec4 c = texelFetch(shadow_views, ivec2(2, layer), 0), d = texelFetch(shadow_views, ivec2(3, layer), 0);
    float reach = texelFetch(shadow_views, ivec2(4, layer), 0).x * a.w;
    return ShadowView(layer, a.xyz, b.xyz, c.xyz, d.xyz, a.w, d.w, c.w, reach, b.w > 0.5);
}

// Whether nothing on the map, as far as samples may look, is nearer than any of the receiver's tangent plane there.
bool clear(ShadowView view, Receiver at) {
    float size = float(textureSize(shadow_least, 0).x);
    vec2 block = clamp((at.place / view.extent * 0.5 + 0.5) * size, vec2(0.0), vec2(size - 1.0));
    float least = texelFetch(shadow_least, ivec3(ivec2(block), view.layer), 0).r;
    vec3 here = vec3(at.place, 1.0);
    vec2 change = view.reach * (abs(at.over.xy) + abs(at.under.xy));
    float over = dot(at.over, here), under = dot(at.under, here), steep = change.x + change.y;
    float deepest = view.parallel ? (over - steep) / under : over / min(under + steep, -1e-6);
    return least >= 1.0 || least * view.far >= deepest;
}

// How much of the light passes at a place of the map, 0 to 1; adds what blocks it, and its depth times that, to
// `blocked`. Bilinear in the comparisons of the four texels around. Texels at the map's edge are empty.
float passes(ShadowView view, Receiver at, vec2 place, inout vec2 blocked) {
    float size = float(textureSize(shadow_depths, 0).x), unit = 2.0 * view.extent / size;
    vec2 texel = (place / view.extent * 0.5 + 0.5) * size - 0.5;
    vec2 first = floor(texel), part = texel - first;
    vec4 depths = textureGather(shadow_depths, vec3((first + 1.0) / size, float(view.layer)));
    depths = mix(depths * view.far, vec4(NOTHING), greaterThanEqual(depths, vec4(1.0)));
    vec4 right = vec4(0.0, 1.0, 1.0, 0.0), up = vec4(1.0, 1.0, 0.0, 0.0);  // in which order they come
    vec3 corner = vec3((first + 0.5) * unit - view.extent, 1.0);
    vec4 over = dot(at.over, corner) + unit * (at.over.x * right + at.over.y * up);
    vec4 under = dot(at.under, corner) + unit * (at.under.x * right + at.under.y * up);
    // Where the plane runs away from the light it is followed to twice the depth only, so that a surface that the light
    // grazes is not compared with what is far behind it.
    vec4 plane = over / min(under, 0.5 * dot(at.under, vec3(at.place, 1.0)));
    vec4 passing = clamp((depths - plane) / at.texel + 1.0, 0.0, 1.0);
    vec4 weights = mix(vec4(1.0 - part.x), vec4(part.x), right) * mix(vec4(1.0 - part.y), vec4(part.y), up);
    vec4 hidden = weights - weights * passing;
    blocked += vec2(dot(hidden, vec4(1.0)), dot(hidden, min(depths, view.far)));
    return dot(weights, passing);
}

// Half width on the map of the samples of a light, where what blocks it is at a depth.
float spread(ShadowView view, Receiver at, float radius, float blocker) {
    float gap = max(at.depth - blocker, 0.0);
    return view.parallel ? radius * gap : radius * gap / (at.depth * max(blocker, view.near));
}

vec2 light_sample(int k) {
    float angle = 2.39996323 * float(k);
    return sqrt((float(k) + 0.5) / float(shadow_samples)) * vec2(cos(angle), sin(angle));
}

// Share of light number `light` that reaches the fragment, whose normal is n.
float light_seen(int light, vec3 n) {
    vec3 maps = shadow_maps[light];
    int layer = int(maps.x);
    if (maps.y < 0.5) return 1.0;
    if (maps.y > 1.5) {  // a cube: the side that the fragment is on
        vec3 away = world_position - texelFetch(shadow_views, ivec2(3, layer), 0).xyz, size = abs(away);
        int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
        layer += axis + (away[axis] < 0.0 ? 3 : 0);
    }
    ShadowView view = shadow_view(layer);
    vec3 away = world_position - view.origin;
    float depth = dot(view.forward, away);
    Receiver at;
    at.texel = 2.0 * view.extent / float(textureSize(shadow_depths, 0).x) * (view.parallel ? 1.0 : max(depth, 0.0));
    away += at.texel * n;  // off the surface by a texel: more than a finely divided mesh is off from a round surface
    at.depth = dot(view.forward, away);
    vec2 across = vec2(dot(view.right, away), dot(view.up, away));
    vec3 normal = vec3(dot(view.right, n), dot(view.up, n), dot(view.forward, n));
    if (view.parallel) {
        at.place = across;
        at.over = vec3(-normal.xy, dot(normal, vec3(across, at.depth)));
        at.under = vec3(0.0, 0.0, min(normal.z, -1e-2));
    } else {
        at.place = across / at.depth;
        at.over = vec3(0.0, 0.0, at.depth * dot(normal, vec3(at.place, 1.0)));
        at.under = normal;
    }
    bool lit = dot(n, view.parallel ? view.forward : world_position - view.origin) < 0.0 && at.depth > 0.0;
    if (!lit) return 1.0;  // the cosine leaves it dark, or it is behind the map
    float unit = 2.0 * view.extent / float(textureSize(shadow_depths, 0).x);
    float wide = max(spread(view, at, maps.z, view.near), unit);
    vec2 blocked = vec2(0.0);
    // llvmpipe runs both sides of a branch, but no empty loop.
    bool far_off = any(greaterThan(abs(at.place) - wide, vec2(view.extent)));
    // Where a fragment is far behind the casters, samples of a parallel light look farther than the least depths know.
    bool known = wide + 10.0 * unit <= view.reach;  // which is a block of 8 texels more; 2 for the texels around
    int count = far_off || (known && clear(view, at)) ? 0 : shadow_samples;
    for (int k = 0; k < count; ++k) passes(view, at, at.place + wide * light_sample(k), blocked);
    if (blocked.x == 0.0) return 1.0;
    float narrow = max(spread(view, at, maps.z, blocked.y / blocked.x), unit), passing = 0.0;
    for (int k = 0; k < count; ++k) passing += passes(view, at, at.place + narrow * light_sample(k), blocked);
    return passing / float(shadow_samples);
}

void find_shadows(vec3 n) {
    for (int light = 0; light < shadow_lights; ++light) seen[light] = light_seen(light, n);
}
