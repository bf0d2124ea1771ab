"""Renderers whose images are not what they should be."""

import torch

from services.accuracy.stability import attacks, geometry, meshes, torch_shading

BUILDERS = (torch_shading, geometry, attacks, meshes)
"""Modules that make renderers."""


class Damaged:
    """A renderer whose images go through `change`(image, parameters)."""

    def __init__(self, renderer, change) -> None:
        self._renderer, self._change = renderer, change

    def __getattr__(self, name):
        return getattr(self._renderer, name)

    def render(self, parameters):
        return self._change(self._renderer.render(parameters), parameters)

    def exact(self):
        return Damaged(self._renderer.exact(), self._change)


def images(change):
    """Breaks every renderer that a case makes."""

    def apply(patch) -> None:
        for module in BUILDERS:
            true = module.build
            patch.setattr(module, "build", lambda *given, true=true, **named: Damaged(true(*given, **named), change))

    return apply


lighter_images = images(lambda image, _: (image + 0.01).clamp_max(1))
moved_by_parameters = images(lambda image, given: image + 1e-3 * sum(bool(v.abs().max() > 50) for v in given.values()))
eight_bit_images = images(
    lambda image, given: image.bfloat16().float() if any(v.dtype == torch.bfloat16 for v in given.values()) else image
)


grainy_images = images(lambda image, _: image if image.shape[1] == 64 else image + 0.01)
