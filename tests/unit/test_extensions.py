"""Registries and files that add to them, with a registry of the test's own."""

import hashlib
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from scene_attack import extensions
from scene_attack.errors import ERROR_LENGTH
from scene_attack.extensions import Extension, Registry, load

SHAPES: Registry[int] = Registry("shape", "scene_attack.targets")
REGISTER = "from tests.unit.test_extensions import SHAPES\n"


@pytest.fixture
def shapes() -> Iterator[Registry[int]]:
    # The module that files import is another object than this one where pytest imports by path.
    sys.modules["tests.unit.test_extensions"] = sys.modules[__name__]
    SHAPES.restore({"triangle": 3})
    yield SHAPES
    SHAPES.restore({})


def loaded(folder: Path, **files: str) -> dict[str, Extension]:
    for name, code in files.items():
        (folder / f"{name}.py").write_text(code)
    return {one.path.stem: one for one in load([folder], [SHAPES])}


def test_a_file_registers_by_running(shapes: Registry[int], tmp_path: Path) -> None:
    code = REGISTER + "SHAPES.add('square', 4)\n"
    found = loaded(tmp_path, four=code)["four"]
    assert shapes["square"] == 4
    assert found.adds == {("shape", "square")}
    assert found.error is None
    assert found.sha256 == hashlib.sha256(code.encode()).hexdigest()


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("SHAPES.add('square', 4)\nraise OSError('no disk')\n", "line 3: OSError: no disk"),
        ("SHAPES.add('square', 4)\nSHAPES.add('triangle', 3)\n", "there is a shape 'triangle' already"),
        ("SHAPES.add('square', 4)\nimport sys\nsys.exit(3)\n", "SystemExit: 3"),
        ("SHAPES.add('square', 4)\nSHAPES.add('no spaces', 4)\n", "'no spaces' is no name for a shape"),
        ("SHAPES.add('square', 4)\nx = = 1\n", "SyntaxError"),
        ("SHAPES.add('square', 4)\nimport a_module_that_is_not_there\n", "ModuleNotFoundError"),
        ("SHAPES.add('square', 4)\nraise BaseException('odd')\n", "line 3: BaseException: odd"),
        (
            "SHAPES.add('square', 4)\nclass Odd(Exception):\n    def __str__(self): raise ValueError\nraise Odd\n",
            "line 5: Odd: its message cannot be read",
        ),
        ("SHAPES.add('square', 4)\ndef f(): f()\nf()\n", "RecursionError"),
        ("SHAPES.add('square', 4)\n\0\n", "null bytes"),
        ("raise ValueError('odd \\udc80 \\x1b[31m')\n", r"odd \udc80 \x1b[31m"),
        ("raise ValueError('x' * 3_000_000)\n", "x" * 400),
    ],
)
def test_a_file_that_fails_leaves_nothing_but_its_error(
    shapes: Registry[int], tmp_path: Path, code: str, why: str
) -> None:
    found = loaded(tmp_path, bad=REGISTER + code, good=REGISTER + "SHAPES.add('pentagon', 5)\n")
    assert why in (found["bad"].error or "")
    assert found["bad"].adds == frozenset()
    assert set(shapes) == {"pentagon", "triangle"}  # and the next file is loaded
    assert not any(name.endswith("_bad") for name in sys.modules)


