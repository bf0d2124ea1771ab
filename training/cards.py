"""The model card and the data card, in Markdown."""

from typing import Any

from training.evaluation import RENDERERS, VIEWS
from training.recipe import DEFAULT_SCENES, Recipe
from training.split import AT_MOST, HELD_OUT, MIN_FAMILIES, MIN_HELD_OUT, MIN_MODELS, Split

TITLES = {"alexnet": "AlexNet", "resnet34": "ResNet-34"}
PAPER = {"alexnet": 73.6, "resnet34": 79.4}
"""Top-1 accuracies of the paper's networks, percent, on 55 classes."""


def model_card(facts: dict[str, Any]) -> str:
    """Returns the card of a trained network; `facts` is what `export` writes beside the weights."""
    found, classes = facts["held_out"], len(facts["labels"])
    total, before = found["accuracy"], facts["held_out_before_quantisation"]
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
        *(_row(name, share) for name, share in found["by_renderer"].items()),
        "",
        "The Wilson intervals take views as independent. Views of one model are not, so the intervals are too narrow; "
        "the last column does not make that assumption.",
        "",
        "## Accuracy by class",
        "",
        "| class | models | right | views | top-1 % | 95 % interval (Wilson) | ± (by model) |",
        "|---|---|---|---|---|---|---|",
        *(_row(f"{name} | {share['models']}", share) for name, share in found["by_class"].items()),
        "",
        "## Confusion matrix",
        "",
        "Rows are true classes, columns are answers, entries are views.",
        "",
        "| | " + " | ".join(facts["labels"]) + " |",
        "|---" * (classes + 1) + "|",
        *(
            f"| {label} | " + " | ".join(map(str, row)) + " |"
            for label, row in zip(facts["labels"], found["confusion"], strict=True)
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
        "`services/scenes/furniture_kinds.json`, reviewed by hand.",
        "",
        f"    {split.command}",
        "",
        f"**Split by family.** Near-copies belong to one family (`training/families.py` has the rules), and "
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
            f"| {one.kinds} | {_percent(one.accuracy)} | {one.dropped} | {_percent(one.recall)} |"
            for one in split.rounds
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
