"""Images of the rasterising renderer with any number of samples a pixel: what multisampling is worth."""

from collections.abc import Mapping

import torch
from torch import Tensor

from services.rendering.opengl import context
from services.rendering.pyrender_renderer.parameters import SceneParameters
from services.scenes.resolve import ResolvedScene


class Sampled:
    """Draws a scene as `PyrenderRenderer.exact()` does, every image by itself, but with `samples` per pixel."""

    def __init__(self, scene: ResolvedScene, samples: int) -> None:
        context.current()
        from services.rendering.opengl.mesh_upload import Drawing

        self._drawing = Drawing(scene.meshes, watertight=True)
        self._numbers = SceneParameters(scene)
        self._size, self._samples = scene.description.camera.size, samples

    def radiance(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """As `PyrenderRenderer.radiance`: float32 [B, H, W, 4] for {group: [B, ...]}."""
        batch = self._numbers.checked(parameters)
        images = []
        for row in range(len(batch["color"])):
            view = self._numbers.view(batch["camera"][row])
            poses = self._numbers.poses(batch["translation"][row], batch["rotation"][row])
            light, color = batch["illumination"][row : row + 1], batch["color"][row : row + 1]
            lit = self._numbers.lit(light, color, view, poses, (0, self._size[0], 0, self._size[1]))
            [image] = context.current().renderer.draw(
                self._drawing,
                "radiance.frag",
                lit.view,
                lit.poses,
                lit.colors,
                lit.uniforms,
                {},
                size=self._size,
                samples=self._samples,
                outputs=1,
                blend=True,
                lights=lit.light_counts,
                backfaces="behind",
            )
            images.append(torch.from_numpy(image).flip(0))
        return torch.stack(images)
