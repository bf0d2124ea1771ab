"""The plug-in: declares the renderer `blender`. It imports neither torch nor bpy."""

import sys
from importlib.metadata import PackageNotFoundError, version

from scene_attack.extras import MissingExtra
from scene_attack.plugin import path_traced, register_renderer

INTERFACE = 1
PYTHON = sys.version_info[:2]
RELEASE = "5.0"
"""The release of Blender that is tested. Another one has other nodes, settings and random numbers."""


def check_installed(field: str, what: str = "the renderer blender") -> None:
    """Raises MissingExtra(field) unless Blender, which `what` needs, is there as a Python module of RELEASE."""
    try:
        found = version("bpy")
    except PackageNotFoundError:
        found = None
    if found is not None and found.startswith(f"{RELEASE}."):
        return
    if PYTHON != (3, 11):
        need = f"Python 3.11, which its package bpy {RELEASE} is made for, and this is {sys.version.split()[0]}"
    else:
        there = "is not installed" if found is None else f"is there as {found}"
        need = f'the package bpy {RELEASE}, which {there}: pip install --no-deps "bpy=={RELEASE}.*"'
    raise MissingExtra(field, f"{what} needs {need}")


BLENDER = path_traced(
    "blender",
    "traces paths of light by Blender's Cycles, and moves lamps, objects and camera; no gradients",
    "scene_attack_blender.renderer:BlenderRenderer",
    check_installed,
)

register_renderer(BLENDER)
