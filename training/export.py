"""Measures a trained network on views of the held-out models, by the project's own renderers; writes its weights in 8
bits, the measurements, and the cards of the model and of its data.
"""

import hashlib
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import safetensors.numpy
import torch
from safetensors.torch import save
from torch import Tensor, nn
from torch.nn import functional as F

from scene_attack import disk
from scene_attack.analysis.verdict import wilson
from scene_attack.rendering import color
from scene_attack.rendering.factory import build
from scene_attack.scenes.description import Camera, Scene, SceneObject
from scene_attack.scenes.furniture import PREFIX
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack.targets.architectures import fill_by_name
from scene_attack.targets.networks import AlexNet, ResNet
from scene_attack.targets.weights_file import dequantize, quantize, to_bytes
from training.batches import MEAN, SCALE, normalised
from training.loop import Said
from training.split import AT_MOST, HELD_OUT, MIN_FAMILIES, MIN_HELD_OUT, MIN_MODELS, Split
from training.training import DEFAULT_SCENES, Recipe, Trained, weights
from training.views import INPUT, paper_cameras

RENDERERS = ("torch", "pyrender")
SIZE = 224
"""Side of the held-out views, pixels; a network resizes them to its input, as a target does."""
VIEWS = 6
"""Views of a model by each renderer, at the paper's elevation and distance, all around."""
AT_ONCE = 48


@dataclass(frozen=True)
class Images:
    """Held-out views: uint8 [N, SIZE, SIZE, 3], and of each its class, its model (by number) and its renderer."""

    images: Tensor
    classes: Tensor
    models: Tensor
    renderers: Tensor


def held_out(library: Library, models: Sequence[tuple[int, str]], folder: Path, said: Said) -> Images:
    """Returns the exact renderers' views of models (class, slug) in the default scene, to 8 bits; kept in `folder`."""
    model_images, classes, numbers, renderers = [], [], [], []
    for number, (kind, slug) in enumerate(models):
        images = _of_model(library, PREFIX + slug, folder)
        said("rendering held-out models", number + 1, len(models), "")
        model_images.append(images)
        classes += [kind] * len(images)
        numbers += [number] * len(images)
        renderers += [renderer for renderer in range(len(RENDERERS)) for _ in range(VIEWS)]
    return Images(torch.cat(model_images), torch.tensor(classes), torch.tensor(numbers), torch.tensor(renderers))


@torch.no_grad()
def answers(network: nn.Module, images: Images) -> Tensor:
    """Returns the network's answers, int64 [N]."""
    network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    batches = []
    for part in torch.split(images.images, AT_ONCE):
        x = normalised(part.permute(0, 3, 1, 2).float() / 255)
        x = F.interpolate(x, (INPUT, INPUT), mode="bilinear", antialias=True)
        batches.append(network(x.contiguous(memory_format=torch.channels_last)).argmax(1))
    return torch.cat(batches)


def clustered_error(right: Tensor, models: Tensor) -> float:
    """Returns the standard error of the mean of `right` [N], whose values are independent between models only.

    The sum over models of squared sums of residuals, with the factor m / (m − 1) of m clusters (Liang and Zeger 1986).
    """
    residuals = right.double() - right.double().mean()
    count = int(models.max()) + 1
    sums = torch.zeros(count, dtype=torch.float64).index_add_(0, models, residuals)
    return float((sums.square().sum() * count / max(1, count - 1)).sqrt() / len(right))


def confusion(answered: Tensor, truth: Tensor, classes: int) -> list[list[int]]:
    """Returns counts by true class (row) and answer (column)."""
    return torch.bincount(truth * classes + answered, minlength=classes**2).reshape(classes, classes).tolist()


def _of_model(library: Library, mesh: str, folder: Path) -> Tensor:
    cameras = [Camera(azimuth=camera.azimuth, size=(SIZE, SIZE)) for camera in paper_cameras(VIEWS, SIZE)]
    scenes = [Scene(objects=(SceneObject(mesh=mesh),), camera=camera) for camera in cameras]
    named = json.dumps([1, RENDERERS, [scene.model_dump(mode="json") for scene in scenes]])
    path = folder / f"{hashlib.sha256(named.encode()).hexdigest()[:32]}.safetensors"
    if not path.exists():
        images = []
        for renderer in RENDERERS:
            for scene in scenes:
                built = build(resolve(scene, library), renderer, tolerance="exact")
                images.append(color.to_bytes(built.exact().render({}))[0])
        disk.write(path, safetensors.numpy.save({"images": torch.stack(images).cpu().numpy()}))
    return torch.from_numpy(safetensors.numpy.load_file(path)["images"])


ARCHITECTURES = {"alexnet": AlexNet, "resnet34": ResNet}


