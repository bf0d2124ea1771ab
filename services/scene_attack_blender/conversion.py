"""The process that converts a file to glTF: `python -m scene_attack_blender.conversion <file> <folder>`. It writes
`scene.glb` into the folder, and `notes.json`: {"missing": what the file has and the scene has not, "error": why there
is no scene, or null, "unconfined": why it could have read other files, or null}.

The file may be anybody's. None of its scripts is run, and files outside its own folder are not read where the kernel
can refuse it: what refers to them is missing.
"""

import json
import sys
from pathlib import Path

from scene_attack.confinement import die_with_parent, forbid_files

SYSTEM = ("/usr", "/lib", "/lib64")
"""Folders of libraries, which Blender and the modules of its exporter load."""
SCENE, NOTES = "scene.glb", "notes.json"
"""The files that are written."""


def confine(file: Path, folder: Path) -> str | None:
    """Refuses this process all files but those beside `file`, those in `folder` and the programs' own. Returns why the
    kernel cannot, or None.
    """
    programs = {*SYSTEM, sys.base_prefix, sys.prefix, *sys.path}
    try:
        forbid_files([*(Path(name) for name in programs if Path(name).is_dir()), file.parent], [folder])
    except OSError as error:
        return str(error)
    return None


def main(file: Path, folder: Path) -> None:
    """Confines the process, and converts the file."""
    unconfined = confine(file, folder)
    # Landlock confines this thread and those that it starts from now on; Blender starts threads when it is imported.
    from scene_attack_blender.scene_to_gltf import convert

    missing, error = [], None
    try:
        missing = convert(file, folder / SCENE)
    except Exception as raised:  # whatever Blender's own code raises at a file that is not as it expects
        lines = [line for line in str(raised).splitlines() if line.strip() and not line.startswith("Location: ")]
        words = lines[-1] if lines and "Traceback" in lines[0] else " ".join(lines)
        error = " ".join(words.removeprefix("Error: ").split()) or type(raised).__name__
    notes = {"missing": missing, "error": error, "unconfined": unconfined}
    (folder / NOTES).write_text(json.dumps(notes), "utf-8")


if __name__ == "__main__":
    die_with_parent()
    main(Path(sys.argv[1]), Path(sys.argv[2]))
