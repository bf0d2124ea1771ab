"""The sabotage table of the formulas: what is wrong in the product, and in each family the cases that notice it."""

from tests.unit.accuracy import damaged_materials as materials
from tests.unit.accuracy import damaged_scenes as scenes
from tests.unit.accuracy import damaged_shaders as shaders
from tests.unit.accuracy import damaged_shadows as shadows
from tests.unit.accuracy import damaged_steps as steps

DIFFERENCES = ["difference, λ 3, δ 0.05", "difference, λ 0.3, δ 0.01", "difference, λ 10, δ 0.1"]
FILES = ["pixel 15 of row 2 lit", "pixel 2 of row 5 lit", "pixel 31 of row 8 lit", "pixel 30 of row 12 lit"]
QUARTERS = ["four quarters", "repeated three times", "four quarters from a file"]
GIVEN = "given surfaces on a floor"
FACTORS = ["metal, roughness 0.3", "dielectric, roughness 0.8", "half metal, emissive", "given metal, roughness 0.3"]
NORMAL_MAPS = [
    "normal map",
    "normal map, mirrored texture",
    "normal map, mirrored node",
    "normal map, on the back",
    "normal map, stated tangent",
]
SUNS = "suns and spots on a coloured cube"

MUTANTS = [
    # pyrender's light
    (shaders.no_inverse_pi, {"lights": ["0.5 to 3 away", "grazing light"], "sizes": ["1 px, pyrender"]}),
    (shaders.inverse_distance, {"lights": ["0.5 to 3 away", "1e4 away"], "sizes": ["300×7 px, pyrender"]}),
    (shaders.no_gloss, {"lights": ["0.5 to 3 away", "sky from above"], "views": ["filling the frame"]}),
    (shaders.flat_sky, {"lights": ["sky from above", "sky from below"], "views": ["camera inside the object"]}),
    (shaders.color_squared, {"lights": ["four lights on a coloured cube"], "textures": ["four quarters"]}),
    (shaders.no_fresnel, {"lights": ["four lights on a coloured cube", "grazing light"]}),
    (shaders.other_half_vector, {"lights": ["1e4 away", "1e15 away"]}),
    (shaders.light_on_both_sides, {"lights": ["in the object's centre"]}),
    (shaders.short_normals, {"lights": ["smooth normals on large faces"]}),
    (scenes.half_exposure, {"lights": ["1e4 away"], "sizes": ["1 px, pyrender"], "textures": ["four quarters"]}),
    (scenes.half_energy, {"lights": ["0.5 to 3 away", "energy of 1e-30 to 1e6"]}),
    (scenes.swapped_axes, {"lights": ["0.5 to 3 away", "1e-4 above the surface"]}),
    (scenes.channels_swapped, {"textures": ["four quarters"]}),
    # shadows
    (
        shadows.no_maps,
        {"shadows": ["a ball on the ground", "light 3° above the ground", "an object moved out of the map"]},
    ),
    (shadows.no_casters, {"shadows": ["light among the objects", "light inside an object", "a light 1e5 away"]}),
    (shadows.too_near, {"shadows": ["no occluder", "no occluder, grazing", "a ball alone"]}),
    (shadows.rays_miss, {"shadows": ["every texel over the ground"]}),
    # textures
    (shaders.texture_upside_down, {"textures": [*QUARTERS, "a quarter cut out"]}),
    (shaders.texture_mirrored, {"textures": [*QUARTERS, "a quarter cut out"]}),
    (shaders.texture_not_repeated, {"textures": ["repeated three times"]}),
    (shaders.texture_as_displayed, {"textures": ["texels smaller than a pixel"]}),
    (shaders.other_texture_curve, {"textures": ["four quarters"]}),
    (shaders.holes_everywhere, {"textures": ["a quarter cut out"]}),
    (scenes.files_upside_down, {"textures": ["four quarters from a file"]}),
    # suns, spot lights and the materials of glTF files
    (materials.straight_cone, {"lights": [SUNS], "materials": FACTORS}),
    (materials.spots_without_distance, {"lights": [SUNS], "materials": FACTORS}),
    (materials.suns_from_behind, {"lights": [SUNS], "materials": FACTORS}),
    (materials.no_inner_angle, {"lights": [SUNS], "materials": FACTORS}),
    (materials.rough_alpha, {"materials": [*FACTORS, GIVEN]}),
    (materials.other_shadowing, {"materials": FACTORS[:3]}),
    (materials.files_shadowing, {"materials": ["given metal, roughness 0.3", GIVEN]}),
    (materials.files_own_surface, {"materials": ["given metal, roughness 0.3", GIVEN]}),
    (materials.rasteriser_without_metal, {"materials": [GIVEN]}),
    (materials.metal_with_a_body, {"materials": ["metal, roughness 0.3", "half metal, emissive", "no factors"]}),
    (materials.white_metal, {"materials": ["metal, roughness 0.3", "half metal, emissive", "no factors"]}),
    (materials.sky_not_mirrored, {"materials": FACTORS}),
    (materials.colored_emission, {"materials": ["half metal, emissive", "every map"]}),
    (materials.hidden_emission, {"materials": ["every map"]}),
    (materials.no_emission, {"materials": ["half metal, emissive", "every map", "blended"]}),
    (materials.occluded_lights, {"materials": ["every map"]}),
    (materials.rougher, {"materials": ["metal, roughness 0.3"]}),
    (materials.emission_through, {"materials": ["blended"]}),
    (materials.opaque_blends, {"materials": ["blended"]}),
    (materials.channels_exchanged, {"materials": ["every map"]}),
    (materials.full_occlusion, {"materials": ["every map"]}),
    (materials.decoded_twice, {"materials": ["every map", "second texture coordinates"]}),
    (materials.emission_as_it_is, {"materials": ["every map"]}),
    (materials.no_vertex_colors, {"materials": ["every map", "no factors"]}),
    (materials.first_coordinates, {"materials": ["second texture coordinates"]}),
    (materials.cut_at_cutoff, {"materials": ["alpha at the cutoff"]}),
    (materials.fixed_cutoff, {"materials": ["alpha at the cutoff"]}),
    (materials.green_flipped, {"materials": NORMAL_MAPS}),
    (materials.full_bend, {"materials": NORMAL_MAPS}),
    (materials.right_handed, {"materials": ["normal map, stated tangent", "normal map, mirrored texture"]}),
    (materials.backs_bent_forwards, {"materials": ["normal map, on the back"]}),
    (materials.unseen_mirrors, {"materials": ["backs and mirrors", "normal map, mirrored node"]}),
    (materials.all_double_sided, {"materials": ["backs and mirrors"]}),
    # the torch renderer's light
    (scenes.half_white, {"environments": ["constant map", *FILES], "plans": ["tolerance exact"]}),
    (scenes.no_inverse_pi, {"environments": ["constant map", *FILES], "plans": ["tolerance exact"]}),
    (scenes.mirrored_maps, {"environments": FILES}),
    (scenes.maps_upside_down, {"environments": FILES}),
    (scenes.maps_turned, {"environments": FILES}),
    (scenes.map_turned_back, {"environments": ["map turned by 0.7"]}),
    (scenes.directions_swapped, {"environments": FILES, "plans": ["tolerance exact"], "sizes": ["1 px, torch"]}),
    (scenes.no_solid_angles, {"environments": ["map × 1e30", "map × 1e-36"], "sizes": ["white albedo"]}),
    (scenes.unchecked_tables, {"plans": ["normals only, broad sun", "material only, broad sun"]}),
    (scenes.linear_tables, {"plans": ["table of a known function"]}),
    # display, coverage, poses
    (scenes.other_gamma, {"precision": ["display curve"]}),
    (scenes.other_inverse_gamma, {"precision": ["display curve"]}),
    (scenes.squared_coverage, {"poses": ["silhouette of a square"]}),
    (scenes.squared_coverage_over_ground, {"poses": ["silhouette of a square"]}),
    (scenes.turned_back, {"poses": ["turned object", "object turned by an attack"]}),
    (scenes.mirrored_camera, {"poses": ["turned object"]}),
    (scenes.rolled_back_camera, {"poses": ["camera moved by an attack"]}),
    # attacks
    (steps.one_sided_differences, {"recurrences": [*DIFFERENCES, "ZOO, 8 steps, λ 0.5"], "differences": ["δ = 1"]}),
    (steps.differences_over_one_step, {"recurrences": DIFFERENCES, "differences": ["δ = 1", "δ from 1e-1 to 1e-12"]}),
    (steps.negative_weight, {"recurrences": [*DIFFERENCES, "ZOO, 8 steps, λ 0.5"]}),
    (steps.weight_of_distance, {"recurrences": [*DIFFERENCES, "ZOO, 8 steps, λ 0.5"]}),
    (steps.gradient_through_held_pixels, {"recurrences": ["all beyond U", "a third beyond U"]}),
    (steps.truncated_around_grey, {"recurrences": ["all beyond U"], "sizes": ["1 px, its own value"]}),
    (steps.twice_the_limit, {"recurrences": ["all beyond U"], "sizes": ["1 px, attacked"]}),
    (steps.no_momentum, {"recurrences": ["momentum"], "steps": ["momentum, no gradient"]}),
    (steps.no_decay, {"recurrences": ["decay"], "steps": ["momentum, no gradient"]}),
    (steps.cut_velocity, {"recurrences": ["momentum against bounds"]}),
    (steps.uphill, {"recurrences": ["signs alone"], "logits": ["two classes", "1000 tied"]}),
    (steps.negative_advantage, {"recurrences": ["ZOO, 8 steps"], "logits": ["margin of 20", "1000 behind"]}),
    (steps.hinged_advantage, {"recurrences": ["ZOO, 8 steps"], "logits": ["1000 behind"]}),
    (steps.no_bias_correction, {"recurrences": ["ZOO, 8 steps"]}),
    (steps.swapped_betas, {"recurrences": ["ZOO, 8 steps, λ 0.5"]}),
    (steps.unmeasured_step, {"recurrences": ["measured δ"]}),
]
"""No 1/π, 1/d for 1/d², no gloss, a flat sky, colours squared, half the exposure, textures upside down, mirrored maps,
one-sided differences, λ's sign and gradients through truncated pixels are the eleven that the cases once missed."""
