"""Checks the part of a request that asks for analyses against what is installed."""

from services.errors import InvalidRequest
from services.pipeline.described import can_carry
from services.pipeline.spec import JobSpec
from services.rendering.declaration import RENDERERS
from services.targets import registry
from services.targets.info import TARGETS
from services.text import there_are


def check_analysis(spec: JobSpec) -> None:
    """Raises InvalidRequest naming the field, for unknown targets and renderers, for a target without gradients
    where they are needed, and for a renderer that can draw nothing of the attacked groups.
    """
    if spec.analysis.adaptive is not None and not registry.has_gradient(spec.target.name):
        detail = f"it needs gradients, and the scores of {spec.target.name} have none with respect to the image"
        raise InvalidRequest("analysis.adaptive", detail)
    if spec.target.questions:
        for name in ("transfer", "interpretation", "rerendering", "adaptive"):
            if getattr(spec.analysis, name) is not None:
                raise InvalidRequest(f"analysis.{name}", "it asks one question, and there are several; leave it out")
    asked = spec.analysis.transfer
    if asked is None:
        return
    for index, name in enumerate(asked.targets):
        field = f"analysis.transfer.targets.{index}"
        try:
            registry.labels(name)
        except InvalidRequest as error:
            raise InvalidRequest(field, error.detail) from error
        if TARGETS[name].info.takes_question:
            raise InvalidRequest(field, f"{name} answers questions; an image is shown to it without one")
    drawing = [name for name, one in RENDERERS.items() if one.base_renderer is None and name != spec.attack.renderer]
    for index, name in enumerate(asked.renderers):
        field = f"analysis.transfer.renderers.{index}"
        if name == spec.attack.renderer:
            raise InvalidRequest(field, f"{name} is the renderer of the attack itself")
        if name not in drawing:
            raise InvalidRequest(field, f"there is no renderer {name!r} that draws a scene; {there_are(name, drawing)}")
        if not can_carry(spec.attack.renderer, spec.attack.groups):
            attacked = ", ".join(spec.attack.groups)
            raise InvalidRequest(
                field,
                f"nothing of {attacked} ({spec.attack.renderer}) is a part of the scene that {name} draws; colours, "
                "poses and the camera of pyrender are",
            )


def load_targets(spec: JobSpec) -> None:
    """Loads the targets to which the perturbation is to be shown: one that is broken would lose the finished attack.

    Raises InvalidRequest naming the field.
    """
    asked = spec.analysis.transfer
    for index, name in enumerate(() if asked is None else asked.targets):
        try:
            registry.load(name)
        except InvalidRequest as error:
            raise InvalidRequest(f"analysis.transfer.targets.{index}", error.detail) from error
