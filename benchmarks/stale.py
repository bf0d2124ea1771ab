"""Lists the committed results whose figures are older than the code.

    python -m benchmarks.stale              computes what the code does now (ten seconds of a processor), and lists them
    python -m benchmarks.stale --cached     lists them by what was computed last; does not import torch
    python -m benchmarks.stale sign FILE …  notes that these files were made just now, by the code as it is; benchmarks
                                            do so themselves

A result depends on renderers and networks (`DEPENDS`). The fingerprint of a renderer is a hash of 8-bit images of
twelve fixed scenes, in their own state and moved a little in every group, and of gradients rounded to 1e-4 where it has
them. That of a network is a hash of its scores for fixed images, computed in float64 and rounded to 1e-4. They are kept
beside the results, in results/fingerprints.json: a result is up to date if its file is the one that was signed and all
its fingerprints are those of today. What was never signed counts as stale, because nobody knows which code made it.

Images depend on the processor, too, and those of pyrender on the OpenGL driver; both are part of a fingerprint's name.
Drawn by another one, a result is neither up to date nor stale: it cannot be told here.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from torch import Tensor

    from scene_attack.rendering.protocol import Renderer
    from scene_attack.scenes.library import Library

ROOT = Path(__file__).parents[1]
SIGNED = Path(__file__).parent / "results" / "fingerprints.json"
CACHED = Path(__file__).parent / ".fingerprints.json"
"""The last computed fingerprints, with a hash of the code that computed them; ignored by git."""
CODE = ("services/scene_attack/rendering", "services/scene_attack/scenes", "services/scene_attack/targets")
"""The folders whose code decides images and scores."""
BOTH = ("pyrender", "torch")
LITE0, ALEXNET, RESNET, IEP = "efficientnet-lite0", "alexnet-furniture", "resnet34-furniture", "iep"
DEPENDS: dict[str, tuple[str, ...]] = {
    "benchmarks/results/attack_bounds.json": ("torch", LITE0),
    "benchmarks/results/gltf_materials.json": ("pyrender",),
    "benchmarks/results/jobs.json": (*BOTH, LITE0),
    "benchmarks/results/known_errors.json": ("torch", LITE0),
    "benchmarks/results/path_tracing.json": ("pyrender", LITE0),
    "benchmarks/results/peer_attacks.json": ("pyrender", LITE0),
    "benchmarks/results/scene_files.json": ("pyrender", LITE0),
    "benchmarks/results/sensor.json": ("pyrender",),
    "benchmarks/results/service_record.json": (),
    "benchmarks/results/shading.json": ("torch",),
    "benchmarks/results/zoo_step.json": ("pyrender", LITE0),
    "docs/accuracy/rasterised_images.json": ("pyrender",),
    "docs/accuracy/stability.json": (*BOTH, LITE0, ALEXNET, RESNET),
    "docs/accuracy/work-precision.json": (*BOTH, LITE0),
    "docs/results/combined.json": ("torch", LITE0),
    "docs/results/physical.json": ("torch", LITE0),
    "docs/results/vqa.json": ("pyrender", IEP),
    "docs/study/around.json": ("torch", RESNET),
    "docs/study/blender.json": ("pyrender", ALEXNET, RESNET),
    "docs/study/differentiable.json": ("torch", ALEXNET, RESNET),
    "docs/study/equal-p.json": (*BOTH, ALEXNET, RESNET),
    "docs/study/examples.json": (*BOTH, ALEXNET, RESNET, IEP),
    "docs/study/lite0.json": (*BOTH, LITE0),
    "docs/study/nondifferentiable.json": ("pyrender", ALEXNET, RESNET),
    "docs/study/one-look-alexnet.json": ("torch", ALEXNET),
    "docs/study/one-look-resnet34.json": ("torch", RESNET),
    "docs/study/second-opinion.json": (*BOTH, ALEXNET, RESNET),
    "docs/study/survival.json": (*BOTH, ALEXNET, RESNET),
    "docs/study/physical.json": ("torch", ALEXNET, RESNET),
    "docs/study/physical-lite0.json": ("torch", LITE0),
    "docs/study/pose.json": ("torch", ALEXNET, RESNET, LITE0),
    "docs/study/tolerances.json": ("torch", ALEXNET),
    "docs/study/vqa-differentiable.json": ("torch", IEP),
    "docs/study/vqa-nondifferentiable.json": ("pyrender", IEP),
}
"""The renderers and networks on which each result depends. Times alone depend on none, and are never stale."""


def _scene(*objects: dict[str, Any], **rest: Any) -> dict[str, Any]:
    return {"camera": {"size": [48, 64]} | rest.pop("camera", {}), "objects": list(objects), **rest}


SCENES = (
    _scene({"mesh": "primitive/sphere", "material": "glossy-paint"}),
    _scene({"mesh": "primitive/torus", "material": "brushed-metal", "color": [0.9, 0.6, 0.3]}),
    _scene({"mesh": "primitive/cube", "metallic": 1.0, "roughness": 0.2}, camera={"viewer": "perspective"}),
    _scene({"mesh": "primitive/cylinder", "material": "rubber", "rotation": [0.4, 0.0, 1.0]}),
    _scene({"mesh": "furniture/grand-piano", "material": "plastic"}),
    _scene({"mesh": "furniture/folding-chair"}, lights={"directional": [{"energy": 2.0, "direction": [-1, -2, -1]}]}),
    _scene({"mesh": "furniture/couch", "material": "matte"}, ground=[0.5, 0.4, 0.3]),
    _scene({"mesh": "furniture/soccer-ball"}, lights={"environment": {"map": "uniform"}}),
    _scene(
        {"mesh": "primitive/sphere", "scale": 0.5, "translation": [-0.4, 0.0, 0.0]},
        {"mesh": "primitive/cube", "scale": 0.4, "translation": [0.4, 0.0, 0.2], "color": [0.2, 0.3, 0.8]},
    ),
    _scene({"mesh": "furniture/toaster"}, floor={"size": 8.0}, shadows={"softness": 0.2, "resolution": 256}),
    _scene({"mesh": "furniture/helmet"}, lights={"spots": [{"energy": 30.0, "direction": [-1.2, -2.0, -1.5]}]}),
    _scene({"mesh": "furniture/clock"}, camera={"azimuth": 2.0, "elevation": 0.8, "field_of_view": 0.6}),
)
"""The scenes that are drawn: every kind of light, both viewers, a floor with shadows, materials and textures."""


def main() -> None:
    """Lists stale results, or signs files; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sign", nargs="*", help="sign, and the files to sign")
    parser.add_argument("--cached", action="store_true", help="compute nothing")
    options = parser.parse_args()
    if options.sign:
        if options.sign[0] != "sign" or len(options.sign) < 2:
            parser.error("give nothing, or: sign FILE …")
        sign([str(Path(name).resolve().relative_to(ROOT)) for name in options.sign[1:]], fingerprints())
        return
    today = cached() if options.cached else fingerprints()
    if today is None:
        print("the code of images and scores has changed since `python -m benchmarks.stale` computed what it does")
        return
    outdated = [(name, why) for name in DEPENDS if (why := stale(name, today)) is not None]
    print(f"{len(outdated)} of {len(DEPENDS)} results may be older than the code" + (":" if outdated else ""))
    for name, why in outdated:
        print(f"  {name}: {why}")


