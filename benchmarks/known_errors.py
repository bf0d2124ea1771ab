"""Measures what is known to be inexact (docs/accuracy.md) and has no other report.

edges     The torch renderer shades a pixel once, by the mean normal of its samples, but the surfaces of a pixel apart
          if the scene has a floor. The same view with and without a floor of a few pixels beside the objects: the
          share of the covered pixels that differ by more than 1/255, the largest difference, and p of the two images.
rounding  An attack takes the network's gradient at the image of 8 bits. The gradient of the log-odds of the network's
          label with respect to the normals, through the exact image and through that of a plan of the default
          tolerance, rounded or not: the share of signs that change, by number and by weight (the gradient's length).

Results are written to results/known_errors.json in a minute: python -m benchmarks.known_errors
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.report import RESULTS, save
from scene_attack.process import use
from scene_attack.rendering.plan import DEFAULT_TOLERANCE
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack.targets import registry
from scene_attack.targets.protocol import Target
from scene_attack.targets.scores import log_odds
from scene_attack_service.settings import Settings

SPECK = {"size": 0.02, "height": -0.35}
"""A floor of a few pixels below the objects."""
EDGES = (
    *(("primitive/cube", "metal"), ("furniture/chair", "metal"), ("furniture/drill", "plastic")),
    *(("furniture/grand-piano", "plastic"), ("furniture/grand-piano", "metal")),
)
ROUNDED = ("furniture/grand-piano", "furniture/soccer-ball", "furniture/drill")


def edges(mesh: str, material: str, library: Library) -> dict[str, object]:
    """How far one view is from the same with the surfaces of its pixels shaded apart."""
    thing = {"mesh": mesh, "material": material}
    once, apart = (
        resolve(Scene.model_validate({"objects": [thing], "floor": floor}), library) for floor in (None, SPECK)
    )
    images = [TorchRenderer(scene, tolerance="exact").render({})[0] for scene in (once, apart)]
    covered = ((images[0] - torch.tensor(once.description.ground)).abs() > 1e-6).any(dim=-1)
    error = (images[0] - images[1]).abs()
    largest = error.amax(dim=-1)[covered]
    return {
        "mesh": mesh,
        "material": material,
        "covered pixels": int(covered.sum()),
        "more than 1/255": float((largest > 1 / 255).double().mean()),
        "largest": float(largest.max()),
        "p": float(error.square().sum(dim=-1).mean().sqrt()),
    }


def rounding(mesh: str, library: Library, target: Target) -> dict[str, object]:
    """How many signs of the normals' gradient the rounding to 8 bits changes, and how many the plan does."""
    scene = resolve(Scene.model_validate({"objects": [{"mesh": mesh, "material": "plastic"}]}), library)
    planned = TorchRenderer(scene, groups=("normals",), tolerance=DEFAULT_TOLERANCE)
    exact = planned.exact()
    normals = planned.initial()["normals"]

    def gradient(renderer: Renderer, dtype: torch.dtype, rounded: bool) -> Tensor:
        leaf = normals.to(dtype)[None].requires_grad_()
        image = renderer.render({"normals": leaf})
        shown = image.detach().float()
        pixels = ((shown * 255).round() / 255 if rounded else shown).requires_grad_()
        scores = target.logits(pixels)[0]
        (weights,) = torch.autograd.grad(log_odds(scores, (int(scores.argmax()),)), pixels)
        return torch.autograd.grad((image * weights.to(dtype)).sum(), leaf)[0].double().flatten()

    true = gradient(exact, torch.float64, rounded=False)
    changes = {
        "rounding": gradient(exact, torch.float64, rounded=True),
        "plan": gradient(planned, torch.float32, rounded=False),
    }
    row: dict[str, object] = {"mesh": mesh}
    for name, changed in changes.items():
        wrong = (changed.sign() != true.sign()) & (true != 0)
        row[f"{name}: signs"] = float(wrong.sum() / (true != 0).sum())
        row[f"{name}: signs by weight"] = float(true[wrong].abs().sum() / true.abs().sum())
        row[f"{name}: cosine"] = float(true @ changed / (true.norm() * changed.norm()))
    return row


def main() -> None:
    """Measures both, and writes the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS / "known_errors.json")
    arguments = parser.parse_args()
    settings = Settings()
    use(settings)
    library = Library(settings.cache_dir, settings.data_dir)
    target = registry.load("efficientnet-lite0")
    backend = TorchRenderer(resolve(Scene.model_validate({"objects": [{"mesh": "primitive/cube"}]}), library)).backend
    rows = {
        "edges": [edges(mesh, material, library) for mesh, material in EDGES],
        "rounding": [rounding(mesh, library, target) for mesh in ROUNDED],
    }
    save(
        arguments.out, "what is known to be inexact: inner edges, and signs of rounded gradients", backend, None, **rows
    )


if __name__ == "__main__":
    main()
