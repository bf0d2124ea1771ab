"""Loads the operator's extensions and networks into the registries, once in each process."""

from dataclasses import dataclass

from services.attacks.attack import ATTACKS
from services.errors import InvalidRequest, printable
from services.extensions import Extension, load
from services.logs import logger
from services.pipeline.target_folders import TargetFolder, register_folders
from services.process import use
from services.rendering.declaration import RENDERERS
from services.settings import Settings
from services.targets.architectures import ARCHITECTURES
from services.targets.custom.card import AllowList
from services.targets.info import TARGETS

SETTINGS = ("extensions", "targets", "target_factories", "target_endpoints")
"""The settings that say what is loaded."""

log = logger(__name__)


@dataclass(frozen=True)
class _Loaded:
    settings: Settings
    extensions: tuple[Extension, ...]
    target_folders: tuple[TargetFolder, ...]


_loaded: _Loaded | None = None


def set_up(settings: Settings) -> None:
    """Sets up a process that checks or runs jobs: its options, the operator's extensions, and networks in folders.

    Calling it again with the same settings does nothing. Raises InvalidRequest, which names the variable, for a value
    that differs from the one that this process was set up with. An extension or a network that cannot be loaded is left
    out; `loaded_extensions` and `target_folders` say why.
    """
    global _loaded
    use(settings)
    if _loaded is None:
        extensions = load(settings.extension_paths, (ATTACKS, RENDERERS, TARGETS, ARCHITECTURES))
        _loaded = _Loaded(settings, extensions, register_folders(settings.target_folder, AllowList.of(settings)))
    for name in SETTINGS:
        if getattr(settings, name) != getattr(_loaded.settings, name):
            detail = "this process has loaded what another value names; start another process"
            raise InvalidRequest(f"SCENE_ATTACK_{name.upper()}", detail)


def loaded_extensions() -> tuple[Extension, ...]:
    """Returns the files that SCENE_ATTACK_EXTENSIONS names, each with what it registered or the error it raised."""
    return () if _loaded is None else _loaded.extensions


def target_folders() -> tuple[TargetFolder, ...]:
    """Returns the folders of SCENE_ATTACK_TARGETS, each registered as a target or with the reason why it is none."""
    return () if _loaded is None else _loaded.target_folders


def log_extensions() -> None:
    """Logs a line for each extension and for each network's folder: what it adds, or why it was left out."""
    for extension in loaded_extensions():
        if extension.error is None:
            adds = sorted(f"{kind} {name}" for kind, name in extension.adds)
            log.info("extension loaded", file=printable(str(extension.path)), sha256=extension.sha256, adds=adds)
        else:
            log.warning("extension left out", file=printable(str(extension.path)), error=extension.error)
    for folder in target_folders():
        if folder.error is None:
            log.info("target folder registered", target=folder.name, card_sha256=folder.card_sha256)
        else:
            log.warning("target folder left out", target=folder.name, error=folder.error)
