"""The library's door: a scene, a network and an attack go in as objects, and a result comes out."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, overload

from scene_attack import disk
from scene_attack.errors import InvalidFields, InvalidRequest, Unreadable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from pandas import DataFrame
    from torch import Tensor, nn

    from scene_attack.analysis.campaign_table import Table
    from scene_attack.analysis.records import Answer
    from scene_attack.attacks.attack import Attack
    from scene_attack.options import Options
    from scene_attack.rendering.plan import Plan, Tolerance
    from scene_attack.rendering.protocol import Renderer
    from scene_attack.runs import result as runs
    from scene_attack.runs.campaign_plan import CampaignResult
    from scene_attack.runs.campaign_run import CampaignProgress
    from scene_attack.runs.campaign_spec import CampaignSpec
    from scene_attack.runs.execute import Progress
    from scene_attack.runs.replay import Replay
    from scene_attack.runs.spec import Goal, JobSpec
    from scene_attack.scenes.description import Scene
    from scene_attack.targets.classifier import Classifier
    from scene_attack.targets.custom.card import Preprocessing
    from scene_attack.targets.info import TargetInfo
    from scene_attack.targets.protocol import Target

    Network = nn.Module | Target | Callable[[Any], Any] | Path

MODULE = "module"
"""The name of a network that is given none."""
_PARTS = ("name", "labels", "input_size", "differentiable", "weights_sha256", "backend")
"""Attributes of a target."""


@dataclass(frozen=True)
class Seen:
    """An image, uint8 [H, W, 3], and what the network answered."""

    answer: Answer
    image: NDArray[np.uint8]

    @property
    def label(self) -> str:
        """The label of the largest score."""
        return self.answer.label

    @property
    def confidence(self) -> float:
        """The label's probability."""
        return self.answer.confidence


@dataclass(frozen=True, repr=False)
class Result:
    """What an attack came to: its record, which is the `result` of a job, and the files that `run --out` writes, by
    their paths. With a mesh of one's own these have the scene's meshes and map, too.
    """

    record: runs.Result
    files: Mapping[str, bytes]

    @property
    def outcome(self) -> str:
        """The verdict in one word; only "fooled" counts as a success."""
        return self.record.outcome

    @property
    def verified(self) -> bool:
        """Whether the answer to the stored perturbation, rendered afresh and rounded to 8 bits, meets the goal."""
        return self.record.verified

    @property
    def perceptibility(self) -> float:
        """The paper's p(ΔY), in [0, √3]: of the exact image before it is rounded."""
        return self.record.p

    @cached_property
    def original(self) -> Seen:
        """The scene's own image and the answer to it."""
        from scene_attack.runs.result import ORIGINAL

        return Seen(self.record.original, self._pixels(ORIGINAL))

    @cached_property
    def attacked(self) -> Seen:
        """The exact image of the perturbation, rounded to 8 bits, and the answer to it."""
        from scene_attack.runs.result import ATTACKED

        return Seen(self.record.attacked, self._pixels(ATTACKED))

    @cached_property
    def perturbation(self) -> dict[str, Tensor]:
        """The change of each attacked group, in the group's unit."""
        from safetensors.torch import load

        from scene_attack.runs.result import PERTURBATION

        return load(self.files[PERTURBATION])

    @property
    def plan(self) -> Plan:
        """How the images inside the attack were rendered, what was left out, and the error that is stated."""
        return self.record.plan

    @property
    def trace(self) -> list[Any]:
        """One row for each step."""
        return self.record.trace

    def __str__(self) -> str:
        """The finding: the answers, whether the new one is verified, p, and a line for each thing that changed."""
        verified = "verified" if self.verified else "not verified"
        answers = f"{self.original.label} → {self.attacked.label}, {verified}, p = {self.perceptibility:.4f}"
        return "\n".join([answers, *self.record.findings])

    def save(self, folder: Path | str) -> None:
        """Writes the files into a folder. Raises InvalidRequest("folder") if it holds the result of another job."""
        from scene_attack.cli.result_folder import check_free, prepare_folder
        from scene_attack.runs.spec import parse

        made_by = self.record.provenance
        network = (made_by.weights_sha256, made_by.card_sha256)
        check_free(Path(folder), parse(self.record.spec), "folder", network)
        prepare_folder(Path(folder), "folder")
        for name, data in self.files.items():
            disk.write(Path(folder) / name, data)

    def replay(self, target: Network | None = None, *, options: Options | None = None) -> Replay:
        """Renders both images again by the exact path, asks the network, and says what differs.

        `target` is the network of this process that was attacked; a network with a name is found by it. Raises as
        `attack` does.
        """
        from scene_attack.cli.specs import local_library
        from scene_attack.owner import run
        from scene_attack.runs.replay import replay

        chosen = _set_up(options)
        asked: Any = self.record.spec["target"]
        made = None if target is None else _named(target, chosen, asked["name"])[1]

        def work(_: Callable[[], bool]) -> Replay:
            with _known(made), TemporaryDirectory() as folder:
                for file, data in self.files.items():
                    disk.write(Path(folder) / file, data)
                return replay(Path(folder), local_library(chosen), chosen)

        return run(work)

    def __repr__(self) -> str:
        word = "verified" if self.verified else "not verified"
        labels = f"{self.record.original.label} → {self.record.attacked.label}"
        return f"<Result {labels}: {self.outcome}, {word}, p = {self.perceptibility:.4f}>"

    def _repr_html_(self) -> str:
        """The images before and after, their difference times 5, and the answers, as a notebook shows them."""
        pictures = {
            "original.png": f"{self.original.label} {self.original.confidence:.2f}",
            "attacked.png": f"{self.attacked.label} {self.attacked.confidence:.2f}",
            "perturbation.png": f"p = {self.perceptibility:.4f}",
        }
        cells = "".join(
            f'<td><img src="data:image/png;base64,{base64.b64encode(self.files[name]).decode()}" alt="{name}"><br>'
            f"{html.escape(words)}</td>"
            for name, words in pictures.items()
        )
        word = "verified" if self.verified else "not verified"
        return f"<table><tr>{cells}</tr></table><p>{self.outcome}, {word}</p>"

    def _pixels(self, name: str) -> NDArray[np.uint8]:
        import numpy as np
        from PIL import Image

        with Image.open(BytesIO(self.files[name])) as image:
            return np.asarray(image.convert("RGB"))


