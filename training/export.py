"""Writes a trained network's weights in 8 bits, what was measured of it, and the cards of the model and of its data."""

import hashlib
import json
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from services import disk
from services.scenes.library import Library
from services.targets.networks.alexnet import AlexNet
from services.targets.networks.resnet import ResNet
from services.targets.weights_file import dequantize, load_into, quantize, to_bytes
from training.batches import MEAN, SCALE
from training.cards import data_card, model_card
from training.evaluation import RENDERERS, VIEWS, Images, answers, clustered_error, confusion, held_out, wilson
from training.recipe import Recipe
from training.split import Split
from training.training import Trained, weights
from training.views import INPUT

ARCHITECTURES = {"alexnet": AlexNet, "resnet34": ResNet}


@dataclass(frozen=True)
class Written:
    """The files that were written, and the result in a line."""

    weights: Path
    facts: Path
    card: Path
    data_card: Path
    summary: str


def write(
    recipe: Recipe,
    trained: Trained,
    split: Split,
    library: Library,
    cache: Path,
    out: Path,
    said: Callable[[str, int, int], None],
) -> Written:
    """Measures a trained network on the held-out models and writes its files to `out`."""
    images = held_out(library, split.models("held_out"), cache / "training" / "held_out", said)
    name = f"{recipe.network}-furniture"
    state = weights(trained.network)
    data = to_bytes(state)
    plain = answers(trained.network, images)
    said("measuring", 1, 2)
    answered = answers(architecture(recipe.network, len(split.classes), dequantize(quantize(state))), images)
    said("measuring", 2, 2)
    facts = {
        "name": name,
        "architecture": recipe.network,
        "labels": list(split.classes),
        "input_size": [INPUT, INPUT],
        "mean": list(MEAN),
        "scale": list(SCALE),
        "sha256": hashlib.sha256(data).hexdigest(),
        "bytes": len(data),
        "command": _command(recipe.network, trained),
        "recipe": asdict(recipe),
        "seed": trained.seed,
        "steps": trained.steps,
        "minutes": round(trained.seconds / 60, 1),
        "training_models": len(split.models("training")),
        "training_views": trained.views,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "held_out": measured(answered, images, split),
        "held_out_before_quantisation": float((plain == images.classes).double().mean()),
    }
    written = Written(
        weights=out / f"{name}.safetensors",
        facts=out / f"{name}.json",
        card=out / f"{name}.md",
        data_card=out / "furniture-views.md",
        summary=_summary(facts),
    )
    disk.write(written.weights, data)
    disk.write(written.facts, (json.dumps(facts, indent=1) + "\n").encode())
    disk.write(written.card, model_card(facts).encode())
    disk.write(written.data_card, data_card(split, recipe).encode())
    return written


def architecture(name: str, classes: int, state: dict[str, Tensor]) -> nn.Module:
    """Returns the network with these weights, in evaluation."""
    made: nn.Module = ARCHITECTURES[name](classes)
    load_into(made, state)
    return made.eval()


def measured(answered: Tensor, images: Images, split: Split) -> dict[str, Any]:
    """Returns held-out accuracies with their intervals and errors, and the confusion matrix."""
    right = answered == images.classes
    of = [images.classes == number for number in range(len(split.classes))]
    return {
        "models": int(images.models.max()) + 1,
        "views_per_model": VIEWS * len(RENDERERS),
        "accuracy": _share(right, images.models),
        "by_renderer": {
            name: _share(right[images.renderers == number], images.models[images.renderers == number])
            for number, name in enumerate(RENDERERS)
        },
        "by_class": {
            kind: _share(right[own], images.models[own] - images.models[own].min())
            for kind, own in zip(split.classes, of, strict=True)
        },
        "confusion": confusion(answered, images.classes, len(split.classes)),
    }


def _share(right: Tensor, models: Tensor) -> dict[str, Any]:
    count, of = int(right.sum()), len(right)
    return {
        "right": count,
        "views": of,
        "models": len(torch.unique(models)),
        "share": count / of,
        "wilson": wilson(count, of),
        "standard_error": clustered_error(right, models),
    }


def _command(name: str, trained: Trained) -> str:
    budget = trained.budget
    length = f"--epochs {budget.epochs}" if budget.minutes is None else f"--minutes {budget.minutes:g}"
    return f"python -m training {name} {length} --seed {trained.seed}"


def _summary(facts: dict[str, Any]) -> str:
    found = facts["held_out"]["accuracy"]
    before = facts["held_out_before_quantisation"]
    return (
        f"{facts['name']}: held-out top-1 {100 * found['share']:.1f} ± {100 * found['standard_error']:.1f} % "
        f"({found['right']} of {found['views']} views of {found['models']} models, {len(facts['labels'])} classes); "
        f"before quantisation {100 * before:.1f} %"
    )
