"""Loads the operator's extensions, once in each process, when this module is imported.

Modules that need the registries with the extensions in them import the registries from here.
"""

from services.attacks.spec import ATTACKS
from services.errors import printable
from services.extensions import load
from services.logs import logger
from services.rendering.declaration import RENDERERS
from services.settings import settings
from services.targets.info import TARGETS

__all__ = ["ATTACKS", "EXTENSIONS", "RENDERERS", "TARGETS", "log_extensions"]

EXTENSIONS = load(settings().extension_paths, (ATTACKS, RENDERERS, TARGETS))
"""The files that SCENE_ATTACK_EXTENSIONS names, each with the names it registered or the error that it raised."""

log = logger(__name__)


def log_extensions() -> None:
    """Logs a line for each extension: the names that it registered, or the reason for which it was left out."""
    for extension in EXTENSIONS:
        if extension.error is None:
            adds = sorted(f"{kind} {name}" for kind, name in extension.adds)
            log.info("extension loaded", file=printable(str(extension.path)), sha256=extension.sha256, adds=adds)
        else:
            log.warning("extension left out", file=printable(str(extension.path)), error=extension.error)