def load(folder: Path | str) -> Result:
    """Reads the result in a folder that `Result.save`, `run --out` or a job's download wrote.

    Raises InvalidRequest("directory") if it is no output of a finished job, or is damaged.
    """
    from scene_attack.runs.replay import read_stored

    return Result(read_stored(Path(folder)).result, _files(Path(folder)))


@overload
def target(
    network: nn.Module,
    *,
    labels: Sequence[str] | str | None = None,
    preprocessing: Preprocessing | Mapping[str, Any] | None = None,
    output: Literal["scores", "probabilities"] = "scores",
    name: str = MODULE,
    options: Options | None = None,
) -> Classifier: ...
@overload
def target(
    network: Network | str,
    *,
    labels: Sequence[str] | str | None = None,
    preprocessing: Preprocessing | Mapping[str, Any] | None = None,
    output: Literal["scores", "probabilities"] = "scores",
    name: str = MODULE,
    options: Options | None = None,
) -> Target: ...
def target(
    network: Network | str,
    *,
    labels: Sequence[str] | str | None = None,
    preprocessing: Preprocessing | Mapping[str, Any] | None = None,
    output: Literal["scores", "probabilities"] = "scores",
    name: str = MODULE,
    options: Options | None = None,
) -> Target:
    """A network as a target: a torch module, a function of images, a MAITE image classifier, a folder with a card, the
    URL of an endpoint, or the name of a target that `scene-attack targets` lists.

    A module takes images [B, 3, H, W] and returns scores [B, K] before the softmax; it is copied and not changed. A
    function does the same with float32 CPU tensors, and may return any array; only methods without gradients attack it.
    `labels` names the scores: a list, "imagenet" for ImageNet's 1,000 in their usual order, with which library meshes
    have their truth, or None for "0" to "K-1" or the MAITE model's own `metadata.index2label`; a URL needs them.
    `preprocessing` says how an image becomes the input. `output` says what is returned; of probabilities the logarithm
    is taken. A folder is a path, such as "./mine"; docs/targets.md says what is in it, and what an endpoint answers. A
    target is returned as it is. `options` default to those of the SCENE_ATTACK_ variables. Raises InvalidRequest, which
    names the argument.
    """
    return _target(network, _set_up(options), name, labels, preprocessing, output)


