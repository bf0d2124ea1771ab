"""The model of a whole request, which is the same JSON for `POST /v1/jobs` and `scene-attack run`.

The attack of a request is one of all that are registered when it is read, those of plug-ins among them. The
labels that its goal names are looked up by `asked_goal`, all other names by `names_in`. `scene_name` and the functions
after it name a request in lists and tables. `RerenderingSpec` is the request of the other kind of job. No torch is
needed, so that a request is checked before it is queued.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import sha256
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union

from pydantic import (
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from scene_attack.analysis.records import AnalysisRequest, Rerendering, RerenderingRequest
from scene_attack.attacks.attack import ATTACKS, Attack
from scene_attack.attacks.request import Seed
from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.plan import DEFAULT_TOLERANCE
from scene_attack.rendering.torch.declaration import check_preset
from scene_attack.runs.field_errors import invalid_fields
from scene_attack.runs.task_parts import AnyAsk, Ask
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.scene_file import upload_of
from scene_attack.strict import Model, Names, absent, reference, unknown_parts
from scene_attack.targets.download import check_obtainable
from scene_attack.targets.info import LONGEST_LABEL, TARGETS, TargetInfo
from scene_attack.targets.labels import labels, same_labels
from scene_attack.text import closest, did_you_mean


def _validated(data: Any, names: Names | None) -> Attack:
    """Validates an attack. The other fields of an attack whose method there is not are named, too.

    They are taken for those of the closest method or, where none is close, of the renderer's own: then only what no
    method has, or what all methods have, is known to be wrong.
    """
    union = _union(_registered())
    try:
        return union.validate_python(data, context=names)
    except ValidationError as error:
        if error.errors()[0]["type"] != "union_tag_invalid":
            raise
        close = closest(data["method"], ATTACKS) if isinstance(data["method"], str) else []
        method = close[0] if close else _method_for(data)
        try:
            union.validate_python({**data, "method": method}, context=names)
        except ValidationError as others:
            wrong = [item for item in others.errors() if close or not _may_be_anothers(item)]
            items = [_again(item) for item in (*error.errors(), *wrong)]
            raise ValidationError.from_exception_data(error.title, items) from error
        raise


def _may_be_anothers(error: Any) -> bool:
    """Whether an error of an attack is of a field that only some methods have."""
    field = error["loc"][1] if len(error["loc"]) > 1 else ""
    some = {name for attack in ATTACKS.values() for name in attack.model_fields}
    return field in some - set(Attack.model_fields)


def _again(error: Any) -> InitErrorDetails:
    """An error of a ValidationError, to be raised in another."""
    kind: Any = error["type"]
    if kind in ("value_error", "assertion_error", "unknown_name"):
        kind = PydanticCustomError(kind, "{said}", {"said": error["msg"], **error.get("ctx", {})})
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"], ctx=error.get("ctx", {}))


def _registered() -> tuple[type[Attack], ...]:
    return tuple(ATTACKS.values())


@lru_cache(maxsize=1)
def _union(attacks: tuple[type[Attack], ...]) -> TypeAdapter[Attack]:
    return TypeAdapter(Annotated[Union[attacks], Field(discriminator="method")])  # type: ignore[arg-type]  # noqa: UP007


class _Registered:
    """Validates the settings of any registered attack. Attacks may be registered after this module was imported."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        def validate(data: object, info: ValidationInfo) -> Attack:
            return _validated(data, info.context)  # its errors become those of the field

        return core_schema.with_info_plain_validator_function(validate)

    @classmethod
    def __get_pydantic_json_schema__(cls, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(_union(_registered()).core_schema)


if TYPE_CHECKING:
    AnyAttack = Attack
else:
    AnyAttack = Annotated[Any, _Registered]  # the base class itself would be a part of openapi.yaml

AnyTolerance = Annotated[float, Field(ge=1e-6, le=0.1, allow_inf_nan=False)] | Literal["exact"]
DEFAULT_TARGET = "efficientnet-lite0"


class TargetChoice(Model):
    """The network under attack and, if its task is asked something, what."""

    name: Annotated[str, reference("target")] = Field(
        default=DEFAULT_TARGET,
        min_length=1,
        max_length=100,
        description="the network to attack, by its name in the list of networks (`/v1/targets`)",
    )
    ask: AnyAsk | None = Field(
        default=None,
        exclude_if=absent,
        description="what the network is asked about the image, if it is asked anything",
    )


MAX_LABELS = 1000
"""Largest number of labels that count as one answer."""
Label = Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)] | Annotated[int, Field(ge=0)]
Labels = Label | Annotated[tuple[Label, ...], Field(max_length=MAX_LABELS)]

