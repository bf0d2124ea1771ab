"""The settings of a command: its options, and the environment for the others; and misspelt variables."""

from collections.abc import Mapping

from pydantic import ValidationError

from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.runs.field_errors import in_words
from scene_attack.text import did_you_mean
from scene_attack_service.settings import Settings

COMMAND_LINE = ("SCENE_ATTACK_URL", "SCENE_ATTACK_KEY")
"""Variables that are no settings of the service: where a client finds it, and with which key."""


def read_settings(**options: object) -> Settings:
    """The settings of the environment, with the given `options` over them; None stands for an option left out.

    Raises InvalidFields, which names each wrong option or variable.
    """
    chosen = {name: value for name, value in options.items() if value is not None}
    try:
        return Settings(**chosen)  # type: ignore[arg-type]
    except ValidationError as error:
        raise InvalidFields(
            [InvalidRequest(_written(str(entry["loc"][0]), chosen), in_words(entry)) for entry in error.errors()]
        ) from error


def settings_to_run() -> Settings:
    """The settings of the environment, by which this process is set up to render and attack.

    Raises InvalidRequest, which names the variable, also for a device that is not there.
    """
    from scene_attack.process import check_device
    from scene_attack.runs.extensions import set_up

    settings = read_settings()
    set_up(settings)
    check_device()
    return settings


def unknown_variables(environ: Mapping[str, str]) -> dict[str, str]:
    """The variables of an environment that look like settings and are none, each with its error."""
    known = [*(f"SCENE_ATTACK_{name.upper()}" for name in Settings.model_fields), *COMMAND_LINE]
    unknown = sorted(name for name in environ if name.startswith("SCENE_ATTACK_") and name not in known)
    return {name: f"there is no such setting{did_you_mean(name, known)}" for name in unknown}


def _written(name: str, chosen: dict[str, object]) -> str:
    return f"--{name}" if name in chosen else f"SCENE_ATTACK_{name.upper()}"
