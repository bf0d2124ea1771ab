"""The commands that run a service here, and its demonstration."""

import typer

from scene_attack_worker.commands import demo, serve


def add(root: typer.Typer) -> None:
    """Adds these commands to those of `scene-attack`."""
    root.add_typer(serve.app)
    root.add_typer(demo.app)
