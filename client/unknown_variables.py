"""Finds misspelt settings: variables that look like one and are none."""

from collections.abc import Mapping

from services.settings import Settings
from services.text import did_you_mean

COMMAND_LINE = ("SCENE_ATTACK_URL", "SCENE_ATTACK_KEY")
"""Variables that are no settings of the service: where a client finds it, and with which key."""


def unknown_variables(environ: Mapping[str, str]) -> dict[str, str]:
    """The variables of an environment that look like settings and are none, each with its error."""
    known = [*(f"SCENE_ATTACK_{name.upper()}" for name in Settings.model_fields), *COMMAND_LINE]
    unknown = sorted(name for name in environ if name.startswith("SCENE_ATTACK_") and name not in known)
    return {name: f"there is no such setting{did_you_mean(name, known)}" for name in unknown}