@dataclass(frozen=True)
class Written:
    """The files that were written, and the result in a line."""

    weights: Path
    facts: Path
    card: Path
    data_card: Path
    summary: str

    @classmethod
    def to(cls, out: Path, weights: bytes, facts: dict[str, Any], cards: dict[str, str], summary: str) -> "Written":
        """Writes to the folder `out`. cards: the text of that of the network and that of its data, by name."""
        (card, text), (data_card, data_text) = cards.items()
        files = {
            out / f"{facts['name']}.safetensors": weights,
            out / f"{facts['name']}.json": (json.dumps(facts, indent=1) + "\n").encode(),
            out / f"{card}.md": text.encode(),
            out / f"{data_card}.md": data_text.encode(),
        }
        for path, content in files.items():
            disk.write(path, content)
        weights_path, facts_path, card_path, data_path = files
        return cls(weights_path, facts_path, card_path, data_path, summary)


def write(
    recipe: Recipe,
    trained: Trained,
    split: Split,
    library: Library,
    cache: Path,
    out: Path,
    said: Said,
) -> Written:
    """Measures a trained network on the held-out models and writes its files to `out`."""
    images = held_out(library, split.models("held_out"), cache / "training" / "held_out", said)
    name = f"{recipe.network}-furniture"
    state = weights(trained.network)
    data = to_bytes(state)
    plain = answers(trained.network, images)
    said("measuring", 1, 2, "")
    answered = answers(architecture(recipe.network, len(split.classes), dequantize(quantize(state))), images)
    said("measuring", 2, 2, "")
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
    cards = {name: model_card(facts), "furniture-views": data_card(split, recipe)}
    return Written.to(out, data, facts, cards, _summary(facts))


def write_target(recipe: Recipe, trained: Trained, split: Split, out: Path) -> Path:
    """Writes a trained network as a folder of a network (docs/targets.md), and returns the folder."""
    folder, labels = out / recipe.name, list(split.classes)
    network = architecture(recipe.network, len(labels), dequantize(quantize(weights(trained.network))))
    card = {
        "title": f"{TITLES[recipe.network]} trained on one look, {len(labels)} kinds of furniture",
        "labels": labels,
        "preprocessing": {"input_size": [INPUT, INPUT], "mean": list(MEAN), "std": list(SCALE)},
        "architecture": recipe.network,
        "licence": "Apache-2.0",
        "source": f"trained by this project: {_command(recipe.network, trained)} --one-look",
    }
    disk.write(folder / "model.safetensors", save({k: v.contiguous() for k, v in network.state_dict().items()}))
    disk.write(folder / "card.json", (json.dumps(card, indent=1) + "\n").encode())
    return folder


def architecture(name: str, classes: int, state: dict[str, Tensor]) -> nn.Module:
    """Returns the network with these weights, in evaluation."""
    network: nn.Module = ARCHITECTURES[name](classes)
    fill_by_name(network, state)
    return network.eval()


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
    held_out = facts["held_out"]["accuracy"]
    before = facts["held_out_before_quantisation"]
    return (
        f"{facts['name']}: held-out top-1 {100 * held_out['share']:.1f} ± {100 * held_out['standard_error']:.1f} % "
        f"({held_out['right']} of {held_out['views']} views of {held_out['models']} models, "
        f"{len(facts['labels'])} classes); "
        f"before quantisation {100 * before:.1f} %"
    )


TITLES = {"alexnet": "AlexNet", "resnet34": "ResNet-34"}
PAPER = {"alexnet": 73.6, "resnet34": 79.4}
"""Top-1 accuracies of the paper's networks, percent, on 55 classes."""


def model_card(facts: dict[str, Any]) -> str:
    """Returns the card of a trained network; `facts` are those that `export` writes beside the weights."""
    held_out, classes = facts["held_out"], len(facts["labels"])
    total, before = held_out["accuracy"], facts["held_out_before_quantisation"]
    title = TITLES[facts["architecture"]]
    lines = [
        f"# {facts['name']}",
        "",
        f"{title} with torchvision's layers, trained from random weights on views of furniture models to tell "
        f"{classes} classes apart. It is the counterpart of the {title} of the paper.",
        "",
        f"**Held-out top-1: {_percent(total['share'])} ± {100 * total['standard_error']:.1f} %** (standard error, "
        f"clustered by model), {total['right']:,} of {total['views']:,} views of {total['models']} models, none of "
        "which, and no near-copy of which, was trained on. Before the weights were rounded to 8 bits it was "
        f"{_percent(before)} %.",
        "",
        f"The paper reports {PAPER[facts['architecture']]} % on 55 classes. {classes} classes are easier than 55, so "
        "the two figures cannot be compared as equals. With this few models one split's standard error cannot tell "
        "figures a few points apart.",
        "",
        "| renderer | right | views | top-1 % | 95 % interval (Wilson) | ± (by model) |",
        "|---|---|---|---|---|---|",
        *(_row(name, share) for name, share in held_out["by_renderer"].items()),
        "",
        "The Wilson intervals take views as independent. Views of one model are not, so the intervals are too narrow; "
        "the last column does not make that assumption.",
        "",
        "## Accuracy by class",
        "",
        "| class | models | right | views | top-1 % | 95 % interval (Wilson) | ± (by model) |",
        "|---|---|---|---|---|---|---|",
        *(_row(f"{name} | {share['models']}", share) for name, share in held_out["by_class"].items()),
        "",
        "## Confusion matrix",
        "",
        "Rows are true classes, columns are answers, entries are views.",
        "",
        "| | " + " | ".join(facts["labels"]) + " |",
        "|---" * (classes + 1) + "|",
        *(
            f"| {label} | " + " | ".join(map(str, row)) + " |"
            for label, row in zip(facts["labels"], held_out["confusion"], strict=True)
        ),
        "",
        "## Training",
        "",
        f"    {facts['command']}",
        "",
        f"{facts['steps']:,} steps, {facts['minutes']} minutes on one thread of a processor, seed {facts['seed']}, "
        f"{facts['training_views']:,} views of {facts['training_models']} models; Python {facts['python']}, torch "
        f"{facts['torch']}. With `--minutes` the schedule follows the clock, so another run gives other weights; with "
        "`--epochs` it is reproducible bit for bit.",
        "",
        "Recipe: " + ", ".join(f"{key} {value}" for key, value in facts["recipe"].items()) + ".",
        "",
        *_hints(facts),
        f"Weights: {facts['bytes'] / 1e6:.1f} MB, 8 bits per weight with one scale for each output channel, SHA-256 "
        f"`{facts['sha256']}`. Data: see furniture-views.md.",
    ]
    return "\n".join(lines) + "\n"