if TYPE_CHECKING:
    from scene_attack.strict import Converted

    GivenLabels = Converted[Labels | None, Label | Sequence[Label] | None]
else:
    GivenLabels = Labels | None


class Goal(Model):
    """The answer that the attack wants from the network. A label is a name or an index.

    Non-targeted: the network must answer none of the labels in `leave`. Targeted: it must answer `reach`. `truth` says
    which answers are right; it decides the outcome, and which labels count as one answer.

    If `leave` is given, the network's answer to the original image must be among it. If it is left out, it is filled
    in: with the truth if that answer is right, else with that answer and the labels that mean the same.
    """

    truth: GivenLabels = Field(
        default=None,  # type: ignore[arg-type]
        description="the true label, or all labels that are right; where it is left out it is taken from the table of "
        "library meshes, else from `leave`; an empty list says that nobody knows it",
    )
    leave: GivenLabels = Field(
        default=None,  # type: ignore[arg-type]
        description="the label, or all labels, which the network must stop answering; where the truth is left out and "
        "the table has none, it is taken for the truth",
    )
    reach: Label | None = Field(default=None, description="the label that the network must answer (targeted)")
    least_confidence: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        allow_inf_nan=False,
        description="least probability of the new answer for the goal to be met",
    )

    @field_validator("leave")
    @classmethod
    def _something_to_leave(cls, value: Labels | None) -> Labels | None:
        if value == ():
            raise ValueError("an empty list has no label to leave; leave the field out")
        return value


