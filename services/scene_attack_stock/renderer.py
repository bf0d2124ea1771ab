"""The renderer `stock-pyrender`: each image is a glTF file of the scene, drawn in a process of its own."""

import os
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch import Tensor

from scene_attack.errors import JobFailure
from scene_attack.export.glb import scene_glb
from scene_attack.export.scene_values import scene_values
from scene_attack.process import program
from scene_attack.rendering.declaration import RENDERERS, BuildRequest
from scene_attack.rendering.opengl.context import choose_platform
from scene_attack.rendering.plan import Item, Plan
from scene_attack.rendering.pyrender.parameters import SceneParameters, SceneRenderer
from scene_attack.scenes.resolve import ResolvedScene

SECONDS_PER_IMAGE = 60.0
"""Longest time that an image may take."""


class StockPyrender(SceneRenderer):
    """Images of a scene's exports, with the groups of pyrender.

    What the export cannot say to other programs is missing: the light from all around is the same from everywhere,
    there are no shadows, and surfaces are glTF's. pyrender's own output is of 8 bits, by a display curve of 1 / 2.2, so
    differences of less than a step of it are lost.
    """

    declaration = RENDERERS.so_far()["stock-pyrender"]

    def __init__(self, scene: ResolvedScene, groups: tuple[str, ...]) -> None:
        self._scene, self._numbers = scene, SceneParameters(scene)
        self.size = scene.description.camera.size
        names = ("trimesh", "pyrender-maintained", "PyOpenGL")
        self.backend = f"stock pyrender by {choose_platform()}, {', '.join(f'{n} {version(n)}' for n in names)}"
        missing = Item(
            what="export",
            kept=1,
            of=1,
            why="the scene's glTF file, without shadows and without what pyrender's loader leaves out",
        )
        self.plan = Plan.of(self.name, groups, self.size, "exact", [missing])

    @classmethod
    def build(cls, request: BuildRequest) -> "StockPyrender":
        """The renderer of a scene."""
        return cls(request.scene, request.groups)

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Images float32 [B, H, W, 3] in [0,1], multiples of 1/255; `parameters` {group: [B, ...]}.

        Raises JobFailure if the process fails or takes too long, and as `SceneParameters.checked` does.
        """
        self._numbers.checked(parameters)
        initial, count = self.initial(), len(next(iter(parameters.values()))) if parameters else 1
        with TemporaryDirectory() as folder:
            for k in range(count):
                change = {group: values[k].double() - initial[group] for group, values in parameters.items()}
                file = scene_glb(self._scene, scene_values(self._scene, change), lit_by_map=False)
                Path(folder, f"{k}.glb").write_bytes(file)
            _draw(folder, count)
            images = [np.load(Path(folder, f"{k}.npy")) for k in range(count)]
        return torch.from_numpy(np.stack(images)).float() / 255

    def exact(self) -> "StockPyrender":
        """Returns itself: nothing is approximated."""
        return self


def _draw(folder: str, count: int) -> None:
    """Has the files k.glb of a folder drawn, each to k.npy: uint8 [H, W, 3]."""
    try:
        done = subprocess.run(
            program("scene_attack_stock.draw", folder, str(count)),
            env=os.environ | {"PYOPENGL_PLATFORM": choose_platform(), "PYGLET_HEADLESS": "true"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=SECONDS_PER_IMAGE * count,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        detail = f"stock pyrender took more than {error.timeout:g} seconds, and was ended"
        raise JobFailure("timeout", detail) from error
    if done.returncode != 0:
        last = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise JobFailure("internal", f"stock pyrender ended with code {done.returncode}: {last}")