@pytest.mark.usefixtures("shapes")
def test_what_a_file_prints_leaves_stdout_to_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With --json a program reads stdout."""
    assert loaded(tmp_path, loud="print('hello')\n")["loud"].error is None
    assert capsys.readouterr() == ("", "hello\n")


@pytest.mark.usefixtures("shapes")
def test_a_file_that_is_not_utf_8_is_left_out_and_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "latin.py").write_bytes(b'name = "\xff"\n')
    (tmp_path / "link.py").symlink_to(tmp_path / "outside")
    (tmp_path / "outside").write_text(REGISTER + "SHAPES.add('square', 4)\n")
    (tmp_path / "dangling.py").symlink_to(tmp_path / "nowhere")
    found = loaded(tmp_path)
    assert "'utf-8' codec" in (found["latin"].error or "")
    assert found["link"].adds == {("shape", "square")}
    assert "No such file" in (found["dangling"].error or "")


@pytest.mark.usefixtures("shapes")
def test_an_error_and_a_name_can_be_printed_and_put_into_json(tmp_path: Path) -> None:
    """A message of any length and bytes: `/readyz` answered 500 for these, so that the service was never ready."""
    code = b"raise ValueError('\\udc80' * 9_999_999)\n"
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.py")).write_bytes(code)
    [found] = load([tmp_path], [SHAPES])
    assert found.name == r"\udcff.py"
    assert "\\udc80" in (found.error or "")
    assert len(found.error or "") <= ERROR_LENGTH + len("line 1: ")
    f"{found.name}{found.error}".encode()


@pytest.mark.usefixtures("shapes")
@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("~nobody-of-this-name/x", "home directory"),
        ("a" * 5000, "File name too long"),
        ("pipe.py", "no regular file"),
        ("folder/", "no regular file"),
    ],
)
def test_a_path_that_cannot_be_read_is_left_out(path: str, why: str, tmp_path: Path) -> None:
    """Reading a pipe never ends, and the other errors ended the process."""
    os.mkfifo(tmp_path / "pipe.py")
    (tmp_path / "folder" / "inner.py").mkdir(parents=True)
    [found] = load([Path(path) if path.startswith("~") else tmp_path / path], [SHAPES])
    assert why in (found.error or "")
    assert found.sha256 is None


@pytest.mark.usefixtures("shapes")
def test_an_interrupt_is_the_users(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        loaded(tmp_path, slow="raise KeyboardInterrupt\n")


def test_the_same_file_twice_is_left_out_the_second_time(shapes: Registry[int], tmp_path: Path) -> None:
    file = tmp_path / "four.py"
    file.write_text(REGISTER + "SHAPES.add('square', 4)\n")
    first, second = load([file, file], [SHAPES])
    assert first.error is None
    assert "'square' already" in (second.error or "")
    assert shapes["square"] == 4


def test_files_of_a_folder_come_in_order_and_underscores_are_skipped(tmp_path: Path) -> None:
    found = loaded(tmp_path, b="", a="", _helper="raise OSError", c="")
    assert list(found) == ["a", "b", "c"]
    assert all(one.error is None for one in found.values())


def test_a_path_where_nothing_is_has_an_error(tmp_path: Path) -> None:
    [found] = load([tmp_path / "none.py"], [SHAPES])
    assert (found.sha256, found.adds) == (None, frozenset())
    assert "No such file" in (found.error or "")


def test_entries_are_in_alphabetical_order_whatever_order_they_came_in() -> None:
    numbers: Registry[int] = Registry("number", "scene_attack.targets")
    for name in ("two", "one", "three"):
        numbers.add(name, 0)
    assert list(numbers) == ["one", "three", "two"]


def test_built_in_modules_are_those_that_register(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with a module that registers, one that only mentions it, and one in a folder."""
    package = tmp_path / "built"
    (package / "inner").mkdir(parents=True)
    for folder in (package, package / "inner"):
        (folder / "__init__.py").write_text("")
    (package / "registry.py").write_text(
        "from scene_attack.extensions import Registry\nTHINGS = Registry('thing', 'built')\nregister = THINGS.add\n"
    )
    (package / "one.py").write_text("from built.registry import register\nregister('one', 1)\n")
    (package / "inner" / "two.py").write_text("from built.registry import register\nregister('two', 2)\n")
    (package / "heavy.py").write_text('"""Whoever wants may call register(…)."""\nraise ImportError\n')
    monkeypatch.syspath_prepend(tmp_path)
    from importlib import import_module

    things = import_module("built.registry").THINGS
    assert things.snapshot() == {"one": 1, "two": 2}
    for name in [name for name in sys.modules if name.partition(".")[0] == "built"]:
        del sys.modules[name]


def test_a_second_thread_waits_until_all_entries_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first look-up stands still in the middle of the built-in modules while another thread looks an entry up."""
    package = tmp_path / "halfway"
    package.mkdir()
    (package / "__init__.py").write_text("from threading import Event\nbegun, go_on = Event(), Event()\n")
    (package / "one.py").write_text(
        "from halfway import begun, go_on\nfrom halfway.things import register\n"
        "begun.set()\ngo_on.wait(30)\nregister('one', 1)\n"
    )
    (package / "things.py").write_text(
        "from scene_attack.extensions import Registry\nTHINGS = Registry('thing', 'halfway')\nregister = THINGS.add\n"
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


def test_the_module_under_test_is_the_one_that_is_used() -> None:
    assert extensions.load is load
