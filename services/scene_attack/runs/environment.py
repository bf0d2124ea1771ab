"""Options of the environment, as a command or a script reads them."""

from collections.abc import Mapping

from pydantic import ValidationError

from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.options import PREFIX, Options
from scene_attack.runs.field_errors import in_words


def read_options(**given: object) -> Options:
    """The options of the environment, with the `given` ones over them; None stands for one that is left out, and so
    does an empty variable.

    Raises InvalidFields, which names each wrong option or variable.
    """
    chosen = {name: value for name, value in given.items() if value is not None}
    try:
        return Options.of_environment(chosen)
    except ValidationError as error:
        raise invalid_options(error, chosen) from error


def invalid_options(error: ValidationError, given: Mapping[str, object]) -> InvalidFields:
    """The error that names each wrong value: one of the `given` as an option, --port, any other as a variable."""
    return InvalidFields(
        [
            InvalidRequest(f"--{name}" if name in given else f"{PREFIX}{name.upper()}", in_words(wrong))
            for wrong in error.errors()
            for name in (str(wrong["loc"][0]),)
        ]
    )


def options_to_run() -> Options:
    """The options of the environment, by which this process is set up to render and attack.

    Raises InvalidRequest, which names the variable, also for a device that is not there.
    """
    from scene_attack.process import check_device
    from scene_attack.runs.extensions import set_up

    options = read_options()
    set_up(options)
    check_device()
    return options
