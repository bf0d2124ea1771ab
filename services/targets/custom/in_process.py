"""Makes a target of a torch module that a caller of the same process passes."""

from copy import deepcopy

from torch import nn

from services.targets.classifier import Classifier
from services.targets.custom.factory import digest
from services.targets.custom.loading import classifier
from services.targets.info import TargetInfo
from services.targets.preprocessing import Preprocessing
from services.targets.protocol import Target


def target_of(name: str, network: nn.Module, labels: tuple[str, ...], preprocessing: Preprocessing) -> Classifier:
    """Returns a copy of the module as a target; the copy is in evaluation mode and frozen."""
    return classifier(name, deepcopy(network), labels, preprocessing, digest(network))


def describe(name: str, target: Target) -> TargetInfo:
    """Returns the card of a target that has no other."""
    return TargetInfo(
        name=name,
        title=name,
        task="question answering" if target.takes_question else "classification",
        input_size=target.input_size,
        classes=len(target.labels),
        differentiable=target.differentiable,
        takes_question=target.takes_question,
        source="passed in the process",
        licence="not stated",
    )
