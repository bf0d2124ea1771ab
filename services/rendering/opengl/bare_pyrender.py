"""pyrender without its front door.

`import pyrender` opens a window toolkit, a graph library and a mesh reader, of which a renderer off screen uses
nothing: most of a second at every start, and libraries that a server has no need of. So the package is entered without
running its __init__; who asks it for one of the names that __init__ brings has it run after all.
"""

import importlib.util
import sys
from types import ModuleType
from typing import Any


class _Package(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or self.__dict__.get("_opened"):
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        self._opened = True
        assert self.__spec__ is not None
        assert self.__spec__.loader is not None
        self.__spec__.loader.exec_module(self)
        return getattr(self, name)


def install() -> None:
    """Call before anything of pyrender is imported; does nothing where it is imported already."""
    if "pyrender" in sys.modules:
        return
    spec = importlib.util.find_spec("pyrender")
    assert spec is not None
    package = _Package("pyrender")
    package.__spec__, package.__path__ = spec, spec.submodule_search_locations or []
    package.__file__, package.__package__, package.__loader__ = spec.origin, "pyrender", spec.loader
    sys.modules["pyrender"] = package
