"""Loads plug-ins and the operator's networks into the registries, once in each process. It needs no torch.

A network that a user brings is a folder in SCENE_ATTACK_TARGETS, registered by its card. A folder with a mistake
registers nothing; the reason is kept, and the other folders are not affected.
"""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from scene_attack.attacks.attack import ATTACKS
from scene_attack.errors import InvalidRequest, printable
from scene_attack.logs import logger
from scene_attack.options import Options
from scene_attack.plugins import NAME, load, loaded_plugins
from scene_attack.process import use
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.field_errors import invalid_fields
from scene_attack.runs.task_parts import TASKS
from scene_attack.scenes.source import SOURCES
from scene_attack.strict import NotJson, read_json
from scene_attack.targets.architectures import ARCHITECTURES
from scene_attack.targets.custom.card import NOTHING, AllowList, Card
from scene_attack.targets.image_networks import vocabulary_of
from scene_attack.targets.info import TARGETS, UNAVAILABLE, RegisteredTarget, TargetInfo
from scene_attack.targets.labels import imagenet_labels
from scene_attack.text import there_are

if TYPE_CHECKING:
    import torch

    from scene_attack.targets.protocol import Target

CARD = "card.json"
MODEL_FILES = ("model.pt2", "model.onnx", "model.safetensors")
MAX_CARD_BYTES = 16 * 2**20
_PICKLES = (".pt", ".pth", ".bin", ".pkl", ".ckpt")


@dataclass(frozen=True)
class TargetFolder:
    """A folder of SCENE_ATTACK_TARGETS, as it was found."""

    name: str
    """The folder's name, in characters that can be printed."""
    card_sha256: str | None = None
    error: str | None = None
    """The reason for which it is no target; None if it is one."""


LOADED_ONCE = ("without_plugins", "targets", "target_factories", "target_endpoints")
"""The options that say what is loaded."""

log = logger(__name__)


@dataclass(frozen=True)
class _Loaded:
    options: Options
    target_folders: tuple[TargetFolder, ...]


_loaded: _Loaded | None = None


def set_up(options: Options) -> None:
    """Sets up a process that checks or runs jobs: its options, the installed plug-ins, and networks in folders.

    Calling it again with the same options does nothing. Raises InvalidRequest, which names the variable, for a value
    that differs from the one that this process was set up with, and for a plug-in to leave out that there is not. A
    plug-in or a network that cannot be loaded is left out; `loaded_plugins` and `target_folders` say why.
    """
    global _loaded
    use(options)
    if _loaded is None:
        load((ATTACKS, RENDERERS, TARGETS, ARCHITECTURES, SOURCES, TASKS), options.without_plugins)
        _loaded = _Loaded(options, register_folders(options.target_folder, AllowList.of(options)))
    for name in LOADED_ONCE:
        if getattr(options, name) != getattr(_loaded.options, name):
            detail = "this process has loaded what another value names; start another process"
            raise InvalidRequest(f"SCENE_ATTACK_{name.upper()}", detail)


def target_folders() -> tuple[TargetFolder, ...]:
    """Returns the folders of SCENE_ATTACK_TARGETS, each registered as a target or with the reason why it is none."""
    return () if _loaded is None else _loaded.target_folders


def log_plugins() -> None:
    """Logs a line for each plug-in and for each network's folder: what it adds, or why it was left out."""
    for plugin in loaded_plugins():
        if plugin.error is None:
            about = {"package": plugin.package, "sha256": plugin.sha256, "adds": plugin.registered}
            log.info("plug-in loaded", plugin=plugin.name, **about)
        else:
            log.warning("plug-in left out", plugin=plugin.name, package=plugin.package, error=plugin.error)
    for folder in target_folders():
        if folder.error is None:
            log.info("target folder registered", target=folder.name, card_sha256=folder.card_sha256)
        else:
            log.warning("target folder left out", target=folder.name, error=folder.error)