def stale(name: str, today: dict[str, str]) -> str | None:
    """Why a result may be older than the code, of which `today` has the fingerprints; None if it is not."""
    if not DEPENDS[name]:
        return None
    signed = json.loads(SIGNED.read_text("utf-8")) if SIGNED.exists() else {}
    if name not in signed:
        return "nobody knows which code made it"
    if signed[name]["file"] != _hash(ROOT / name):
        return "it was written again after it was signed"
    made_by: dict[str, str] = signed[name]["made by"]
    if unknown := [part for part in DEPENDS[name] if _key(part, today) != _key(part, made_by)]:
        return f"cannot be told here, where other programs draw or answer: {', '.join(unknown)}"
    changed = [part for part in DEPENDS[name] if today[_key(part, today)] != made_by[_key(part, made_by)]]
    return f"changed since: {', '.join(changed)}" if changed else None


def _key(part: str, prints: dict[str, str]) -> str:
    """The key of a renderer or network in `prints`: its name, then a space and what draws it if that matters, or ""."""
    return next((key for key in prints if key.partition(" ")[0] == part), "")


def sign(names: Sequence[str], today: dict[str, str]) -> None:
    """Notes that results were made by code with these fingerprints. Raises KeyError for one that is not in DEPENDS."""
    signed = json.loads(SIGNED.read_text("utf-8")) if SIGNED.exists() else {}
    for name in names:
        keys = [_key(part, today) for part in DEPENDS[name]]
        signed[name] = {"file": _hash(ROOT / name), "made by": {key: today[key] for key in keys if key}}
    SIGNED.write_text(json.dumps(dict(sorted(signed.items())), indent=1) + "\n", "utf-8")


