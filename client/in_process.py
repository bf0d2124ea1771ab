"""Attacks a network of the caller's own process, without a service: `from client import attack`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import nn

    from services.pipeline.execute import Progress
    from services.pipeline.result import Result
    from services.targets.protocol import Target


def attack(
    scene: Mapping[str, Any],
    network: nn.Module | Target,
    labels: Sequence[str] = (),
    *,
    preprocessing: Mapping[str, Any] | None = None,
    attack: Mapping[str, Any] | None = None,
    goal: Mapping[str, Any] | None = None,
    seed: int = 0,
    name: str = "module",
    out: Path | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Result:
    """Runs one attack on a torch module, or on an object that implements `services.targets.protocol.Target`.

    A module takes images [B, 3, H, W] and returns scores [B, K], one for each of `labels`; it is copied and not
    changed. `preprocessing` has the fields of services.targets.preprocessing.Preprocessing: `input_size` (height and
    width, default 224×224), `mean`, `scale`, `resize`, `channels`. `scene`, `attack`, `goal` and `seed` are those of a
    request; docs/scene.md describes them. The files of a job are written into `out` if it is given.
    Raises InvalidRequest, which names the field, for anything that cannot run, and JobFailure for a run that fails.
    """
    from pydantic import ValidationError
    from torch import nn

    from services.errors import InvalidRequest
    from services.pipeline.execute import execute
    from services.pipeline.field_errors import invalid_fields
    from services.pipeline.spec import parse
    from services.scenes.library import Library
    from services.settings import settings
    from services.targets.custom.in_process import describe, target_of
    from services.targets.preprocessing import Preprocessing
    from services.targets.registry import registered

    if isinstance(network, nn.Module):
        if not labels:
            raise InvalidRequest("labels", "a torch module needs the label of each of its scores, in order")
        try:
            chosen = Preprocessing.model_validate(dict(preprocessing or {}))
        except ValidationError as error:
            first = invalid_fields(error.errors(include_url=False), Preprocessing.model_json_schema())[0]
            raise InvalidRequest(f"preprocessing.{first.field}", first.detail) from error
        target: Target = target_of(name, network, tuple(labels), chosen)
    elif labels or preprocessing:
        raise InvalidRequest("labels", "a target has labels and preprocessing of its own; leave both out")
    else:
        target = network
    request = {"scene": scene, "goal": goal or {}, "attack": attack or {}, "seed": seed, "target": {"name": name}}
    spec = parse({key: dict(value) if isinstance(value, Mapping) else value for key, value in request.items()})
    library = Library(settings().cache_dir, settings().files)
    with registered(describe(name, target), target), TemporaryDirectory() as folder:
        return execute(spec, Path(folder) if out is None else out, library, progress=progress)
