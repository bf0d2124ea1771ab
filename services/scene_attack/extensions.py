"""Registers attacks, renderers and targets, from built-in modules or from files that an operator names.

A registry imports the built-in modules of its package by itself. `load` runs an operator's files; a file that fails
registers nothing, and its error is reported.
"""

import re
import sys
import threading
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

from scene_attack.errors import printable, summary

Entry = TypeVar("Entry")

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_NUMBERS = count()


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Entries by name, in alphabetical order.

    At the first look-up the built-in modules are imported: those of `package` in whose text a line begins with
    `register(` or `@register`, or with another name of the function that registers. The text is searched so that the
    package's other modules, and torch with them, need not be imported to list the entries.
    """

    def __init__(self, kind: str, package: str, function: str = "register") -> None:
        self.kind = kind
        self._package = package
        self._registers = re.compile(rf"^@?{function}(\(|$)", re.MULTILINE)
        self._entries: dict[str, Entry] = {}
        self._complete = False
        self._finding = False
        self._lock = threading.RLock()

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

    def so_far(self) -> dict[str, Entry]:
        """The entries that are registered so far; a module that registers must not import all others for it."""
        return dict(self._entries)

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
        with self._lock:  # another thread waits until all entries are there
            if self._finding:
                return  # a module looks entries up while it is imported
            self._finding = True
            root = Path(str(files(self._package)))
            for path in sorted(root.rglob("*.py")):
                if self._registers.search(path.read_text("utf-8")):
                    import_module(".".join([self._package, *path.relative_to(root).with_suffix("").parts]))
            self._complete = True


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

    @property
    def name(self) -> str:
        """The file's name, without the folder, in characters that can be printed."""
        return printable(self.path.name)


_loaded: list[Extension] = []


def loaded_extensions() -> tuple[Extension, ...]:
    """Returns the files that this process has loaded, each with what it registered or the error it raised."""
    return tuple(_loaded)


def load(paths: Sequence[Path], registries: Sequence[Registry[Any]]) -> tuple[Extension, ...]:
    """Runs each file, and each .py file of each folder but those whose name begins with "_", in alphabetical order.

    If a file fails, its registrations are undone, so that it is loaded completely or not at all.
    """
    extensions: list[Extension] = []
    for path in paths:
        try:
            files = _files(path)
        except (OSError, RuntimeError) as error:  # the latter for the home of a user who does not exist
            extensions.append(Extension(path, None, error=f"it cannot be read: {_reason(error)}"))
        else:
            extensions += [_load(file, registries) for file in files]
    _loaded.extend(extensions)
    return tuple(extensions)


def _files(path: Path) -> list[Path]:
    path = path.expanduser()
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix == ".py" and not file.name.startswith("_"))


def _read(path: Path) -> bytes:
    """Returns the bytes of a regular file; reading a pipe or a device would never end."""
    if path.exists() and not path.is_file():
        raise OSError(None, "it is no regular file")
    return path.read_bytes()


def _reason(error: OSError | RuntimeError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _load(path: Path, registries: Sequence[Registry[Any]]) -> Extension:
    before = [registry.snapshot() for registry in registries]
    try:
        data = _read(path)
    except OSError as error:
        return Extension(path, None, error=f"it cannot be read: {_reason(error)}")
    digest = sha256(data).hexdigest()
    module = ModuleType(f"scene_attack_extension_{next(_NUMBERS)}_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # pydantic and dataclasses look up the module of a class
    try:
        # stdout is the command's: with --json it is read by a program
        with redirect_stdout(sys.stderr):
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
    return (f"line {lines[-1]}: " if lines else "") + summary(error)
