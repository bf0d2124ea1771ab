"""The files of a finished job, wherever they are."""

from collections.abc import Callable, Mapping

Files = Mapping[str, Callable[[], bytes]]
"""The files by their names, each read when it is called."""
