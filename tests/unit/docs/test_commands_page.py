"""The reference of the command line, and the examples of every --help, which parse and whose files are there."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer.main

from scene_attack.cli.app import app
from scene_attack.cli.commands_page import commands, examples
from training.__main__ import app as training

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
EXAMPLES = [example for _, command in commands() for example in examples(command)]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
TYPED = [
    (page.name, line.removeprefix(".venv/bin/"))
    for page in sorted(PAGES)
    for block in re.findall(r"^```(?:sh|bash)[^\n]*\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)
    for line in block.replace("\\\n", " ").splitlines()
    if re.match(r"(\.venv/bin/)?(scene-attack|python -m training) ", line) and "reference" not in page.parts
]


@pytest.mark.parametrize("example", [one for one in EXAMPLES if "scene-attack" in one])
def test_an_example_of_help_can_be_parsed_and_its_files_are_there(example: str) -> None:
    words = shlex.split(example.partition(" < ")[0])
    begin = words.index("scene-attack") + 1
    assert all(re.fullmatch(r"SCENE_ATTACK_[A-Z_]+=\S+", one) for one in words[: begin - 1])
    command: Any = typer.main.get_command(app)
    parsed(command, words[begin:])
    for word in words:
        if word.startswith("examples/"):
            assert (ROOT / word).is_file(), word


@pytest.mark.parametrize(("page_name", "line"), TYPED)
def test_a_command_of_the_documents_can_be_parsed(page_name: str, line: str) -> None:
    words = shlex.split(re.split(r" [<>|] | \|\| ", line)[0], comments=True)
    ours = words[0] == "scene-attack"
    command: Any = typer.main.get_command(app if ours else training)
    parsed(command, words[1 if ours else 3 :])
    for word in words:
        if word.startswith("examples/"):
            assert (ROOT / word).is_file(), f"{page_name}: {word}"


def parsed(command: Any, arguments: list[str], parent: Any = None) -> None:
    """Parses arguments as the command line does, and runs nothing. Raises a usage error."""
    context = command.make_context(command.name, list(arguments), parent=parent)
    if hasattr(command, "commands") and (rest := [*context._protected_args, *context.args]):  # noqa: SLF001
        _, found, left = command.resolve_command(context, rest)
        assert found is not None
        parsed(found, left, context)


WITHOUT_JSON = ("serve", "api", "worker", "demo")  # what they print is progress


def test_every_command_with_an_answer_can_print_it_as_json() -> None:
    leaves = [(name, command) for name, command in commands() if not hasattr(command, "commands")]
    answering = [one for one in leaves if not any(word in f"{one[0]} " for word in WITHOUT_JSON)]
    assert [name for name, command in answering if not any("--json" in one.opts for one in command.params)] == []


def test_the_shell_completes_commands_and_options() -> None:
    def completed(words: str) -> list[str]:
        environ = {"_SCENE_ATTACK_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        done = subprocess.run(
            [sys.executable, "-m", "scene_attack"],
            env=os.environ | environ,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stderr == ""
        return done.stdout.split()

    assert completed("scene-attack ca") == ["campaign"]
    assert {"list", "show", "watch", "cancel", "delete", "download"} <= set(completed("scene-attack jobs "))
    assert "--json" in completed("scene-attack jobs list --j")


def test_the_completion_of_each_shell_can_be_shown() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "scene_attack", "--show-completion", "bash"],
        env=os.environ | {"SHELL": "/bin/bash", "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "complete" in done.stdout + done.stderr