def attack(
    scene: Scene | Renderer | Mapping[str, Any],
    target: Network | str | Mapping[str, Any],
    attack: Attack | Mapping[str, Any] | None = None,
    *,
    goal: Goal | Mapping[str, Any] | None = None,
    seed: int = 0,
    out: Path | str | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    options: Options | None = None,
    **others: Any,
) -> Result:
    """Runs one attack and returns its result.

    Each argument is an object, or what a request has in its place (docs/reference/fields.md). `scene` may be what
    `renderer` returned: its scene is attacked by it, in its groups and within its tolerance, where `attack` and
    `tolerance` state none. An attack or a renderer of one's own is registered by the decorators of
    `scene_attack.plugin`, in a script as in a plug-in. `target` is a network of this process (see `target`), the name
    of one that `scene-attack targets` lists, or a request's `target`. `others` are further fields of a request:
    `tolerance` and `analysis`. A `mesh` may be a path relative to
    the working directory, "./chair.obj", or `sa.Mesh`. With `out`, the files are written into that folder while the
    attack runs; it may hold no other job's result. `options` default to those of the
    SCENE_ATTACK_ variables. Raises InvalidRequest, which names the field or the argument, for anything that cannot run,
    and JobFailure for a run that fails.

    It may be called from several threads: attacks run one after the other (`scene_attack.owner`).
    """
    from scene_attack.cli.result_folder import check_free, prepare_folder
    from scene_attack.cli.specs import local_library
    from scene_attack.owner import Owned, run
    from scene_attack.runs.execute import execute
    from scene_attack.runs.spec import as_data
    from scene_attack.scenes.exported_assets import write_assets

    chosen = _set_up(options)
    drawn: dict[str, Any] = scene.request if isinstance(scene, Owned) else {}
    given = {"scene": None if drawn else scene, "attack": attack, "goal": goal}
    stated = {name: as_data(name, one) for name, one in given.items() if one is not None}
    fields = {"seed": seed} | drawn | others | stated
    asked = stated.get("attack", {})
    if drawn and asked.get("renderer") in (None, drawn["attack"]["renderer"]):
        fields["attack"] = drawn["attack"] | asked
    made = None
    if isinstance(target, Mapping):
        fields["target"] = dict(target)
    else:
        name, made = _named(target, chosen)
        fields["target"] = {"name": name}
    network = None if made is None else _hashes(made)

    def work(interrupted: Callable[[], bool]) -> Result:
        with _known(made), TemporaryDirectory() as scratch:
            spec = _spec(fields, chosen)
            folder = Path(scratch if out is None else out)
            if out is not None:
                check_free(folder, spec, "out", network)
                prepare_folder(folder, "out")
            library = local_library(chosen)
            record = execute(spec, folder, library, progress=progress, cancelled=interrupted)
            things = (*spec.scene.objects, *spec.scene.fixed)
            if any(library.has_upload(thing.mesh) for thing in things):  # no other machine has it
                write_assets(spec.scene, library, lambda name, data: disk.write(folder / name, data))
            return Result(record, _files(folder))

    return run(work)


