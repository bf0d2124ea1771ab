"""The operator's extensions, as this process loaded them: once, before the first request can be parsed.

Whoever needs the registries with the extensions in them takes them from here.
"""

from services.attacks.spec import ATTACKS
from services.extensions import load
from services.logs import logger
from services.rendering.declaration import RENDERERS
from services.settings import settings
from services.targets.info import TARGETS

__all__ = ["ATTACKS", "EXTENSIONS", "RENDERERS", "TARGETS", "log_extensions"]

EXTENSIONS = load(settings().extension_paths, (ATTACKS, RENDERERS, TARGETS))
"""The files that SCENE_ATTACK_EXTENSIONS names."""

log = logger(__name__)


def log_extensions() -> None:
    """One line for each extension: what it adds, or why it was left out."""
    for one in EXTENSIONS:
        if one.error is None:
            adds = sorted(f"{kind} {name}" for kind, name in one.adds)
            log.info("extension loaded", file=str(one.path), sha256=one.sha256, adds=adds)
        else:
            log.warning("extension left out", file=str(one.path), error=one.error)
