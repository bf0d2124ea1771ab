"""The settings of a command: its options, and the environment for the others."""

from typing import TYPE_CHECKING

from pydantic import ValidationError

from services.errors import InvalidFields, InvalidRequest
from services.pipeline.error_words import in_words

if TYPE_CHECKING:
    from services.settings import Settings


def read_settings(**options: object) -> "Settings":
    """The settings of the environment, with the given `options` over them; None stands for an option left out.

    Raises InvalidFields, which names each wrong option or variable.
    """
    from services.settings import Settings

    given = {name: value for name, value in options.items() if value is not None}
    try:
        return Settings(**given)  # type: ignore[arg-type]
    except ValidationError as error:
        raise InvalidFields(
            [InvalidRequest(_written(str(one["loc"][0]), given), in_words(one)) for one in error.errors()]
        ) from error


def settings_to_run() -> "Settings":
    """The settings of the environment, by which this process is set up to render and attack.

    Raises InvalidRequest, which names the variable, also for a device that is not there.
    """
    from services.device import check_device
    from services.pipeline.extensions import set_up

    settings = read_settings()
    set_up(settings)
    check_device()
    return settings


def _written(name: str, given: dict[str, object]) -> str:
    return f"--{name}" if name in given else f"SCENE_ATTACK_{name.upper()}"
