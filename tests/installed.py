"""Plug-ins as packages installed in a folder, without pip: a module, and what its wheel would leave beside it."""

from collections.abc import Mapping
from pathlib import Path

from scene_attack.plugins import GROUP


def installed(folder: Path, modules: Mapping[str, str], version: str = "1.0") -> Path:
    """Writes packages into a folder that is to be on the path, one for each name of an entry point, given its module's
    text. The module is called by the same name with underscores.
    """
    folder.mkdir(exist_ok=True)
    for name, code in modules.items():
        module = name.replace("-", "_")
        (folder / f"{module}.py").write_text(code)
        about = folder / f"{module}-{version}.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\n")
        (about / "entry_points.txt").write_text(f"[{GROUP}]\n{name} = {module}\n")
    return folder