def register_folders(root: Path | None, allowed: AllowList = NOTHING) -> tuple[TargetFolder, ...]:
    """Registers a target for each folder in `root`, in alphabetical order. Hidden folders are left out.
    A card may name the factories and endpoints that are `allowed`.

    The network itself is read when a job first needs it.
    """
    if root is None:
        return ()
    try:
        folders = sorted(path for path in root.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        return (TargetFolder(printable(str(root)), error=f"it cannot be read: {error.strerror}"),)
    return tuple(register_folder(folder, allowed) for folder in folders)


def register_folder(folder: Path, allowed: AllowList) -> TargetFolder:
    """Registers the target in a folder, or finds the reason for which it is none."""
    name = printable(folder.name)
    try:
        if not NAME.fullmatch(folder.name):
            raise InvalidRequest("name", "use a-z, 0-9, - and _ in a folder's name")
        if folder.name in TARGETS:
            raise InvalidRequest("name", "there is a target of this name already; rename the folder")
        found = read_folder(folder, allowed, folder.name)
    except InvalidRequest as error:
        reason = f"{error.field}: {error.detail}"
        UNAVAILABLE[folder.name] = reason
        return TargetFolder(name, error=reason)
    TARGETS.add(folder.name, found)
    return TargetFolder(name, found.info.card_sha256)


def read_folder(folder: Path, allowed: AllowList, name: str) -> RegisteredTarget:
    """Returns the target in a folder, under this name. Raises InvalidRequest("card.json: labels") and the like."""
    card, digest = read_card(folder)
    file = _model_file(folder, card, allowed)
    labels = _labels(folder, card)
    info = TargetInfo(
        name=name,
        title=card.title or name,
        task="classification",
        input_size=card.preprocessing.input_size,
        classes=len(labels),
        differentiable=_differentiable(file, card),
        source=card.source,
        licence=card.licence,
        vocabulary=vocabulary_of(labels),
        card_sha256=digest,
    )

    def load(dtype: "torch.dtype") -> "Target":
        from scene_attack.targets.custom import loading

        return loading.load(info.name, file, card, labels, digest, allowed, dtype)

    card_files = [folder / CARD]
    if isinstance(card.labels, str) and card.labels.endswith(".txt"):
        card_files.append(folder / card.labels)
    return RegisteredTarget(info, lambda: labels, load, card_files=tuple(card_files), model_file=file)


def read_card(folder: Path) -> tuple[Card, str]:
    """Returns a folder's card, and the SHA-256 (hex) of its bytes.

    Raises InvalidRequest, whose field is a path such as "card.json: preprocessing.mean.0".
    """
    data = _read(folder / CARD, 'add one, such as {"labels": ["cat", "dog"]}; docs/targets.md lists its fields')
    try:
        card = Card.model_validate(read_json(data))
    except ValidationError as error:
        first, *others = invalid_fields(error.errors(include_url=False), Card)
        detail = "; ".join([first.detail, *map(str, others)])
        raise InvalidRequest(f"{CARD}: {first.field}", detail) from error
    except NotJson as error:
        raise InvalidRequest(CARD, str(error)) from error
    return card, sha256(data).hexdigest()


def _read(path: Path, missing: str) -> bytes:
    if not path.is_file():
        raise InvalidRequest(path.name, f"there is no such file; {missing}")
    try:
        if path.stat().st_size > MAX_CARD_BYTES:
            raise InvalidRequest(path.name, f"it is larger than {MAX_CARD_BYTES // 2**20} MiB")
        return path.read_bytes()
    except OSError as error:
        raise InvalidRequest(path.name, f"it cannot be read: {error.strerror}") from error


def _model_file(folder: Path, card: Card, allowed: AllowList) -> Path | None:
    """The file that holds the network; None for a factory or an endpoint. Raises InvalidRequest for none or several."""
    files = [folder / name for name in MODEL_FILES if (folder / name).is_file()]
    sources = [file.name for file in files] + [
        f"{key} of the card" for key, value in (("factory", card.factory), ("endpoint", card.endpoint)) if value
    ]
    if len(sources) > 1:
        raise InvalidRequest("model", f"it has {' and '.join(sources)}; keep one")
    if not sources:
        raise InvalidRequest("model", _without(folder))
    file = files[0] if files else None
    of_weights = file is not None and file.suffix == ".safetensors"
    if of_weights and card.architecture not in ARCHITECTURES:
        detail = "is needed" if card.architecture is None else f"there is no {card.architecture!r}"
        raise InvalidRequest(f"{CARD}: architecture", f"{detail}; {there_are(card.architecture or '', ARCHITECTURES)}")
    if card.architecture is not None and not of_weights:
        raise InvalidRequest(f"{CARD}: architecture", "is only for model.safetensors; leave it out")
    for key, named, refusal in (
        ("factory", card.factory, allowed.factory_refusal),
        ("endpoint", card.endpoint, allowed.endpoint_refusal),
    ):
        reason = None if named is None else refusal(named)
        if reason is not None:
            raise InvalidRequest(f"{CARD}: {key}", reason)
    return file


def _without(folder: Path) -> str:
    there = sorted(file.name for file in folder.iterdir() if file.suffix in _PICKLES)
    if there:
        return (
            f"{printable(there[0])} is a pickle, which can run any code and is never read; save the network as "
            "model.pt2 by torch.export.save, or its weights as model.safetensors"
        )
    return f"it has none of {', '.join(MODEL_FILES)}, and its card has neither factory nor endpoint"


def _labels(folder: Path, card: Card) -> tuple[str, ...]:
    if not isinstance(card.labels, str):
        return card.labels
    if card.labels == "imagenet":
        return imagenet_labels()
    field = f"{CARD}: labels"
    if Path(card.labels).name != card.labels or not card.labels.endswith(".txt"):
        raise InvalidRequest(field, 'must be a list, "imagenet", or the name of a .txt file in the folder')
    try:
        lines = _read(folder / card.labels, "write one label a line").decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise InvalidRequest(card.labels, "it is no UTF-8 text") from error
    return tuple(line.strip() for line in lines if line.strip())


def _differentiable(file: Path | None, card: Card) -> bool | None:
    """Whether its scores have gradients, as far as that is known before the network is read."""
    if card.endpoint is not None:
        return False
    return None if file is None else file.suffix != ".onnx"
