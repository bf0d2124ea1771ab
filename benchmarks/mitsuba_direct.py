"""Draws scenes with Mitsuba 3, direct light only. benchmarks/mitsuba_clevr.py runs it.

Reads a list of scenes as JSON from standard input; for each, writes an .npz file with `radiance` [H, W, 3], linear. A
scene is lit by the point lights `lights`, and then the file has `lit` bool [H, W], the pixels whose middle ray meets a
surface that sees every light that it faces, and `sharp`, those of which the same holds for all points of the lights, or
for none, if they are balls of the radius `softness`; or by an environment map, `map`, a file of [rows, columns, 3].
"""

import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.mitsuba_shading import LLVM
from benchmarks.peers import reach

BODY = 0.96**2
"""The share of the base colour that glTF's dielectric body reflects of light that falls straight in: 0.96 (1 - F)."""
RUBBER = 0.92
"""The same for the preset `rubber`: 0.95 (1 - E)² / (1 - Ē), with E = 0.04 reflected by the dielectric and Ē = 0.05 of
light from all around (scripts/fit_materials.py)."""
ALPHA = {"rubber": 0.49, "metal": 0.16}
"""Roughnesses of the facets that the presets are fitted to."""
MOST = 64
"""Samples of a pixel that are drawn at once."""
Surface = Callable[[dict[str, Any]], dict[str, Any]]


def main() -> None:
    """Draws the scenes; `benchmarks.mitsuba_clevr` writes the requests."""
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", LLVM)
    reach()
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(int(os.environ.get("OMP_NUM_THREADS", "2")))
    for request in json.load(sys.stdin):
        radiance, lit, sharp = 0.0, True, True
        if "map" in request:
            for bsdf in MODELS[request["model"]]:
                scene = mi.load_dict(_scene(mi, request, None, bsdf))
                for seed in range(request["samples"]):
                    radiance = radiance + np.array(mi.render(scene, spp=MOST, seed=seed)) / request["samples"]
        # each light by itself: of several, Mitsuba samples one at random, which is noise
        for light in request.get("lights", ()):
            for bsdf in MODELS[request["model"]]:
                scene = mi.load_dict(_scene(mi, request, light, bsdf))
                radiance = radiance + np.array(mi.render(scene, spp=request["samples"], seed=0))
            seen = _lit(mi, scene, request, light["position"])
            lit = lit & seen
            around = np.array(light["position"]) + request.get("softness", 0.0) * AROUND
            sharp = sharp & np.all([_lit(mi, scene, request, place) == seen for place in around], axis=0)
        np.savez(request["out"], radiance=radiance, lit=lit, sharp=sharp, version=mi.__version__)


def _scene(mi: Any, request: dict[str, Any], light: dict[str, Any] | None, bsdf: Surface) -> dict[str, Any]:
    height, width = request["size"]
    direct = {"type": "direct", "bsdf_samples": 0 if light else 1}
    eye, scene = request["eye"], {"type": "scene", "integrator": direct}
    look = mi.ScalarTransform4f().look_at(origin=eye, target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    lens = {"fov": float(np.degrees(request["field_of_view"])), "fov_axis": "y", "near_clip": 0.01, "far_clip": 1000.0}
    scene["sensor"] = {"type": "perspective", "to_world": look, "film": film} | lens
    if light:
        intensity = {"type": "rgb", "value": light["energy"]}
        scene["light"] = {"type": "point", "position": light["position"], "intensity": intensity}
    else:
        scene["light"] = {"type": "envmap", "bitmap": mi.Bitmap(_as_image(np.load(request["map"])))}
    for k, thing in enumerate(request["things"]):
        scene[f"thing{k}"] = {"type": "ply", "filename": thing["file"], "surface": bsdf(thing)}
    return scene


def _as_image(sky: np.ndarray) -> np.ndarray:
    """A map whose columns run from +z to +x as Mitsuba's, which run from -z to +x."""
    return np.ascontiguousarray(np.roll(sky[:, ::-1], sky.shape[1] // 2, axis=1), np.float32)


def _preset_body(thing: dict[str, Any]) -> dict[str, Any]:
    share = {"matte": 1.0, "rubber": RUBBER, "metal": 0.0}[thing["preset"]]
    return {"type": "diffuse", "reflectance": _rgb([share * c for c in thing["color"]])}


def _preset_gloss(thing: dict[str, Any]) -> dict[str, Any]:
    if thing["preset"] == "matte":
        return {"type": "diffuse", "reflectance": _rgb([0.0, 0.0, 0.0])}
    return _gloss(thing | {"metallic": float(thing["preset"] == "metal"), "roughness": ALPHA[thing["preset"]] ** 0.5})


def _body(thing: dict[str, Any]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": _rgb([BODY * (1 - thing["metallic"]) * c for c in thing["color"]])}


def _gloss(thing: dict[str, Any]) -> dict[str, Any]:
    facets = {"distribution": "ggx", "alpha": thing["roughness"] ** 2}
    if thing["metallic"] == 1:
        return {"type": "roughconductor", "material": "none", "specular_reflectance": _rgb(thing["color"])} | facets
    return {"type": "roughplastic", "int_ior": 1.5, "diffuse_reflectance": _rgb([0.0, 0.0, 0.0])} | facets


def _rgb(color: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": color}


AROUND = np.concatenate([np.eye(3), -np.eye(3), np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T / 3**0.5])
"""Points of a unit ball's surface."""
MODELS: dict[str, list[Surface]] = {
    "layers": [_body, _gloss],
    "presets": [_preset_body, _preset_gloss],
}
"""The BSDFs whose images are added up: a Lambertian body and a rough dielectric, and for metals a rough conductor; or
the same of the torch renderer's presets matte, rubber and metal."""


def _lit(mi: Any, scene: Any, request: dict[str, Any], position: Sequence[float]) -> np.ndarray:
    """Pixels [H, W] whose middle ray meets a surface that faces away from the light or sees it."""
    height, width = request["size"]
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    at = mi.Point2f(x.ravel().astype(np.float32), y.ravel().astype(np.float32))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, at, mi.Point2f(0.5, 0.5))
    met = scene.ray_intersect(ray)
    place = mi.Point3f(*map(float, position))
    faces = np.array(mi.Float(_dot(met.sh_frame.n, place - met.p))) > 0
    hidden = faces & np.array(scene.ray_test(met.spawn_ray_to(place)))
    return (np.array(met.is_valid()) & ~hidden).reshape(height, width)


def _dot(one: Any, other: Any) -> Any:
    return one.x * other.x + one.y * other.y + one.z * other.z


if __name__ == "__main__":
    main()
