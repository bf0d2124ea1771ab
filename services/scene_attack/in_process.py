"""Attacks a network of the caller's own process, without a service: `from scene_attack import attack`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from scene_attack.errors import InvalidFields, InvalidRequest

if TYPE_CHECKING:
    from torch import Tensor, nn

    from scene_attack.options import Options
    from scene_attack.runs.execute import Progress
    from scene_attack.runs.result import Result
    from scene_attack.runs.spec import JobSpec
    from scene_attack.targets.custom.card import Preprocessing
    from scene_attack.targets.protocol import Target


def attack(
    scene: Mapping[str, Any],
    model: nn.Module | Target | Callable[[Tensor], Any],
    spec: Mapping[str, Any] | None = None,
    *,
    labels: Sequence[str] | None = None,
    preprocessing: Mapping[str, Any] | None = None,
    name: str = "module",
    out: Path | str | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Result:
    """Runs one attack on a torch module, on a function, or on a `scene_attack.targets.protocol.Target`.

    A module takes images [B, 3, H, W] and returns scores [B, K] before the softmax; it is copied and not changed. A
    function does the same with float32 CPU tensors, and may return any array; only methods without gradients attack it.
    `labels` names the scores: a list, "imagenet" for ImageNet's 1,000 in their usual order, with which library meshes
    have their truth, or None for "0" to "K-1". `preprocessing` has the fields of
    scene_attack.targets.custom.card.Preprocessing: `input_size` (height and width, default 224×224), `mean`, `scale`,
    `resize`, `channels`. `scene` is the scene of a request and `spec` its other fields, such as `attack`, `goal` and
    `seed`; docs/reference/fields.md describes them. A `mesh` may be a path relative to the working directory,
    "./chair.obj". The files of a job are written into the folder `out` if it is given; it may hold no other job's
    result. Meshes, device and the like are those of the SCENE_ATTACK_ variables. Raises InvalidRequest, which names
    the field or the argument, for anything that cannot run, and JobFailure for a run that fails.
    """
    from torch import nn

    from scene_attack.cli.result_folder import check_free, prepare_folder
    from scene_attack.cli.specs import local_library
    from scene_attack.runs.environment import read_options
    from scene_attack.runs.execute import execute
    from scene_attack.runs.extensions import set_up
    from scene_attack.targets.custom.loading import describe
    from scene_attack.targets.registry import registered

    for argument, value in (("scene", scene), ("spec", {} if spec is None else spec)):
        if not isinstance(value, Mapping):
            raise InvalidRequest(argument, f"must be a dictionary, as a request has it, not {type(value).__name__}")
    options = read_options()
    set_up(options)
    target = _target(name, model, labels, preprocessing)
    card = describe(name, target, "imagenet" if labels == "imagenet" else "custom")
    with registered(card, target), TemporaryDirectory() as folder:
        job = _spec(scene, name, spec or {}, options)
        if out is not None:
            module = isinstance(model, nn.Module) or hasattr(model, "logits")
            # Nobody knows whether two functions are the same: a folder with a result of one is never free.
            check_free(Path(out), job, "out", (target.weights_sha256, card.card_sha256) if module else ())
            prepare_folder(Path(out), "out")
        return execute(job, Path(folder) if out is None else Path(out), local_library(options), progress=progress)


def _target(name: str, model: Any, labels: Any, preprocessing: Any) -> Target:
    """The target of the arguments of `attack`. Raises InvalidRequest, which names the argument."""
    from torch import nn

    from scene_attack.targets.custom.loading import scores_of, target_of

    if not isinstance(model, nn.Module) and hasattr(model, "logits"):
        missing = [part for part in _PARTS if not hasattr(model, part)]
        if missing:
            raise InvalidRequest("model", f"it has `logits` and so is a target, but no {' and no '.join(missing)}")
        if labels is not None or preprocessing:
            field = "preprocessing" if labels is None else "labels"
            raise InvalidRequest(field, "a target has labels and preprocessing of its own; leave both out")
        target: Target = model
        return target
    if not callable(model):
        raise InvalidRequest(
            "model",
            f"must be a torch.nn.Module, a function of images [B, 3, H, W], or a target, not {type(model).__name__}",
        )
    chosen = _preprocessing({} if preprocessing is None else preprocessing)
    named = _labels(labels) or _numbers(model, chosen)
    return (target_of if isinstance(model, nn.Module) else scores_of)(name, model, named, chosen)


_PARTS = ("name", "labels", "input_size", "differentiable", "takes_question", "weights_sha256", "backend")


def _labels(labels: Any) -> tuple[str, ...]:
    """The labels of the argument; empty if it names none."""
    from scene_attack.targets.labels import imagenet_labels

    if labels is None:
        return ()
    if isinstance(labels, str) and labels == "imagenet":
        return imagenet_labels()
    whole = isinstance(labels, str) or not isinstance(labels, Sequence)
    wrong = [labels] if whole else [label for label in labels if not isinstance(label, str)]
    if wrong:
        refused = f"{wrong[0]!r:.80}{'' if whole else ' in a list'}"
        raise InvalidRequest("labels", f'must be a list of texts, "imagenet", or None for numbers, not {refused}')
    return tuple(labels)


def _spec(scene: Mapping[str, Any], name: str, spec: Mapping[str, Any], options: Options) -> JobSpec:
    from scene_attack.cli.specs import parsed
    from scene_attack.runs.spec import parse

    for field, argument in (("scene", "scene"), ("target", "model")):
        if field in spec:
            raise InvalidRequest(f"spec.{field}", f"is given by the argument `{argument}`; leave it out of the spec")
    return parsed(parse, {"scene": dict(scene), "target": {"name": name}, **spec}, Path.cwd(), options)


def _preprocessing(fields: Any) -> Preprocessing:
    from pydantic import ValidationError

    from scene_attack.runs.field_errors import invalid_fields
    from scene_attack.targets.custom.card import Preprocessing

    if not isinstance(fields, Mapping):
        detail = f"must be a mapping such as {{'input_size': [32, 32]}}, not {type(fields).__name__}"
        raise InvalidRequest("preprocessing", detail)
    try:
        return Preprocessing.model_validate(dict(fields))
    except ValidationError as error:
        errors = invalid_fields(error.errors(include_url=False), Preprocessing)
        raise InvalidFields(
            [InvalidRequest(f"preprocessing.{wrong.field}", wrong.detail) for wrong in errors]
        ) from error


def _numbers(model: Callable[[Tensor], Any], preprocessing: Preprocessing) -> tuple[str, ...]:
    """The numbers of the model's scores, found by showing a copy of it a black image."""
    from copy import deepcopy

    import torch

    from scene_attack.targets.custom.loading import ScoresOnly

    network = deepcopy(model).eval() if isinstance(model, torch.nn.Module) else ScoresOnly(model)
    weight = next(network.parameters(), torch.zeros(1))
    try:
        with torch.no_grad():
            scores = network(weight.new_zeros(1, 3, *preprocessing.input_size))
    except Exception as error:
        size = ", ".join(map(str, preprocessing.input_size))
        detail = f"it takes no images [1, 3, {size}] ({error}); preprocessing.input_size says which it takes"
        raise InvalidRequest("model", detail) from error
    if not isinstance(scores, torch.Tensor) or scores.ndim != 2:
        raise InvalidRequest("model", "it must return scores [B, K], one row for each image")
    return tuple(map(str, range(scores.shape[1])))