def renderer(
    scene: Scene | Mapping[str, Any],
    name: str = "torch",
    *,
    groups: Sequence[str] | None = None,
    tolerance: Tolerance | None = None,
    options: Options | None = None,
) -> Renderer:
    """The renderer of a scene, for a loop of one's own: `renderer.render({group: values [B, …]})` gives images
    [B, H, W, 3] in [0,1], with gradients where the renderer has them; `renderer.initial()` are the scene's own values.
    `attack` takes it in the scene's place.

    `groups` are those that will change (None: the renderer's default ones), within `tolerance` of a displayed value.
    Raises InvalidRequest, which names the field.
    """
    from scene_attack.cli.specs import local_library
    from scene_attack.owner import Owned, run
    from scene_attack.rendering.factory import build
    from scene_attack.rendering.plan import DEFAULT_TOLERANCE
    from scene_attack.runs.spec import as_data
    from scene_attack.scenes.resolve import resolve

    chosen = _set_up(options)
    fields = {"scene": as_data("scene", scene)}
    within = DEFAULT_TOLERANCE if tolerance is None else tolerance

    def work(_: Callable[[], bool]) -> Renderer:
        found = resolve(_spec(fields, chosen).scene, local_library(chosen))
        return build(found, name, groups=groups, tolerance=within)

    attacked = {"renderer": name} if groups is None else {"renderer": name, "groups": list(groups)}
    owned: Any = Owned(run(work), fields | {"attack": attacked, "tolerance": within})
    return owned  # type: ignore[no-any-return]


def truth(scene: Scene | Mapping[str, Any], target: Network | str) -> tuple[str, ...]:
    """The network's labels that are right for a scene by the project's reviewed table, which an attack takes for the
    truth if its goal states none; empty where nobody has said.

    It has the furniture of the library for ImageNet's labels and for kinds of furniture. Of objects that differ in
    their labels none is right. Raises InvalidRequest for what is no scene, and an unknown network.
    """
    from scene_attack.runs.classification import table_truth
    from scene_attack.runs.spec import as_data
    from scene_attack.targets import registry

    name, made = _named(target, _set_up(None))
    meshes = [thing["mesh"] for thing in as_data("scene", scene)["objects"]]
    labels = registry.labels(name) if made is None else tuple(made.labels)
    info = registry.card(name) if made is None else _info(made)
    return tuple(labels[index] for index in table_truth(meshes, info, labels))


@dataclass(frozen=True)
class CampaignRun:
    """A campaign that has ended: its record, which is the content of `table.json`, and the folder with its files."""

    record: CampaignResult
    folder: Path

    @property
    def table(self) -> Table:
        """The paper's table: a cell for each network and attack."""
        return self.record.table

    @property
    def results(self) -> list[Result]:
        """The results of the jobs that ran to their end, in their order in the plan. They are read anew each time."""
        from scene_attack.cli.campaigns import folder_results

        return [load(folder) for _, folder in folder_results(self.folder)]

    def to_frame(self) -> DataFrame:
        """A DataFrame with a line for each result: its column, what was attacked, both answers, the outcome, p, cost.

        Raises MissingExtra, which says how to install pandas, where it is not.
        """
        from scene_attack.client.client import pandas_module
        from scene_attack.runs.campaign_spec import CampaignSpec
        from scene_attack.runs.spec import attack_name, parse, scene_name

        records: Any = [result.record for result in self.results]
        spec = CampaignSpec.model_validate_json((self.folder / "campaign.json").read_bytes())
        columns = {one.attack.model_dump_json(): one.name for grid in spec.grids for one in grid.attacks}
        rows = [
            {
                "column": columns.get(parse(record.spec).attack.model_dump_json(), ""),
                "scene": scene_name(record.spec),
                "azimuth": record.spec["scene"]["camera"]["azimuth"],
                "target": record.spec["target"]["name"],
                "attack": attack_name(record.spec),
                "seed": record.spec["seed"],
                "original": record.original.label,
                "attacked": record.attacked.label,
                "outcome": record.outcome,
                "verified": record.verified,
                "p": record.p,
                "queries": record.cost.queries,
                "seconds": record.cost.seconds,
            }
            for record in records
        ]
        return pandas_module().DataFrame.from_records(rows)