def fingerprints() -> dict[str, str]:
    """The fingerprint of each renderer and each network that ships. Computed once for the code as it is."""
    if (known := cached()) is not None:
        return known
    from scene_attack.process import processor
    from scene_attack.rendering.opengl.context import gl_backend
    from scene_attack.runs.environment import options_to_run
    from scene_attack.runs.set_up import set_up
    from scene_attack.scenes.library import Library

    settings = options_to_run()
    set_up(settings)
    library = Library(settings.cache_dir, settings.data_dir)
    result = {f"torch {processor()}": renderer_print("torch", library)}
    result[f"pyrender {gl_backend()}; {processor()}"] = renderer_print("pyrender", library)
    result |= {name: network_print(name) for name in (LITE0, ALEXNET, RESNET, IEP)}
    CACHED.write_text(json.dumps({"code": _code(), "fingerprints": result}, indent=1) + "\n", "utf-8")
    return result


def cached() -> dict[str, str] | None:
    """The last result of `fingerprints` if the code has not changed since; else None."""
    if not CACHED.exists():
        return None
    last = json.loads(CACHED.read_text("utf-8"))
    return last["fingerprints"] if last["code"] == _code() else None


def renderer_print(name: str, library: Library, scenes: Sequence[dict[str, Any]] = SCENES) -> str:
    """A hash of a renderer's exact images of scenes, and of its gradients if it is differentiable."""
    from scene_attack.rendering.declaration import RENDERERS
    from scene_attack.rendering.factory import build
    from scene_attack.scenes.description import Scene
    from scene_attack.scenes.resolve import resolve

    hashed = hashlib.sha256()
    for scene in scenes:
        groups = RENDERERS[name].group_names
        renderer = build(resolve(Scene.model_validate(scene), library), name, groups=groups, tolerance="exact")
        for part in _behaviour(renderer):
            hashed.update(part.numpy().tobytes())
    return hashed.hexdigest()[:16]


def _behaviour(renderer: Renderer) -> Iterator[Tensor]:
    """Images uint8 [2, H, W, 3], the scene's own and a moved one, and rounded gradients of a weighted sum by group."""
    import torch

    from scene_attack.attacks.problem import generator
    from scene_attack.rendering.color import quantize
    from scene_attack.rendering.declaration import RENDERERS

    declared = RENDERERS[renderer.name]
    one_view = any(group.per_pixel for group in declared.groups)
    elsewhere = declared.moving_groups if one_view else ()  # from where the pixels of one view cannot be drawn
    own = {group: value for group, value in renderer.initial().items() if group not in elsewhere}
    bounds = renderer.bounds()
    moved = {}
    for group, value in own.items():
        low, high = (bound.expand_as(value) for bound in bounds[group])
        step = 0.01 * torch.randn(value.shape, generator=generator(0, group), dtype=value.dtype)
        moved[group] = torch.minimum(torch.maximum(value + step, low), high)
    batch = {group: torch.stack([value, moved[group]]) for group, value in own.items()}
    with torch.enable_grad():
        leaves = {group: value.requires_grad_(renderer.differentiable) for group, value in batch.items()}
        images = renderer.render(leaves)
        yield quantize(images.detach())[0]
        if renderer.differentiable:
            weights = torch.randn(images.shape, generator=generator(0, "weights"), dtype=images.dtype)
            for gradient in torch.autograd.grad((images * weights).sum(), list(leaves.values()), allow_unused=True):
                yield torch.zeros(0) if gradient is None else rounded(gradient)


def network_print(name: str) -> str:
    """A hash of a network's scores, in float64, for four fixed images of 96 × 128: noise of several grains."""
    import torch

    from scene_attack.attacks.problem import generator
    from scene_attack.targets import registry

    target = registry.load(name, torch.float64)
    images = torch.cat(
        [
            torch.nn.functional.interpolate(
                torch.rand((1, 3, size, size), generator=generator(0, "image", size), dtype=torch.float64),
                size=(96, 128),
                mode="bilinear",
                align_corners=True,
            )
            for size in (3, 8, 24, 80)
        ]
    ).permute(0, 2, 3, 1)
    with torch.no_grad():
        scores = registry.with_question(target, registry.card(name).example).logits(images)
    return hashlib.sha256(rounded(scores).numpy().tobytes()).hexdigest()[:16]


def rounded(values: Tensor) -> Tensor:
    """Multiples of 1e-4, as int64: float64 sums in another order do not change them."""
    import torch

    return (values.double() * 1e4).round().to(torch.int64)


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _code() -> str:
    """A hash of the files of CODE and of the packages that compute."""
    from scene_attack.process import versions

    hashed = hashlib.sha256(str(versions("torch", "numpy", "pyrender-maintained", "PyOpenGL")).encode())
    command = ["git", "ls-files", "-co", "--exclude-standard", *CODE]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in sorted(listed.splitlines()):
        if (ROOT / name).is_file():
            hashed.update(f"{name} {_hash(ROOT / name)}\n".encode())
    return hashed.hexdigest()


if __name__ == "__main__":
    main()
