"""The commands that look after a service: its keys, and a copy of its data."""

import typer

from scene_attack_service.commands import backup, keys


def add(root: typer.Typer) -> None:
    """Adds these commands to those of `scene-attack`."""
    root.add_typer(backup.app)
    root.add_typer(keys.app, name="keys")