def campaign(
    campaign: CampaignSpec | Mapping[str, Any],
    out: Path | str,
    *,
    targets: Sequence[Network] = (),
    progress: Callable[[CampaignProgress], None] = lambda _: None,
    options: Options | None = None,
) -> CampaignRun:
    """Runs the jobs of a campaign, one after another, and writes their files into the folder `out`.

    Run again with the same folder, it goes on with what is left. `campaign` names networks; `targets` are those of this
    process among them, each with a name of its own (`target`). `progress` is called after each view and before each
    job. A job that fails is a case without success. Raises as `attack` does.
    """
    from scene_attack.cli.result_folder import prepare_folder
    from scene_attack.cli.specs import local_library, parsed
    from scene_attack.owner import run
    from scene_attack.runs.campaign_run import run_campaign
    from scene_attack.runs.campaign_spec import parse
    from scene_attack.runs.check import check_samples, check_size
    from scene_attack.runs.prepare import prepare
    from scene_attack.runs.spec import as_data

    chosen = _set_up(options)
    made = [_named(network, chosen)[1] for network in targets]
    data = as_data("campaign", campaign)

    def work(interrupted: Callable[[], bool]) -> CampaignRun:
        with ExitStack() as known:
            for one in made:
                known.enter_context(_known(one))
            spec, library, folder = parsed(parse, data, Path.cwd(), chosen), local_library(chosen), Path(out)
            check_size(spec)
            prepare_folder(folder, "out")
            check_samples(spec, lambda job: prepare(job, library))
            record = run_campaign(spec, folder, library, progress=progress, cancelled=interrupted)
            disk.write(folder / "table.json", f"{record.model_dump_json(indent=1)}\n".encode())
            return CampaignRun(record, folder)

    return run(work)


