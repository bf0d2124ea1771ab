"""The sabotage table of the cases: for each family, what is broken and the cases that fail for it."""

from tests.unit.accuracy import damaged_attacks, damaged_geometry, damaged_images, damaged_shading

BROKEN = {
    "lobes": [
        (damaged_shading.naive_lobes, ["κ 1e4, γ 1", "κ → 0"]),
        (
            damaged_shading.blunter_lobes,
            ["κ 1e4, γ 1e5", "κ 0.5, γ 1e5", "κ 88, γ 1e3", "κ 0.5, γ 300", "material + 1e6", "material − 1e6"],
        ),
        (damaged_shading.brighter_lobes, ["κ 0.3, γ 1e-3"]),
        (damaged_shading.wrong_gradients, ["gradient, κ 4, γ 300", "gradient, κ 0.3, γ 1"]),
        (
            damaged_shading.colored_gloss,
            [
                "red plastic",
                "red glossy-paint",
                "gradient by material, red paint",
                "gradient by illumination_rgb, red paint",
            ],
        ),
        (damaged_shading.colorless_metal, ["red brushed-metal"]),
    ],
    "normals": [
        (
            damaged_shading.turned_normals,
            ["upper pole", "lower pole", "view axis", "grazing", "back-facing, oblique", "angles of 1e3"],
        ),
        (damaged_images.lighter_images, ["back-facing"]),
        (damaged_shading.blunt_poles, ["azimuth at the upper pole", "azimuth at the lower pole"]),
        (
            damaged_shading.wrong_gradients,
            ["gradient beside the pole", "gradient on the view axis", "gradient when grazing"],
        ),
        (damaged_shading.angles_by_arc_cosine, ["vector to angles and back"]),
        (damaged_geometry.long_normals, ["edge-on square"]),
    ],
    "environments": [
        (
            damaged_shading.brighter_light,
            [
                "sun of 1e6 in a sky of 1",
                "sun of 1e6 in darkness",
                "a smaller sun of 1e6",
                "constant map",
                "1×1 map",
                "light opposite the viewer",
            ],
        ),
        (damaged_shading.naive_lobes, ["sun of 1e6 on a mirror"]),
        (damaged_shading.unguarded_light, ["all-zero map"]),
        (damaged_shading.unscaled_light, ["map × 1e30", "map × 1e-36"]),
        (damaged_shading.accepted_texels, ["+inf texel", "−inf texel", "NaN texel", "negative texel"]),
        (
            damaged_shading.means_of_texels,
            ["1×1 source", "512×256 source", "4096×2048 source", "map turned by 2π", "map turned by 1e-9"],
        ),
    ],
    "plans": [
        (
            damaged_shading.brighter_light,
            [
                "normals only, broad sun",
                "illumination only, sun of 1e6",
                "illumination_rgb only, sun of 1e6",
                "material only, broad sun",
                *(f"{group} only, moved far" for group in ("normals", "illumination")),
                *(f"tolerance {tolerance}" for tolerance in ("exact", 1e-6, 1e-5, 1e-2)),
            ],
        ),
        (damaged_shading.naive_lobes, ["material only, moved far"]),
        (damaged_shading.swapped_light, ["illumination_rgb only, moved far", "illumination_rgb only, gradient"]),
        (damaged_shading.colorless_light, ["illumination_rgb only, moved far", "illumination_rgb only, gradient"]),
        (damaged_shading.far_too_bright_light, ["tolerance 0.1"]),
        (
            damaged_shading.wrong_gradients,
            ["normals only, gradient", "illumination only, gradient", "material only, gradient"],
        ),
        (damaged_images.lighter_images, ["illumination only, off"]),
    ],
    "views": [
        (
            damaged_geometry.shifted_frames,
            [
                "three pixels across",
                "filling the frame",
                "camera inside the object",
                "cut by the near plane",
                "cube around the near plane",
                "straight above",
                "straight below",
                "telephoto",
                "fish eye",
            ],
        ),
        (damaged_geometry.anything_in_view, ["out of view", "behind the camera", "less than a pixel"]),
    ],
    "poses": [
        (damaged_images.moved_by_parameters, ["moved out of view", "moved 1e15 away"]),
    ],
    "meshes": [
        (damaged_geometry.kept_faces, ["degenerate triangles"]),
        (damaged_geometry.lost_duplicates, ["duplicate triangles"]),
        (damaged_geometry.fitted_by_mean, ["torn open"]),
        (damaged_geometry.no_orientation, ["partly inside out"]),
        (damaged_geometry.no_weld, ["unwelded", "20k triangles", "200k triangles"]),
        (damaged_geometry.lost_faces, ["inside out", "shuffled"]),
        (damaged_geometry.narrow_range, ["1e-6 in size", "1e-20 in size", "1e6 in size", "1e20 in size"]),
        (damaged_geometry.float32_files, ["1e6 from the origin"]),
        (damaged_geometry.shifted_frames, ["one triangle", "a chair as it is found"]),
        (
            damaged_geometry.any_file,
            [
                "NaN vertex",
                "infinite vertex",
                "coordinates of 1e31",
                "all at one point",
                "all on one line",
                "too many triangles",
            ],
        ),
    ],
    "lights": [
        (
            damaged_geometry.stray_light,
            [
                "in the object's centre",
                "just below the surface",
                "opposite the viewer",
                "on the surface",
                "1e-4 above the surface",
                "1e4 away",
                "1e15 away",
                "energy of 1e-30 to 1e6",
                "energy of 3e7",
            ],
        ),
        (damaged_geometry.no_checks, ["1e25 away", "infinite energy", "NaN position", "energy beyond float32"]),
    ],
    "logits": [
        (
            damaged_attacks.odds_of_probabilities,
            ["margin of 20", "margin of 90", "margin of 1000", "1000 behind", "scores × 1000", "scores of ±1e38"],
        ),
        (damaged_attacks.no_odds, ["scores × 1e-6"]),
        (damaged_attacks.ties_by_value, ["two tied", "1000 tied"]),
        (damaged_attacks.odds_by_largest, ["two classes"]),
        (
            damaged_attacks.any_number_of_labels,
            ["one class, its gradient", "one class, its advantage", "one class, attacked"],
        ),
        (damaged_geometry.no_checks, ["NaN score", "infinite score"]),
    ],
    "differences": [
        (
            damaged_attacks.never_flat,
            [
                "δ = 1e-12, pixels",
                "δ = 1e-12, pyrender",
                "δ = 1e-12, torch",
                "ZOO with δ = 1e-12",
                "δ = 1",
                "δ from 1e-1 to 1e-12",
            ],
        ),
    ],
    "steps": [
        (damaged_attacks.drifting, ["η = 0, pixels", "η = 0, torch", "momentum, no gradient"]),
        (damaged_attacks.runaway, ["η = 1e3, normals"]),
        (
            damaged_attacks.no_bounds,
            [
                "η = 1e3, illumination",
                "η = 1e3, material",
                "normals + 1e6",
                "η = 1e3, pyrender",
                "η = 1e3, decay 1",
            ],
        ),
        (damaged_attacks.silent, ["no gradient, 120 steps"]),
        (damaged_attacks.exact_limit, ["moved by exactly U"]),
    ],
    "sizes": [
        (damaged_shading.brighter_light, ["1 px, torch", "1×300 px", "257² px", "2048² px, torch", "white albedo"]),
        (damaged_images.lighter_images, ["black albedo"]),
        (damaged_attacks.no_limit, ["1 px, attacked", "1 px, its own value"]),
        (damaged_images.grainy_images, ["1 px, pyrender", "300×7 px, pyrender", "2048² px, pyrender"]),
    ],
    "precision": [
        (damaged_images.eight_bit_images, ["bf16 parameters"]),
        (damaged_attacks.narrow_rounding, ["bf16 image"]),
        (damaged_attacks.narrow_odds, ["bf16 scores"]),
        (damaged_attacks.narrow_scores, ["bf16 network"]),
        (damaged_attacks.short_seeds, ["seeds 0 and 2⁶³ − 1"]),
        (damaged_attacks.any_seed, ["seed −1", "seed 2⁶³"]),
    ],
}
