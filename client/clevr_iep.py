"""Converts the checkpoints of clevr-iep (Johnson et al. 2017) into a folder with weights in safetensors and a card.

A checkpoint is a pickle of a dictionary: `execution_engine_state` and `execution_engine_kwargs`, or the same of
`program_generator`, and `vocab`. torch's reader of weights builds no other objects than tensors, containers, texts and
numbers, so that reading one runs no code of its file.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor

from services import atomic_write
from services.errors import InvalidRequest, summary
from services.targets.iep.prefix import TOKENS
from services.targets.iep_released.card import NAME
from services.targets.iep_released.checkpoint import build, to_bytes
from services.targets.iep_released.trunk import STAGES
from services.targets.iep_released.vocabulary import Vocabulary

TRUNKS = ("63fe2227", "5d3b4d8f")
"""How the SHA-256 of torchvision's ResNet-101 of 2016 (IMAGENET1K_V1) begins, in its two formats: its files are named
by it. Later weights of the same shapes give other features."""
_REASON = re.compile(r"Unsupported operand \d+|(?i:unsupported) (?:global: )?GLOBAL \S+")
DUE = {
    "stem_num_layers": 2,
    "stem_batchnorm": False,
    "module_residual": True,
    "module_batchnorm": False,
    "classifier_downsample": "maxpool2",
    "classifier_batchnorm": False,
    "classifier_dropout": 0,
}
"""The settings of the network that was published; the code has others too."""
CARD = {
    "title": "IEP as published, CLEVR's 28 answers",
    "labels": "clevr",
    "architecture": NAME,
    # The scale of blue is that of clevr-iep's own scripts; ImageNet's is 0.225.
    "preprocessing": {
        "input_size": [224, 224],
        "mean": [0.485, 0.456, 0.406],
        "scale": [0.229, 0.224, 0.224],
        "resize": "bicubic",
    },
    "source": "https://github.com/facebookresearch/clevr-iep (Johnson et al. 2017), converted",
    "licence": "that of clevr-iep and of torchvision's ResNet-101",
}


def write(engine: Path, generator: Path, trunk: Path, out: Path, any_trunk: bool = False) -> Path:
    """Writes `model.safetensors` and `card.json` into the folder `out`, and returns it.

    Raises InvalidRequest, which names the option, for a file that is none of clevr-iep's, that cannot be read without
    running code, or that has another network than the published one; for a trunk with another SHA-256 than
    torchvision's, unless any is allowed; and for a folder that has something in it.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InvalidRequest("--out", f"{out} is not empty, or no folder")
    _check_trunk(trunk, any_trunk)
    of_engine, of_generator = _read("--engine", engine), _read("--generator", generator)
    _check_settings(_part(of_engine, "--engine", "execution_engine_kwargs"))
    words, functions = (_tokens(of_generator, "--generator", name) for name in ("question", "program"))
    if _tokens(of_engine, "--engine", "program") != functions:
        raise InvalidRequest("--generator", "its functions are not those of the engine; take both of one training")
    try:
        network = build(
            _trunk_state(_weights("--trunk", _read("--trunk", trunk))),
            _engine_state(_weights("--engine", _part(of_engine, "--engine", "execution_engine_state"))),
            _weights("--generator", _part(of_generator, "--generator", "program_generator_state")),
            Vocabulary(words, functions, _tokens(of_engine, "--engine", "answer")),
        )
    except ValueError as error:
        raise InvalidRequest(
            "--engine, --generator, --trunk", f"they are not the published network: {error}"
        ) from error
    out.mkdir(parents=True, exist_ok=True)
    atomic_write.write(out / "model.safetensors", to_bytes(network))
    atomic_write.write(out / "card.json", (json.dumps(CARD, indent=1) + "\n").encode())
    return out


def _read(option: str, path: Path) -> Mapping[str, Any]:
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError as error:
        raise InvalidRequest(option, f"{path} cannot be read as weights: {_reason(error)}") from error
    except Exception as error:  # an error of its own for each way in which a file can be wrong
        raise InvalidRequest(option, f"{path} cannot be read as weights: {summary(error)}") from error
    if not isinstance(found, Mapping):
        raise InvalidRequest(option, f"{path} holds a {type(found).__name__}, not a dictionary")
    return found


def _reason(error: UnpicklingError) -> str:
    """torch's reason without what it says around it: how to read the file in the way that may run its code."""
    found = _REASON.search(str(error))
    return summary(UnpicklingError(found[0])) if found else "torch's reader of weights refuses it"


def _weights(option: str, found: Mapping[Any, Any]) -> Mapping[str, Tensor]:
    for name, value in found.items():
        if not isinstance(name, str) or not isinstance(value, Tensor):
            raise InvalidRequest(option, f"what it has by the name {name!r} is no weight with a name")
    return found


def _part(checkpoint: Mapping[str, Any], option: str, name: str) -> Mapping[str, Any]:
    found = checkpoint.get(name)
    if not isinstance(found, Mapping):
        raise InvalidRequest(option, f"it is no checkpoint of clevr-iep with that part: it has no {name}")
    return found


def _tokens(checkpoint: Mapping[str, Any], option: str, kind: str) -> tuple[str, ...]:
    """Returns the tokens of a kind in the order of their numbers."""
    numbers = _part(_part(checkpoint, option, "vocab"), option, f"{kind}_token_to_idx")
    if not all(isinstance(token, str) and type(number) is int for token, number in numbers.items()):
        raise InvalidRequest(option, f"the {kind} tokens of its vocab are not texts with numbers")
    tokens = tuple(sorted(numbers, key=numbers.__getitem__))
    if [numbers[token] for token in tokens] != list(range(len(tokens))):
        raise InvalidRequest(option, f"the {kind} tokens of its vocab are not numbered from 0 on")
    return tokens


def _check_settings(settings: Mapping[str, Any]) -> None:
    for name, due in DUE.items():
        if settings.get(name, due) != due:
            raise InvalidRequest("--engine", f"its {name} is {settings[name]!r}; the published network has {due!r}")


def _check_trunk(path: Path, any_trunk: bool) -> None:
    with path.open("rb") as opened:
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
    if not any_trunk and not digest.startswith(TRUNKS):
        raise InvalidRequest(
            "--trunk",
            f"the SHA-256 of {path} begins with {digest[:8]}; that of the weights the modules were trained with begins "
            f"with {' or '.join(TRUNKS)}. With --any-trunk it is taken, and answers will be wrong if features differ",
        )


def _trunk_state(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the weights of the stages that features are taken from."""
    needed = ("conv1.", "bn1.", *(f"layer{stage}." for stage in range(1, STAGES + 1)))
    return {name: value for name, value in state.items() if name.startswith(needed)}


def _engine_state(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the engine's weights by our names, without the modules of tokens that are no function."""
    found = {}
    for name, value in state.items():
        module, _, rest = name.partition(".")
        if module in TOKENS:
            found[f"functions.{module}.{rest}"] = value
        elif not module.startswith("<"):
            found[name] = value
    return found