def _files(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def _set_up(options: Options | None) -> Options:
    from scene_attack.owner import run
    from scene_attack.runs.environment import read_options
    from scene_attack.runs.set_up import set_up

    chosen = read_options() if options is None else options
    run(lambda _: set_up(chosen))
    return chosen


def _spec(fields: dict[str, Any], options: Options) -> JobSpec:
    from scene_attack.cli.specs import parsed
    from scene_attack.runs.spec import parse

    return parsed(parse, fields, Path.cwd(), options)


def _target(
    network: Any,
    options: Options,
    name: str = MODULE,
    labels: Any = None,
    preprocessing: Any = None,
    output: str = "scores",
) -> Target:
    from torch import nn
    from torch.jit import ScriptModule

    from scene_attack.targets.custom.loading import is_maite, scores_of, target_of

    if output not in ("scores", "probabilities"):
        raise InvalidRequest("output", f'must be "scores" or "probabilities", not {output!r:.80}')
    if isinstance(network, str) and "://" in network:
        return _endpoint(network, name, labels, _preprocessing(preprocessing), output, options)
    of_its_own = isinstance(network, str | Path) or (not isinstance(network, nn.Module) and hasattr(network, "logits"))
    if of_its_own:
        given = {"labels": labels, "preprocessing": preprocessing, "output": None if output == "scores" else output}
        for field, value in given.items():
            if value is not None:
                raise InvalidRequest(field, "the target says so itself; leave this out")
        if isinstance(network, str | Path):
            return _stored(network, name, options)
        missing = [part for part in _PARTS if not hasattr(network, part)]
        if missing:
            raise InvalidRequest("target", f"it has `logits` and so is a target, but no {' and no '.join(missing)}")
        made: Target = network
        return made
    if not callable(network):
        raise InvalidRequest(
            "target",
            "must be a torch.nn.Module, a function of images [B, 3, H, W], a MAITE model, a folder, a URL, a name, or "
            f"a target, not {type(network).__name__}",
        )
    if isinstance(network, ScriptModule):
        detail = "is a TorchScript module, whose gradients cannot be turned off; give the module it was made of"
        raise InvalidRequest("target", detail)
    if isinstance(network, nn.Module) and any(value.is_meta for value in network.state_dict().values()):
        raise InvalidRequest("target", "its weights are on the device meta, which has no values; load them first")
    chosen = _preprocessing(preprocessing)
    probabilities = output == "probabilities"
    if is_maite(network):
        own = network.metadata.get("index2label") or {}
        named = _labels(labels) or tuple(own.get(index, "") for index in range(len(own)))
        if not named or not all(named):
            raise InvalidRequest("labels", "the model has no metadata.index2label from 0 on; give its labels here")
    else:
        named = _labels(labels) or _numbers(network, chosen)
    make = target_of if isinstance(network, nn.Module) or is_maite(network) else scores_of
    try:
        return make(name, network, named, chosen, probabilities=probabilities)
    except Unreadable as error:
        raise InvalidRequest("labels", str(error)) from error


def _stored(place: str | Path, name: str, options: Options) -> Target:
    """The target in a folder, or a listed one of this name."""
    import torch

    from scene_attack.plugins import NAME
    from scene_attack.runs.set_up import read_folder
    from scene_attack.targets import registry
    from scene_attack.targets.custom.card import AllowList

    if isinstance(place, str) and NAME.fullmatch(place):
        if name != MODULE:
            raise InvalidRequest("name", "a listed target has its name; leave this out")
        return registry.load(place)
    folder = Path(place).absolute()
    if not folder.is_dir():
        raise InvalidRequest("target", f"there is no folder {str(place)!r}; give one with a card.json, a URL or a name")
    if name == MODULE:
        name = folder.name
    try:
        found = read_folder(folder, AllowList.of(options), name)
    except InvalidRequest as error:
        raise InvalidRequest("target", f"the folder {str(place)!r} is no target: {error}") from error
    return found.load(torch.float32)


def _endpoint(url: str, name: str, labels: Any, preprocessing: Preprocessing, output: Any, options: Options) -> Target:
    from scene_attack.targets.custom.card import AllowList, Card
    from scene_attack.targets.custom.loading import endpoint_of

    named = _labels(labels)
    if not named:
        raise InvalidRequest("labels", "a URL does not say its labels; give them in the order of its scores")
    card = Card(labels=named, preprocessing=preprocessing, output=output, endpoint=url)
    try:
        return endpoint_of(url, name, card, named, AllowList.of(options))
    except InvalidRequest as error:
        raise InvalidRequest("target", error.detail) from error


def _named(network: Any, options: Options, name: str = MODULE) -> tuple[str, Target | None]:
    """A network's name, and its target unless this name is known already."""
    from scene_attack.owner import run
    from scene_attack.targets.info import TARGETS
    from scene_attack.targets.registry import load

    if isinstance(network, str) and not set(network) & {"/", "\\"}:
        return network, None
    made = _target(network, options, name)
    # while an attack of another thread runs, its network is among the listed ones
    listed = run(lambda _: made.name in TARGETS and load(made.name) is made)
    return made.name, None if listed else made


def _info(made: Target) -> TargetInfo:
    """The card of a target of this process."""
    from scene_attack.targets.custom.loading import describe
    from scene_attack.targets.image_networks import vocabulary_of

    return describe(made.name, made, vocabulary_of(tuple(made.labels)))


def _hashes(made: Target) -> tuple[str | None, ...]:
    """The hashes of a target's weights and card. Nobody knows whether two functions are the same: they have none."""
    from scene_attack.targets.custom.loading import ScoresOnly

    unknown = isinstance(getattr(made, "network", None), ScoresOnly)
    return () if unknown else (made.weights_sha256, _info(made).card_sha256)


@contextmanager
def _known(made: Target | None) -> Iterator[None]:
    """Makes a target of this process known under its name; None has a name already."""
    from scene_attack.targets.registry import registered

    if made is None:
        yield
    else:
        with registered(_info(made), made):
            yield


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


def _preprocessing(given: Any) -> Preprocessing:
    from pydantic import ValidationError

    from scene_attack.runs.field_errors import invalid_fields
    from scene_attack.targets.custom.card import Preprocessing

    if given is None:
        return Preprocessing()
    if isinstance(given, Preprocessing):
        return given
    if not isinstance(given, Mapping):
        detail = f"must be sa.Preprocessing or a mapping such as {{'input_size': [32, 32]}}, not {type(given).__name__}"
        raise InvalidRequest("preprocessing", detail)
    try:
        return Preprocessing.model_validate(dict(given))
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
        raise InvalidRequest("target", detail) from error
    if not isinstance(scores, torch.Tensor) or scores.ndim != 2:
        raise InvalidRequest("target", "it must return scores [B, K], one row for each image")
    return tuple(map(str, range(scores.shape[1])))
