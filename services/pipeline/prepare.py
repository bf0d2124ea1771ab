"""Prepares a job: resolves its assets, target and labels, builds the renderer, and checks the network's answer."""

from dataclasses import dataclass

from torch import Tensor

from services.attacks.goal import ResolvedGoal
from services.attacks.verifier import Verifier
from services.errors import InvalidRequest
from services.pipeline.extensions import ATTACKS
from services.pipeline.spec import JobSpec
from services.rendering.factory import build
from services.rendering.plan import Plan, Tolerance
from services.rendering.protocol import Renderer
from services.rendering.torch_renderer.declaration import TORCH
from services.rendering.torch_renderer.map_size import smallest_map
from services.rendering.torch_renderer.presets import preset
from services.scenes.description import Environment
from services.scenes.library import Library
from services.scenes.resolve import ResolvedScene, resolve
from services.suggestions import did_you_mean
from services.targets import registry
from services.targets.protocol import Target
from services.targets.scores import probability


@dataclass
class Prepared:
    """A job that is ready to run: its spec, the objects that the spec names, and the original image."""

    spec: JobSpec
    """The spec with the label to leave and the size of the environment map filled in."""
    scene: ResolvedScene
    renderer: Renderer
    target: Target
    goal: ResolvedGoal
    verifier: Verifier
    original: Tensor
    """The exact image of the scene rounded to 8 bits, uint8 [H, W, 3]."""
    logits: Tensor
    """The network's scores of the original image, [K]."""

    @property
    def backend(self) -> str:
        """The backends of the exact renderer and of the network, on which the bits of the verdict depend."""
        return f"{self.renderer.exact().backend}; {self.target.backend}"


def preflight(spec: JobSpec, library: Library) -> JobSpec:
    """Returns the spec as it would run. Raises InvalidRequest if it cannot run, as `prepare` does.

    Only the exact renderer is built, without a plan for the job's tolerance: the check needs no other image.
    """
    return _prepare(spec, library, "exact").spec


def plan(spec: JobSpec, library: Library) -> Plan:
    """Returns the plan that a job would run, without loading the network. Raises InvalidRequest as `prepare` does."""
    return _renderer(spec, _scene(spec, library), spec.tolerance).plan


def prepare(spec: JobSpec, library: Library) -> Prepared:
    """Looks up meshes, map, materials, target and labels, renders the scene exactly and asks the network.

    Raises InvalidRequest naming the field, for: unknown names, a label out of range, an object out of view, a method
    that needs gradients of a network that has none, an image that the network gets wrong (goal.leave), or one that it
    already answers with the label to reach (goal.reach). Raises JobFailure for a target or renderer that breaks its
    protocol.
    """
    return _prepare(spec, library, spec.tolerance)


def _prepare(spec: JobSpec, library: Library, tolerance: Tolerance) -> Prepared:
    """`prepare` with a renderer of this tolerance; the environment map is chosen by the job's own."""
    labels = registry.labels(spec.target.name)
    if len(labels) < 2:
        raise InvalidRequest("target.name", f"{spec.target.name} has one label only; there is no other answer")
    leave = _label(spec.goal.leave, labels, "goal.leave", spec.target.name)
    reach = _label(spec.goal.reach, labels, "goal.reach", spec.target.name)
    if leave is not None and leave == reach:
        raise InvalidRequest("goal.reach", f"is the label to leave ({labels[leave]!r}); name another one")
    scene = _scene(spec, library)
    spec = spec.model_copy(update={"scene": scene.description})
    target = registry.load(spec.target.name)
    if spec.target.question is not None and not target.takes_question:
        raise InvalidRequest("target.question", f"{target.name} answers no questions; leave it out")
    if ATTACKS[spec.attack.method].needs_gradient and not registry.has_gradient(target.name):
        others = ", ".join(name for name, one in ATTACKS.items() if not one.needs_gradient)
        raise InvalidRequest(
            "attack.method",
            f"{spec.attack.method} needs gradients, and the scores of {target.name} have none with respect to the "
            f"image (they are constant, detached or computed without torch); methods without gradients are {others}",
        )
    renderer = _renderer(spec, scene, tolerance)
    verifier = Verifier(renderer, target, spec.target.question)
    original = verifier.image({})
    logits = verifier.logits(original)
    leave = _first_answer(logits, leave, reach, labels)
    goal = spec.goal.model_copy(
        update={
            "leave": None if leave is None else labels[leave],
            "reach": None if reach is None else labels[reach],
        }
    )
    spec = spec.model_copy(update={"goal": goal})
    return Prepared(spec, scene, renderer, target, ResolvedGoal(leave, reach), verifier, original, logits)


def _scene(spec: JobSpec, library: Library) -> ResolvedScene:
    for index, thing in enumerate(spec.scene.objects):
        preset(thing.material, f"scene.objects.{index}.material")
    scene = resolve(spec.scene, library)
    return scene if spec.scene.lights.environment.size != "auto" else _with_chosen_map(spec, scene, library)


def _with_chosen_map(spec: JobSpec, scene: ResolvedScene, library: Library) -> ResolvedScene:
    """The scene with the smallest map that the job's tolerance allows, or the default size if no renderer uses one."""
    size = smallest_map(scene, spec.tolerance) if lit_by_map(spec) else Environment().size
    lights = spec.scene.lights
    chosen = lights.model_copy(update={"environment": lights.environment.model_copy(update={"size": size})})
    return resolve(spec.scene.model_copy(update={"lights": chosen}), library)


def lit_by_map(spec: JobSpec) -> bool:
    """Whether the environment map lights the job's images: the torch renderer draws them or those they are made of."""
    return TORCH.name in (spec.attack.renderer, spec.attack.base_renderer)


def _renderer(spec: JobSpec, scene: ResolvedScene, tolerance: Tolerance) -> Renderer:
    attack = spec.attack
    return build(scene, attack.renderer, attack.base_renderer, attack.groups, tolerance)


def _label(wanted: str | int | None, labels: tuple[str, ...], field: str, target: str) -> int | None:
    if wanted is None:
        return None
    if isinstance(wanted, int):
        if wanted >= len(labels):
            raise InvalidRequest(field, f"{target} has labels 0 to {len(labels) - 1}, not {wanted}")
        return wanted
    if wanted not in labels:
        raise InvalidRequest(field, f"{target} has no label {wanted!r}{did_you_mean(wanted, labels)}")
    return labels.index(wanted)


def _first_answer(logits: Tensor, leave: int | None, reach: int | None, labels: tuple[str, ...]) -> int | None:
    """The label to leave, checked against the network's answer to the original image, [K] scores."""
    first = int(logits.argmax())
    said = f"{labels[first]!r} ({float(probability(logits, first)):.2f})"
    if leave is not None and first != leave:
        raise InvalidRequest(
            "goal.leave",
            f"the network already gets this scene wrong: it says {said}, not {labels[leave]!r}; "
            "choose a view it gets right, or leave this field out to attack its own first answer",
        )
    if reach is not None and first == reach:
        raise InvalidRequest("goal.reach", f"the network already says {said}; there is nothing to attack")
    return first if leave is None and reach is None else leave
