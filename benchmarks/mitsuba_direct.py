"""Draws scenes with Mitsuba 3 under point lights, direct light only. benchmarks/mitsuba_scenes.py runs it.

Reads a list of scenes as JSON from standard input; for each, writes an .npz file with `radiance` [H, W, 3], linear, and
`lit` bool [H, W]: the pixels whose middle ray meets a surface that sees every light that it faces.
"""

import json
import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.mitsuba_shading import LLVM
from benchmarks.peers import reach

BODY = 0.96**2
"""The share of the base colour that glTF's dielectric body reflects of light that falls straight in: 0.96 (1 - F)."""
Surface = Callable[[dict[str, Any]], dict[str, Any]]


def main() -> None:
    """Draws the scenes; `benchmarks.mitsuba_scenes.mitsuba` writes the requests."""
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", LLVM)
    reach()
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(int(os.environ.get("OMP_NUM_THREADS", "2")))
    for request in json.load(sys.stdin):
        radiance, lit = 0.0, True
        for light in request["lights"]:  # each by itself: Mitsuba samples one of several at random, which is noise
            for bsdf in MODELS[request["model"]]:
                scene = mi.load_dict(_scene(mi, request, light, bsdf))
                radiance = radiance + np.array(mi.render(scene, spp=request["samples"], seed=0))
            lit = lit & _lit(mi, scene, request, light)
        np.savez(request["out"], radiance=radiance, lit=lit, version=mi.__version__)


def _scene(mi: Any, request: dict[str, Any], light: dict[str, Any], bsdf: Surface) -> dict[str, Any]:
    height, width = request["size"]
    eye, scene = request["eye"], {"type": "scene", "integrator": {"type": "direct", "bsdf_samples": 0}}
    look = mi.ScalarTransform4f().look_at(origin=eye, target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    lens = {"fov": float(np.degrees(request["field_of_view"])), "fov_axis": "y", "near_clip": 0.01, "far_clip": 1000.0}
    scene["sensor"] = {"type": "perspective", "to_world": look, "film": film} | lens
    intensity = {"type": "rgb", "value": light["energy"]}
    scene["light"] = {"type": "point", "position": light["position"], "intensity": intensity}
    for k, thing in enumerate(request["things"]):
        scene[f"thing{k}"] = {"type": "ply", "filename": thing["file"], "surface": bsdf(thing)}
    return scene


def _principled(thing: dict[str, Any]) -> dict[str, Any]:
    values = {"metallic": thing["metallic"], "roughness": thing["roughness"], "specular": 0.5}
    return {"type": "principled", "base_color": _rgb(thing["color"])} | values


def _body(thing: dict[str, Any]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": _rgb([BODY * (1 - thing["metallic"]) * c for c in thing["color"]])}


def _gloss(thing: dict[str, Any]) -> dict[str, Any]:
    facets = {"distribution": "ggx", "alpha": thing["roughness"] ** 2}
    if thing["metallic"] == 1:
        return {"type": "roughconductor", "material": "none", "specular_reflectance": _rgb(thing["color"])} | facets
    return {"type": "roughplastic", "int_ior": 1.5, "diffuse_reflectance": _rgb([0.0, 0.0, 0.0])} | facets


def _rgb(color: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": color}


MODELS: dict[str, list[Surface]] = {"principled": [_principled], "layers": [_body, _gloss]}
"""The BSDFs whose images are added up. Either Disney's principled one of the same base colour, metallic and roughness,
with 4 % at normal incidence; or a Lambertian body and a rough dielectric, and for metals a rough conductor."""


def _lit(mi: Any, scene: Any, request: dict[str, Any], light: dict[str, Any]) -> np.ndarray:
    """Pixels [H, W] whose middle ray meets a surface that faces away from the light or sees it."""
    height, width = request["size"]
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    at = mi.Point2f(x.ravel().astype(np.float32), y.ravel().astype(np.float32))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, at, mi.Point2f(0.5, 0.5))
    met = scene.ray_intersect(ray)
    place = mi.Point3f(*light["position"])
    faces = np.array(mi.Float(_dot(met.sh_frame.n, place - met.p))) > 0
    hidden = faces & np.array(scene.ray_test(met.spawn_ray_to(place)))
    return (np.array(met.is_valid()) & ~hidden).reshape(height, width)


def _dot(one: Any, other: Any) -> Any:
    return one.x * other.x + one.y * other.y + one.z * other.z


if __name__ == "__main__":
    main()