def data_card(split: Split, recipe: Recipe) -> str:
    """Returns the card of the views."""
    held_out, training = split.models("held_out"), split.models("training")
    lines = [
        "# Views of furniture",
        "",
        f"{len(training)} models for training and {len(held_out)} held out, in {len(split.classes)} classes, from the "
        "Sweet Home 3D libraries (their creators and licences: `scene-attack assets list`). A class is a kind of "
        "`services/scene_attack/scenes/furniture_kinds.json`, reviewed by hand.",
        "",
        f"    {split.command}",
        "",
        f"**Split by family.** Near-copies belong to one family (`training/split.py` has the rules), and "
        f"no family has models on both sides. Of each kind with at least {MIN_MODELS} models, families are held out in "
        f"the order of a hash until {HELD_OUT:.0%} of the models are (at most {AT_MOST:.0%}); kinds with fewer than "
        f"{MIN_FAMILIES} training or {MIN_HELD_OUT} held-out families are left out.",
        "",
        "**Classes.** Chosen by cross-validation inside the training models: a linear probe on EfficientNet-Lite0's "
        "features, the kind with the lowest recall dropped in each round. The held-out models played no part. The "
        f"probe reaches {_percent(split.accuracy)} % on the classes that are left.",
        "",
        "| kinds | probe's accuracy % | dropped | its recall % |",
        "|---|---|---|---|",
        *(
            f"| {step.kinds} | {_percent(step.accuracy)} | {step.dropped} | {_percent(step.recall)} |"
            for step in split.rounds
        ),
        "",
        "| class | training models | held-out models | probe's recall % |",
        "|---|---|---|---|",
        *(
            f"| {kind} | {len(split.training[kind])} | {len(split.held_out[kind])} | {_percent(split.recalls[kind])} |"
            for kind in split.classes
        ),
        "",
        f"**Training views.** {recipe.views} cameras a model, all around it, elevation π/9 ± 0.17, distance 1.8 × 0.9 "
        f"to 1.2; each time a view is used it is shaded anew with one of {recipe.looks} looks (half the torch "
        "renderer's environment maps and materials, half the pyrender renderer's lights), a ground of k/255, sometimes "
        "a tint or one random colour all over, distortions of the image, and a mirror image. From "
        f"{recipe.default_from:.0%} of the training on {DEFAULT_SCENES:.0%} of the batches show the default scene of "
        "either renderer instead, lit from any side, with the model's own colours, the default ground and a third of "
        "the distortions.",
        "",
        f"**Held-out views.** {VIEWS} cameras a model at elevation π/9 and distance 1.8, by each of the exact "
        f"renderers {' and '.join(RENDERERS)} in the default scene, 224 × 224, 8 bits. Networks see them at 112 × 112.",
        "",
        "**Limits.** The models are clean furniture without background; a class is a few dozen models, many by one "
        "studio. The networks know nothing of photographs.",
    ]
    return "\n".join(lines) + "\n"


def _hints(facts: dict[str, Any]) -> list[str]:
    if not facts["recipe"]["hints"]:
        return []
    return [
        "In the first half of the training a second output predicts principal components of EfficientNet-Lite0's "
        "features of the view, which that network learned from photographs; it is thrown away afterwards.",
        "",
    ]


def _row(name: str, share: dict[str, Any]) -> str:
    low, high = share["wilson"]
    return (
        f"| {name} | {share['right']} | {share['views']} | {_percent(share['share'])} | {_percent(low)} to "
        f"{_percent(high)} | {100 * share['standard_error']:.1f} |"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
