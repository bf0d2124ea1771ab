"""Registries and plug-ins that add to them, with a registry of the test's own."""

import hashlib
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from scene_attack import plugins
from scene_attack.errors import ERROR_LENGTH, InvalidRequest
from scene_attack.options import Options
from scene_attack.plugins import Plugin, Registry, load
from tests.installed import installed

SHAPES: Registry[int] = Registry("shape", [])
REGISTER = "from tests.unit.test_plugins import SHAPES\nINTERFACE = 1\n"


@pytest.fixture
def shapes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Registry[int]]:
    # The module that plug-ins import is another object than this one where pytest imports by path.
    sys.modules["tests.unit.test_plugins"] = sys.modules[__name__]
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(plugins, "_loaded", [])
    before = set(sys.modules)
    SHAPES.restore({"triangle": 3})
    yield SHAPES
    SHAPES.restore({})
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]


def loaded(folder: Path, **modules: str) -> dict[str, Plugin]:
    installed(folder, modules)
    return {one.name: one for one in load([SHAPES]) if not one.ours}


def test_a_plugin_registers_by_being_imported(shapes: Registry[int], tmp_path: Path) -> None:
    code = REGISTER + "SHAPES.add('square', 4)\n"
    found = loaded(tmp_path, four=code)["four"]
    assert shapes["square"] == 4
    assert found == Plugin(
        "four", "four 1.0", False, hashlib.sha256(code.encode()).hexdigest(), frozenset({("shape", "square")})
    )


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("SHAPES.add('square', 4)\nraise OSError('no disk')\n", "line 4: OSError: no disk"),
        ("SHAPES.add('square', 4)\nSHAPES.add('triangle', 3)\n", "there is a shape 'triangle' already"),
        ("SHAPES.add('square', 4)\nimport sys\nsys.exit(3)\n", "SystemExit: 3"),
        ("SHAPES.add('square', 4)\nSHAPES.add('no spaces', 4)\n", "'no spaces' is no name for a shape"),
        ("SHAPES.add('square', 4)\nx = = 1\n", "SyntaxError"),
        ("SHAPES.add('square', 4)\nimport a_module_that_is_not_there\n", "ModuleNotFoundError"),
        ("SHAPES.add('square', 4)\nraise BaseException('odd')\n", "line 4: BaseException: odd"),
        (
            "SHAPES.add('square', 4)\nclass Odd(Exception):\n    def __str__(self): raise ValueError\nraise Odd\n",
            "line 6: Odd: its message cannot be read",
        ),
        ("SHAPES.add('square', 4)\ndef f(): f()\nf()\n", "RecursionError"),
        ("SHAPES.add('square', 4)\n\0\n", "null bytes"),
        ("raise ValueError('odd \\udc80 \\x1b[31m')\n", r"odd \udc80 \x1b[31m"),
        ("raise ValueError('x' * 3_000_000)\n", "x" * 400),
        ("SHAPES.add('square', 4)\nINTERFACE = 2\n", "is written for interface 2 of plug-ins; this is interface 1"),
        ("SHAPES.add('square', 4)\ndel INTERFACE\n", "its module states no INTERFACE; this is interface 1"),
    ],
)
def test_a_plugin_that_fails_leaves_nothing_but_its_error(
    shapes: Registry[int], tmp_path: Path, code: str, why: str
) -> None:
    found = loaded(tmp_path, bad=REGISTER + code, good=REGISTER + "SHAPES.add('pentagon', 5)\n")
    assert why in (found["bad"].error or "")
    assert len(found["bad"].error or "") <= ERROR_LENGTH + len("line 1: ")
    assert (found["bad"].adds, found["bad"].sha256) == (frozenset(), None)
    assert set(shapes) == {"pentagon", "triangle"}  # and the next one is loaded
    assert "bad" not in sys.modules


@pytest.mark.usefixtures("shapes")
def test_what_a_plugin_prints_leaves_stdout_to_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With --json a program reads stdout."""
    assert loaded(tmp_path, loud=REGISTER + "print('hello')\n")["loud"].error is None
    assert capsys.readouterr() == ("", "hello\n")


@pytest.mark.usefixtures("shapes")
def test_an_interrupt_is_the_users(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        loaded(tmp_path, slow="raise KeyboardInterrupt\n")


def test_of_two_plugins_of_one_name_the_second_is_left_out(
    shapes: Registry[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = installed(tmp_path / "other", {"four": REGISTER + "SHAPES.add('rhombus', 4)\n"}, version="2.0")
    about = (other / "four-2.0.dist-info").rename(other / "other-2.0.dist-info")
    (about / "METADATA").write_text("Metadata-Version: 2.4\nName: other\nVersion: 2.0\n")
    monkeypatch.syspath_prepend(other)
    installed(tmp_path, {"four": REGISTER + "SHAPES.add('square', 4)\n"})
    first, second = [one for one in load([SHAPES]) if not one.ours]
    assert (first.package, second.package) == ("four 1.0", "other 2.0")
    assert second.error == "there is a plug-in of this name already; uninstall one of them"
    assert len(shapes) == 2


def test_one_is_left_out_on_purpose(shapes: Registry[int], tmp_path: Path) -> None:
    code = REGISTER + "SHAPES.add('{}', 4)\n"
    installed(tmp_path, {"one": code.format("square"), "two": code.format("rhombus")})
    load([SHAPES], without=["one"])
    assert set(shapes) == {"rhombus", "triangle"}
    with pytest.raises(InvalidRequest, match=r"there is no plug-in 'tow'; there are .*two"):
        load([SHAPES], without=["tow"])


def test_the_option_is_a_list_or_a_text_and_goes_to_child_processes() -> None:
    assert Options(without_plugins=" two, one").without_plugins == ("one", "two")
    assert Options(without_plugins=("one", "two")).environ()["SCENE_ATTACK_WITHOUT_PLUGINS"] == "one,two"
    assert "SCENE_ATTACK_WITHOUT_PLUGINS" not in Options().environ()


def test_entries_are_in_alphabetical_order_whatever_order_they_came_in() -> None:
    numbers: Registry[int] = Registry("number", [])
    for name in ("two", "one", "three"):
        numbers.add(name, 0)
    assert list(numbers) == ["one", "three", "two"]


def test_a_second_thread_waits_until_all_entries_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first look-up stands still in the middle of the built-in modules while another thread looks an entry up."""
    package = tmp_path / "halfway"
    package.mkdir()
    (package / "__init__.py").write_text("from threading import Event\nbegun, go_on = Event(), Event()\n")
    (package / "one.py").write_text(
        "from halfway import begun, go_on\nfrom halfway.things import THINGS\n"
        "begun.set()\ngo_on.wait(30)\nTHINGS.add('one', 1)\n"
    )
    (package / "things.py").write_text(
        "from scene_attack.plugins import Registry\nTHINGS = Registry('thing', ['halfway.one'])\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from importlib import import_module

    things, halfway = import_module("halfway.things").THINGS, import_module("halfway")
    found: list[int | None] = []
    first = threading.Thread(target=lambda: found.append(things.get("one")))
    second = threading.Thread(target=lambda: found.append(things.get("one")))
    first.start()
    assert halfway.begun.wait(30)
    second.start()
    second.join(0.5)  # it ends at once, without the entry, if it does not wait
    halfway.go_on.set()
    first.join(30)
    second.join(30)
    for name in [name for name in sys.modules if name.partition(".")[0] == "halfway"]:
        del sys.modules[name]
    assert found == [1, 1]
