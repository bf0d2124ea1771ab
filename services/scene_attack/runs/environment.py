"""Options of the environment, as a command or a script reads them."""

from collections.abc import Callable, Mapping
from typing import TypeVar

from pydantic import ValidationError

from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.options import PREFIX, Options
from scene_attack.runs.field_errors import in_words

Chosen = TypeVar("Chosen", bound=Options)


def read_options() -> Options:
    """The options of the environment. Raises InvalidFields, which names each wrong variable."""
    return read(lambda _: Options.of_environment(), {})


def read(make: Callable[[dict[str, object]], Chosen], given: Mapping[str, object]) -> Chosen:
    """What `make` makes of the `given` options and of the environment; None stands for an option left out.

    Raises InvalidFields, which names each wrong value: one that is given as an option, --port, any other as a variable.
    """
    chosen = {name: value for name, value in given.items() if value is not None}
    try:
        return make(chosen)
    except ValidationError as error:
        wrong = [(str(item["loc"][0]), in_words(item)) for item in error.errors()]
        raise InvalidFields(
            [
                InvalidRequest(f"--{name}" if name in chosen else f"{PREFIX}{name.upper()}", words)
                for name, words in wrong
            ]
        ) from error


def options_to_run() -> Options:
    """The options of the environment, by which this process is set up to render and attack.

    Raises InvalidRequest, which names the variable, also for a device that is not there.
    """
    from scene_attack.process import check_device
    from scene_attack.runs.set_up import set_up

    options = read_options()
    set_up(options)
    check_device()
    return options
