"""Attacks a network of the caller's own process, without a service: `from client import attack`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from services.errors import InvalidRequest

if TYPE_CHECKING:
    from torch import nn

    from services.pipeline.execute import Progress
    from services.pipeline.result import Result
    from services.pipeline.spec import JobSpec
    from services.settings import Settings
    from services.targets.preprocessing import Preprocessing
    from services.targets.protocol import Target


def attack(
    scene: Mapping[str, Any],
    model: nn.Module | Target,
    spec: Mapping[str, Any] | None = None,
    *,
    labels: Sequence[str] = (),
    preprocessing: Mapping[str, Any] | None = None,
    name: str = "module",
    out: Path | str | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Result:
    """Runs one attack on a torch module, or on an object that implements `services.targets.protocol.Target`.

    A module takes images [B, 3, H, W] and returns scores [B, K] before the softmax; it is copied and not changed.
    `labels` names its scores, by default "0" to "K-1". `preprocessing` has the fields of
    services.targets.preprocessing.Preprocessing: `input_size` (height and width, default 224×224), `mean`, `scale`,
    `resize`, `channels`. `scene` is the scene of a request and `spec` its other fields, such as `attack`, `goal` and
    `seed`; docs/scene.md describes them. A `mesh` may be a path relative to the working directory, "./chair.obj". The
    files of a job are written into the folder `out` if it is given. Meshes, device and the like are those of the
    SCENE_ATTACK_ variables. Raises InvalidRequest, which names the field, for
    anything that cannot run, and JobFailure for a run that fails.
    """
    from torch import nn

    from client.local_meshes import local_library
    from client.settings import read_settings
    from services.pipeline.execute import execute
    from services.pipeline.extensions import set_up
    from services.targets.custom.in_process import describe, target_of
    from services.targets.registry import registered

    settings = read_settings()
    set_up(settings)
    if isinstance(model, nn.Module):
        chosen = _preprocessing(preprocessing or {})
        target: Target = target_of(name, model, tuple(labels) or _numbers(model, chosen), chosen)
    elif labels or preprocessing:
        raise InvalidRequest("labels", "a target has labels and preprocessing of its own; leave both out")
    else:
        target = model
    job = _spec(scene, name, spec or {}, settings)
    with registered(describe(name, target), target), TemporaryDirectory() as folder:
        return execute(job, Path(folder) if out is None else Path(out), local_library(settings), progress=progress)


def _spec(scene: Mapping[str, Any], name: str, spec: Mapping[str, Any], settings: Settings) -> JobSpec:
    from client.local_meshes import to_library, with_meshes_added
    from services.pipeline.spec import parse

    for field, argument in (("scene", "scene"), ("target", "model")):
        if field in spec:
            raise InvalidRequest(f"spec.{field}", f"is given by the argument `{argument}`; leave it out of the spec")
    data = {"scene": dict(scene), "target": {"name": name}, **spec}
    return parse(with_meshes_added(data, Path.cwd(), to_library(settings)))


def _preprocessing(given: Mapping[str, Any]) -> Preprocessing:
    from pydantic import ValidationError

    from services.pipeline.field_errors import invalid_fields
    from services.targets.preprocessing import Preprocessing

    try:
        return Preprocessing.model_validate(dict(given))
    except ValidationError as error:
        first = invalid_fields(error.errors(include_url=False), Preprocessing.model_json_schema())[0]
        raise InvalidRequest(f"preprocessing.{first.field}", first.detail) from error


def _numbers(model: nn.Module, preprocessing: Preprocessing) -> tuple[str, ...]:
    """The numbers of the model's scores, found by showing a copy of it a black image."""
    from copy import deepcopy

    import torch

    weight = next(model.parameters(), torch.zeros(1))
    try:
        with torch.no_grad():
            scores = deepcopy(model).eval()(weight.new_zeros(1, 3, *preprocessing.input_size))
    except Exception as error:
        size = ", ".join(map(str, preprocessing.input_size))
        said = f"it takes no images [1, 3, {size}] ({error}); preprocessing.input_size says which it takes"
        raise InvalidRequest("model", said) from error
    if not isinstance(scores, torch.Tensor) or scores.ndim != 2:
        raise InvalidRequest("model", "it must return scores [B, K], one row for each image")
    return tuple(map(str, range(scores.shape[1])))
