"""Writes the assets of the package, services/scene_attack/scenes/assets, from those that `assets fetch` brought.

    python scripts/package_assets.py

Prints the lines of `environment.PUBLISHED`. A map's pixels are kept as half floats, in which the published OpenEXR
files were compressed: the script ends with an error if one of them is no half float.
"""

import hashlib
import posixpath
import shutil
import zipfile
from io import BytesIO
from pathlib import Path

import Imath
import numpy as np
import OpenEXR

from scene_attack.options import Options
from scene_attack.scenes.environment import write_npz
from scene_attack.scenes.furniture import Model, archive_of, read_catalogue
from scene_attack.scenes.library import PACKAGED, environment_entry

MODELS = (
    "chair",
    "cocktail-glass",
    "coffee-mug",
    "couch",
    "desk-lamp",
    "drill",
    "filing-cabinet",
    "folding-chair",
    "grand-piano",
    "soccer-ball",
)
"""Those that README, docs, examples and demo name, and a few of other kinds."""
MAPS = ("city", "interior", "studio")
URLS = {
    "CC0 1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC BY 3.0": "https://creativecommons.org/licenses/by/3.0/",
    "CC BY 3.0 US": "https://creativecommons.org/licenses/by/3.0/us/",
}
HEAD = """# Authors and licences

These models and maps are other people's. Each may be passed on under its licence, with its author's name. `licences`
has the statement of each library, and of a model those that lie beside it in its library.

The models are parts of the libraries of Sweet Home 3D in Debian's package sweethome3d-furniture, and unchanged. The
Scopia library asks to name both Emmanuel Puybaret / eTeks <info@eteks.com> and Scopia Visual Interfaces Systems, s.l.
(http://www.scopia.es). The maps are by Greg Zaal (HDRI Haven, https://hdrihaven.com), from Debian's package
blender-data; their pixels are the published ones in another kind of file.

| asset | title | author | licence | from |
|---|---|---|---|---|
"""


def main() -> None:
    """Writes all files anew."""
    cache = Options.of_environment().cache_dir
    catalogue = read_catalogue(cache / "furniture")
    shutil.rmtree(PACKAGED, ignore_errors=True)
    rows = [_model(catalogue[slug]) for slug in MODELS]
    rows += [_map(cache / "environments" / f"{name}.exr") for name in MAPS]
    (PACKAGED / "LICENCES.md").write_text(HEAD + "".join(rows), "utf-8")


def _model(model: Model) -> str:
    _write(f"furniture/{model.slug}.sh3f", archive_of(model))
    folder = posixpath.dirname(model.path) + "/"
    with zipfile.ZipFile(model.archive) as archive:
        _write(f"licences/{model.archive.stem}.txt", archive.read("LICENSE.TXT"))
        for name in archive.namelist():
            if name.startswith(folder) and "license" in name.lower():
                _write(f"licences/{model.slug}{posixpath.splitext(name)[1]}", archive.read(name))
    licence = f"[{model.licence}]({URLS[model.licence]})"
    return f"| furniture/{model.slug} | {model.title} | {model.creator} | {licence} | {model.library} |\n"


def _map(path: Path) -> str:
    data = path.read_bytes()
    planes = OpenEXR.InputFile(BytesIO(data)).channels("RGB", Imath.PixelType(Imath.PixelType.FLOAT))
    pixels = np.stack([np.frombuffer(plane, np.float32).reshape(512, 1024) for plane in planes], axis=-1)
    halves = pixels.astype(np.float16)
    assert (halves == pixels).all(), f"{path} is not of half floats"
    _write(f"environments/{path.stem}.npz", write_npz(halves))
    print(f'    "{hashlib.sha256(halves.tobytes()).hexdigest()[:32]}": "{hashlib.sha256(data).hexdigest()}",')
    entry = environment_entry(path.stem)
    licence = f"[{entry.licence}]({URLS[entry.licence]})"
    return f"| {path.stem} | {entry.title} | {entry.creator} | {licence} | HDRI Haven |\n"


def _write(name: str, data: bytes) -> None:
    path = PACKAGED / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


if __name__ == "__main__":
    main()