class JobSpec(Model):
    """One attack on one scene. Every field but the scene's objects has a default; the stored spec states all values."""

    scene: Scene
    target: TargetChoice = TargetChoice()
    goal: Goal = Goal()
    attack: AnyAttack = Field(default_factory=lambda: ATTACKS[_method_for({})].model_validate({}))
    tolerance: AnyTolerance = Field(
        default=DEFAULT_TOLERANCE,
        description="largest error of a displayed value, in [0,1], of images inside the attack; `exact` for no "
        "approximation; the verdict is always on the exact image",
    )
    analysis: AnalysisRequest = Field(
        default=AnalysisRequest(),
        description="analyses of the stored perturbation to make after the attack; default none",
    )
    seed: Seed = Field(default=0, description="seed of every random number in the job")

    @field_validator("target", mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        if is_network(value):
            raise ValueError(NOT_SENT)
        return value

    @field_validator("goal")
    @classmethod
    def _known_labels(cls, value: Goal, info: ValidationInfo) -> Goal:
        if info.context and "target" in info.context and "target" in info.data:
            check_labels(value, [info.data["target"]])
        return value

    @model_validator(mode="before")
    @classmethod
    def _filled_in(cls, data: Any) -> Any:
        if isinstance(data, dict) and "attack" in data:
            data = data | {"attack": with_method(data["attack"])}
        return data


def with_method(attack: Any) -> Any:
    """Fills in the method that the renderer declares if the data of an attack leave `method` out."""
    if isinstance(attack, dict) and "method" not in attack:
        return attack | {"method": _method_for(attack)}
    return attack


def _method_for(attack: Mapping[str, Any]) -> str:
    """The method that the renderer declares. An unknown renderer is refused later, when its own field is validated."""
    default = Attack.model_fields["renderer"].default
    renderer = attack.get("renderer", default)
    known = isinstance(renderer, str) and renderer in RENDERERS
    return RENDERERS[renderer if known else default].method


def check_labels(goal: Goal, targets: Iterable[TargetChoice]) -> None:
    """Raises ValidationError with the labels of a goal that one of the targets does not have.

    A target whose labels are not listed is refused elsewhere.
    """
    for choice in targets:
        if choice.name in TARGETS:
            target = TARGETS[choice.name]
            try:
                asked_goal(goal, target.info, labels(choice.name))
            except InvalidRequest as error:
                if error.field != "target.name":
                    raise unknown_parts("goal", error.every, "goal", goal.model_dump()) from error


@dataclass(frozen=True)
class AskedGoal:
    """A goal as the request states it, in label indices. A truth of None is one that the request leaves out."""

    goal: Goal
    labels: tuple[str, ...]
    same: tuple[frozenset[int], ...]
    """Groups of labels that mean the same."""
    truth: frozenset[int] | None
    leave: frozenset[int]
    reach: int | None


def asked_goal(goal: Goal, target: TargetInfo, labels: tuple[str, ...]) -> AskedGoal:
    """Looks up the labels of a goal, and with each those that mean the same.

    Raises InvalidFields with every label that is not among the target's, and InvalidRequest if the label to reach is
    one to leave.
    """
    same = tuple(frozenset(labels.index(label) for label in group if label in labels) for group in same_labels(target))
    wrong: list[InvalidRequest] = []

    def index(field: str, label: Label) -> frozenset[int]:
        try:
            return frozenset([_index(label, labels, field, target.name)])
        except InvalidRequest as error:
            wrong.append(error)
            return frozenset()

    def looked_up(field: str, value: Labels | None) -> frozenset[int]:
        if not isinstance(value, tuple):
            return frozenset() if value is None else index(field, value)
        return frozenset[int]().union(*(index(f"{field}.{i}", label) for i, label in enumerate(value)))

    truth = None if goal.truth is None else with_same(looked_up("goal.truth", goal.truth), same)
    leave = with_same(looked_up("goal.leave", goal.leave), same)
    reached = looked_up("goal.reach", goal.reach)
    if wrong:
        raise InvalidFields(wrong)
    reach = next(iter(reached), None)
    if reach in leave:
        raise InvalidRequest("goal.reach", f"is a label to leave ({labels[reach]!r}); name another one")
    return AskedGoal(goal, labels, same, truth, leave, reach)


def with_same(labels: frozenset[int], groups: tuple[frozenset[int], ...]) -> frozenset[int]:
    """The labels, and those that mean the same as one of them."""
    return labels.union(*(group for group in groups if group & labels))


def _index(label: str | int, labels: tuple[str, ...], field: str, target: str) -> int:
    if isinstance(label, int):
        if label >= len(labels):
            raise InvalidRequest(field, f"{target} has labels 0 to {len(labels) - 1}, not {label}")
        return label
    if label not in labels:
        raise InvalidRequest(field, f"{target} has no label {label!r}{did_you_mean(label, labels)}")
    return labels.index(label)


NOT_SENT = (
    "a network of this process is no part of a request: pass it to sa.attack, or save it by target.save(folder) and "
    "give the folder's name"
)
"""The sentence about a network where its name is due."""


def is_network(given: object) -> bool:
    """Whether a part of a request is a network of this process: a target, a module or a function."""
    return hasattr(given, "logits") or callable(given)


def as_data(field: str, given: object) -> dict[str, Any]:
    """A request, or a part of it, as data: an object's fields that were set, or the dictionary itself.

    A mesh of arrays has its bytes still. Raises InvalidRequest(field) for what is neither.
    """
    if isinstance(given, BaseModel):
        return given.model_dump(exclude_unset=True)
    if isinstance(given, Mapping):
        return dict(given)
    detail = f"must be an object such as sa.Scene, or a dictionary as a request has it, not {type(given).__name__}"
    raise InvalidRequest(field, detail)


AnyModel = TypeVar("AnyModel", bound=BaseModel)


def parsed(model: type[AnyModel], data: object, names: Names | None = None) -> AnyModel:
    """Parses JSON data. Raises InvalidFields, which has every bad field.

    Names of meshes, maps, materials, targets and labels are looked up in `names`, if it is given.
    """
    try:
        return model.model_validate(data, context=names)
    except ValidationError as error:
        raise InvalidFields(invalid_fields(error.errors(include_url=False), model)) from error


def parse(data: object, names: Names | None = None) -> JobSpec:
    """Parses JSON data into a spec, as `parsed` does."""
    return parsed(JobSpec, data, names)


def check_names(request: BaseModel, names: Names) -> None:
    """Raises InvalidFields with every name in a valid request that there is not."""
    parsed(type(request), request.model_dump(mode="json"), names)


def names_in(
    library: Library,
    may_use: Callable[[str], bool] = lambda _: True,
    not_read: Mapping[str, str] = MappingProxyType({}),
) -> Names:
    """Returns the context with which a request is validated together with the names in it.

    An upload for whose name `may_use` is false is unknown. `not_read` says of meshes that are files of this machine why
    they could not be added.
    """

    def check_mesh(name: str) -> None:
        if name in not_read:
            raise InvalidRequest("mesh", not_read[name])
        library.check_mesh(name, may_use)

    # A campaign names the same few things in each of thousands of jobs.
    return {
        "mesh": cache(check_mesh),
        "map": cache(lambda name: library.check_map(name, may_use)),
        "material": check_preset,
        "target": cache(check_obtainable),
        "scene": cache(lambda name: library.scene(name, may_use)),
    }


def digest(spec: BaseModel) -> str:
    """Hex SHA-256 of a request with its defaults filled in, by which the same request is recognised."""
    return sha256(spec.model_dump_json().encode()).hexdigest()


def scene_name(spec: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> str:
    """The meshes of a full spec without their folder, e.g. "grand-piano" or "couch, cube".

    An upload is called by its name in `titles`, or by the beginning of its hash if it has none there.
    """
    return ", ".join(_mesh_name(str(thing["mesh"]), titles or {}) for thing in spec["scene"]["objects"])


def asked_of(spec: Mapping[str, Any]) -> Ask | None:
    """What a full spec asks of its network; None for nothing, and for what another version, or a task that is not
    installed, was asked.
    """
    try:
        return TargetChoice.model_validate(spec["target"]).ask
    except ValidationError:
        return None


def job_name(spec: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> str:
    """The name of what a full spec asks, or `scene_name` if it asks nothing."""
    asked = asked_of(spec)
    return asked.name if asked is not None and asked.names else scene_name(spec, titles)


def group_words(spec: Mapping[str, Any], group: str) -> str:
    """The words of pages for a parameter group of a full spec's renderer, e.g. "surface normals".

    A group that the renderer does not declare, or whose renderer is not installed, is called by its name.
    """
    renderer = RENDERERS.get(spec["attack"]["renderer"])
    return renderer.group(group).words if renderer is not None and group in renderer.group_names else group


def attack_name(spec: Mapping[str, Any]) -> str:
    """Renderer, groups and method of a full spec, e.g. "image fgsm", "torch combined fgsm" or "pyrender color zoo".

    "combined" stands for the default groups of a renderer with several of them. The only group of a renderer is not
    named. If the renderer is not installed, as a plug-in removed since the job ran, all its attacked groups are
    named.
    """
    attack = spec["attack"]
    renderer, groups, known = attack["renderer"], tuple(attack["groups"]), RENDERERS.get(attack["renderer"])
    if known is not None and set(groups) == set(known.default_groups):
        groups = () if len(groups) == 1 else ("combined",)
    targeted = " targeted" if spec.get("goal", {}).get("reach") is not None else ""
    return " ".join([renderer, *(["+".join(groups)] if groups else []), attack["method"]]) + targeted


def _mesh_name(mesh: str, titles: Mapping[str, str]) -> str:
    if not mesh.startswith("sha256:"):
        return mesh.rpartition("/")[2]
    upload = upload_of(mesh)  # of a node of a scene, whose number ends the name
    return titles.get(mesh) or titles.get(upload, upload[:14]) + mesh.removeprefix(upload)


SENT_IMAGE = "image"
"""Name of the job's file that is the image as it was sent: PNG, JPEG or WebP."""
RENDERING = "rendering.png"
"""Name of the file of the fitted scene's rendering, once the job succeeded."""


class RerenderingSpec(Model):
    """The request of a job that fits a scene to an image, and asks a network about the fitted scene's rendering."""

    image: str = Field(description="SHA-256 of the image's file, which is the job's file `image`")
    scene: Scene
    target: TargetChoice
    fit: RerenderingRequest

    def attack(self) -> JobSpec:
        """An attack on the same scene and network: both can be used if it can run."""
        return JobSpec(scene=self.scene, target=self.target)


class RerenderingView(BaseModel):
    """The network's answers to the image and to the rendering of the scene fitted to it."""

    rerendering: Rerendering
    png: str = Field(description="the rendering as a PNG file in base64")
