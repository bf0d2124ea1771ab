"""The plug-in: declares the renderer `mitsuba`. It imports neither torch nor mitsuba."""

from importlib.util import find_spec

from scene_attack.extras import MissingExtra
from scene_attack.plugin import path_traced, register_renderer

INTERFACE = 1


def check_installed(field: str) -> None:
    """Raises MissingExtra(field) where Mitsuba is not installed."""
    if find_spec("mitsuba") is None:
        command = 'pip install "scene-attack[mitsuba]"'
        raise MissingExtra(field, f'the renderer mitsuba needs the extra "mitsuba": {command}')


MITSUBA = path_traced(
    "mitsuba",
    "traces paths of light by Mitsuba 3, and moves lamps, objects and camera; no gradients",
    "scene_attack_mitsuba.renderer:MitsubaRenderer",
    check_installed,
)

register_renderer(MITSUBA)
