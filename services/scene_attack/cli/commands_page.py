"""Writes the reference of the command line: `python -m scene_attack.cli.commands_page > docs/reference/commands.md`."""

import re
from collections.abc import Iterator
from typing import Any

import typer.main

from scene_attack.cli.app import app

NAME = "scene-attack"
HEAD = """# Commands

Every command has `--help`, which says the same as this page; a test compares the two. The exit code is 0 on success, 1
on failure and 2 for bad input. With `--json` a command prints one JSON document on standard output; progress and
remarks go to standard error.

An `ID` may be shortened to as much of its beginning as no other job or campaign has. On a terminal that is too narrow
for a table, columns are left out, which the line below the table names; `--json` has everything.

`scene-attack --install-completion` teaches your shell (bash, zsh, fish) to complete commands and options with the tab
key; `--show-completion` prints the script instead.
"""


def page() -> str:
    """The text of docs/reference/commands.md."""
    return "\n".join([HEAD, *(_section(name, command) for name, command in commands())])


def commands() -> Iterator[tuple[str, Any]]:
    """Every command with what one types for it, groups among them, in the order of --help."""
    yield from _below(NAME, typer.main.get_command(app))


def examples(command: Any) -> list[str]:
    """The examples of a command's --help."""
    return re.findall(r"\[bold\](.*?)\[/bold\]", command.epilog or "")


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    if name != NAME:
        yield name, command
    for child, subcommand in getattr(command, "commands", {}).items():
        yield from _below(f"{name} {child}", subcommand)


def _section(name: str, command: Any) -> str:
    level = "##" if name.count(" ") == 1 else "###"
    # a paragraph's lines belong together
    paragraphs = [" ".join(part.split()) for part in re.split(r"\n\s*\n", command.help or "")]
    lines = [f"{level} `{name}`", "", *[line for part in paragraphs for line in (_text(part), "")]]
    shown = examples(command)
    if shown:
        lines += ["```sh", *shown, "```", ""]
    rows = [_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
    if rows:
        lines += ["| | |", "|---|---|", *rows, ""]
    return "\n".join(lines)


def _row(parameter: Any) -> str:
    help_text = getattr(parameter, "help", None) or ""
    if parameter.param_type_name == "option":
        names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
        value = parameter.default
        shown = value is not None and not callable(value) and not parameter.is_flag and value != ()
        default = f" Default: `{value}`." if shown else ""
        needed = " Required." if parameter.required else ""
        return f"| {names} | {_text(help_text)}{default}{needed} |"
    name = str(parameter.metavar or parameter.name).upper()
    return f"| `{name}` | {_text(help_text)} |"


def _text(text: str) -> str:
    return re.sub(r"\[/?bold\]", "", text).replace("|", "\\|").replace("<", "&lt;")


if __name__ == "__main__":
    print(page(), end="")
