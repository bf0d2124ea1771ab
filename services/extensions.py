"""Registers attacks, renderers and targets, from built-in modules or from files that an operator names.

A registry imports the built-in modules of its package by itself. `load` runs an operator's files; a file that fails
registers nothing, and its error is reported.
"""

import re
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from importlib.resources import files
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

Entry = TypeVar("Entry")

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_NUMBERS = count()
_REGISTERS = re.compile(r"^@?register\(", re.MULTILINE)


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Entries by name, in alphabetical order.

    At the first look-up the built-in modules are imported: those of `package` in whose text a line begins with
    `register(` or `@register(`. The text is searched so that the package's other modules, and torch with them, need not
    be imported to list the entries.
    """

    def __init__(self, kind: str, package: str) -> None:
        self.kind = kind
        self._package = package
        self._entries: dict[str, Entry] = {}
        self._complete = False

    def add(self, name: str, entry: Entry) -> None:
        """Adds an entry. Raises ValueError for a name that is taken, or that is not made of a-z, 0-9, - and _."""
        if not NAME.fullmatch(name):
            raise ValueError(f"{name!r} is no name for a {self.kind}: use a-z, 0-9, - and _")
        if name in self._entries:
            raise ValueError(f"there is a {self.kind} {name!r} already; choose another name")
        self._entries[name] = entry

    def __getitem__(self, name: str) -> Entry:
        self._find()
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        self._find()
        return iter(sorted(self._entries))

    def __len__(self) -> int:
        self._find()
        return len(self._entries)

    def snapshot(self) -> dict[str, Entry]:
        """Returns a copy of the entries, for `restore`."""
        self._find()
        return dict(self._entries)

    def restore(self, entries: dict[str, Entry]) -> None:
        """Resets the entries to those of a `snapshot`."""
        self._entries = dict(entries)

    def _find(self) -> None:
        if self._complete:
            return
        self._complete = True
        root = Path(str(files(self._package)))
        for path in sorted(root.rglob("*.py")):
            if _REGISTERS.search(path.read_text("utf-8")):
                import_module(".".join([self._package, *path.relative_to(root).with_suffix("").parts]))


@dataclass(frozen=True)
class Extension:
    """A file named by SCENE_ATTACK_EXTENSIONS, as it was loaded."""

    path: Path
    sha256: str | None
    """SHA-256 (hex) of the bytes that were run; None for a file that cannot be read."""
    adds: frozenset[tuple[str, str]] = frozenset()
    """Kind and name of what it registered: ("renderer", "tint")."""
    error: str | None = None
    """The error because of which it was not loaded; None if it was loaded."""


def load(paths: Sequence[Path], registries: Sequence[Registry[Any]]) -> tuple[Extension, ...]:
    """Runs each file, and each .py file of each folder but those whose name begins with "_", in alphabetical order.

    If a file fails, its registrations are undone, so that it is loaded completely or not at all.
    """
    return tuple(_load(file, registries) for path in paths for file in _files(path))


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.glob("*.py") if not file.name.startswith("_")) if path.is_dir() else [path]


def _load(path: Path, registries: Sequence[Registry[Any]]) -> Extension:
    before = [registry.snapshot() for registry in registries]
    try:
        data = path.read_bytes()
    except OSError as error:
        return Extension(path, None, error=f"it cannot be read: {error.strerror}")
    digest = sha256(data).hexdigest()
    module = ModuleType(f"scene_attack_extension_{next(_NUMBERS)}_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # pydantic and dataclasses look up the module of a class
    try:
        with redirect_stdout(sys.stderr):  # stdout is the command's: with --json it is read by a program
            exec(compile(data, str(path), "exec", dont_inherit=True), module.__dict__)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit among them
        del sys.modules[module.__name__]
        for registry, entries in zip(registries, before, strict=True):
            registry.restore(entries)
        return Extension(path, digest, error=_error_line(error, path))
    adds = {(r.kind, name) for r, entries in zip(registries, before, strict=True) for name in r if name not in entries}
    return Extension(path, digest, frozenset(adds))


def _error_line(error: BaseException, path: Path) -> str:
    """Returns the error as a single line, with the line number of the file that raised it."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    where = f"line {lines[-1]}: " if lines else ""
    return f"{where}{in_words(error)}"


def in_words(error: BaseException) -> str:
    """Returns the type and the message of any error as a single line."""
    try:
        message = " ".join(str(error).split())
    except Exception:  # an extension's own class of error, and its own mistake
        message = "its message cannot be read"
    return f"{type(error).__name__}: {message}"
