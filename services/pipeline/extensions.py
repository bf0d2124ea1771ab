"""Loads the operator's extensions and networks, once in each process, when this module is imported.

Modules that need the registries with the extensions in them import the registries from here.
"""

from services.attacks.spec import ATTACKS
from services.errors import printable
from services.extensions import load
from services.logs import logger
from services.pipeline.target_folders import register_folders
from services.rendering.declaration import RENDERERS
from services.settings import settings
from services.targets.architectures import ARCHITECTURES
from services.targets.info import TARGETS

__all__ = ["ATTACKS", "EXTENSIONS", "RENDERERS", "TARGETS", "TARGET_FOLDERS", "log_extensions"]

EXTENSIONS = load(settings().extension_paths, (ATTACKS, RENDERERS, TARGETS, ARCHITECTURES))
"""The files that SCENE_ATTACK_EXTENSIONS names, each with the names it registered or the error that it raised."""

TARGET_FOLDERS = register_folders(settings().target_folder)
"""The folders of SCENE_ATTACK_TARGETS, each registered as a target or with the reason for which it is none."""

log = logger(__name__)


def log_extensions() -> None:
    """Logs a line for each extension and for each network's folder: what it adds, or why it was left out."""
    for extension in EXTENSIONS:
        if extension.error is None:
            adds = sorted(f"{kind} {name}" for kind, name in extension.adds)
            log.info("extension loaded", file=printable(str(extension.path)), sha256=extension.sha256, adds=adds)
        else:
            log.warning("extension left out", file=printable(str(extension.path)), error=extension.error)
    for folder in TARGET_FOLDERS:
        if folder.error is None:
            log.info("target folder registered", target=folder.name, card_sha256=folder.card_sha256)
        else:
            log.warning("target folder left out", target=folder.name, error=folder.error)
