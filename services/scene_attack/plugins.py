"""Registries of attacks, renderers, targets and the like, and the plug-ins that add to them.

A plug-in is an installed package with an entry point of the group `scene_attack.plugins`: its name, and a module that
registers what it adds when it is imported. The module states the version of the interface it is written for,
`INTERFACE = 1`. A plug-in that fails registers nothing, and its error is reported.
"""

import re
import sys
import threading
import traceback
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar

from scene_attack.errors import InvalidRequest, printable, summary
from scene_attack.text import there_are

Entry = TypeVar("Entry")

GROUP = "scene_attack.plugins"
INTERFACE = 1
"""The version of `scene_attack.plugin`. It rises when a plug-in that was right before is wrong."""
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_OURS = "scene-attack"


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Entries by name, in alphabetical order.

    `built_in` are the modules, of this package, that register our own entries; they are imported at the first look-up.
    """

    def __init__(self, kind: str, built_in: Sequence[str]) -> None:
        self.kind = kind
        self._built_in = tuple(built_in)
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
            for module in self._built_in:
                import_module(module)
            self._complete = True


@dataclass(frozen=True)
class Plugin:
    """A plug-in, as it was found among the installed packages."""

    name: str
    """The name of its entry point, in characters that can be printed."""
    package: str
    """Name and version of its package, such as "simba 0.1.0"."""
    ours: bool
    """Whether it comes with scene-attack."""
    sha256: str | None = None
    """SHA-256 (hex) of its module's file; None for one that was left out."""
    adds: frozenset[tuple[str, str]] = frozenset()
    """Kind and name of what it registered: ("renderer", "tint")."""
    error: str | None = None
    """The error because of which it was left out; None if it was loaded."""

    @property
    def registered(self) -> list[str]:
        """What it adds in words, such as "renderer tint", in alphabetical order."""
        return sorted(f"{kind} {name}" for kind, name in self.adds)


_loaded: list[Plugin] = []


def loaded_plugins() -> tuple[Plugin, ...]:
    """The plug-ins that this process has loaded, each with what it registered or the error it raised."""
    return tuple(_loaded)


def load(registries: Sequence[Registry[Any]], without: Collection[str] = ()) -> tuple[Plugin, ...]:
    """Imports the modules of all plug-ins, in the order of their names, but of those in `without`.

    If one fails, its registrations are undone, so that it is loaded completely or not at all. Raises
    InvalidRequest("SCENE_ATTACK_WITHOUT_PLUGINS") for one to be left out that there is not.
    """
    found = sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, _package(entry)))
    for name in sorted(without):
        if name not in (entry.name for entry in found):
            known = there_are(name, {entry.name: entry for entry in found})
            raise InvalidRequest("SCENE_ATTACK_WITHOUT_PLUGINS", f"there is no plug-in {name!r}; {known}")
    plugins: list[Plugin] = []
    for entry in found:
        if entry.name not in without:
            plugins.append(_load(entry, registries, taken=any(one.name == entry.name for one in plugins)))
    _loaded.extend(plugins)
    return tuple(plugins)


def _load(entry: EntryPoint, registries: Sequence[Registry[Any]], taken: bool) -> Plugin:
    package, ours = _package(entry), entry.dist is not None and entry.dist.name == _OURS
    name = printable(entry.name)
    if taken:
        return Plugin(name, package, ours, error="there is a plug-in of this name already; uninstall one of them")
    before = [registry.snapshot() for registry in registries]
    known = set(sys.modules)
    try:
        # stdout is the command's: with --json it is read by a program
        with redirect_stdout(sys.stderr):
            module = entry.load()
        asked = getattr(module, "INTERFACE", None)
        if asked != INTERFACE:
            states = "states no INTERFACE" if asked is None else f"is written for interface {asked!r} of plug-ins"
            raise _OtherInterfaceError(f"its module {states}; this is interface {INTERFACE}")
        digest = sha256(Path(module.__file__).read_bytes()).hexdigest()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit among them
        for imported in set(sys.modules) - known:
            if imported.partition(".")[0] == entry.module.partition(".")[0]:
                del sys.modules[imported]
        for registry, entries in zip(registries, before, strict=True):
            registry.restore(entries)
        return Plugin(name, package, ours, error=_error_line(error, entry.module))
    adds = {(r.kind, name) for r, entries in zip(registries, before, strict=True) for name in r if name not in entries}
    return Plugin(name, package, ours, digest, frozenset(adds))


class _OtherInterfaceError(Exception):
    """A plug-in is written for another version of the interface."""


def _package(entry: EntryPoint) -> str:
    return "" if entry.dist is None else printable(f"{entry.dist.name} {entry.dist.version}")


def _error_line(error: BaseException, module: str) -> str:
    """Returns the error as a single line, with the line number of the module that raised it."""
    if isinstance(error, _OtherInterfaceError):
        return str(error)
    file = f"{module.rpartition('.')[2]}.py"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).name == file]
    return (f"line {lines[-1]}: " if lines else "") + summary(error)
