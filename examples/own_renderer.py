"""A renderer of one's own: a sheet of one colour, which is attacked by the gradient of its image."""

import torch

import scene_attack as sa
from scene_attack.plugin import Declaration, DeclaredRenderer, Group, Plan, register_renderer

COLOUR = Group(name="colour", shape=("3",), unit="displayed value", words="colour of the sheet", suggested_step=0.01)


@register_renderer(Declaration(name="sheet", groups=(COLOUR,), differentiable=True, method="fgsm"))
class Sheet(DeclaredRenderer):
    """The sheet; its parameters {"colour": [B, 3]} give images [B, H, W, 3]. What it draws is exact."""

    size, backend = (32, 32), "sheet"
    plan = property(lambda self: Plan.of(self.name, self.groups, self.size, "exact", []))
    build, exact = classmethod(lambda cls, _: cls()), lambda self: self
    initial = staticmethod(lambda: {"colour": torch.tensor([0.4, 0.5, 0.4])})
    bounds = staticmethod(lambda: {"colour": (torch.zeros(3), torch.ones(3))})

    def render(self, parameters):
        """The sheet in each colour."""
        return parameters["colour"][:, None, None].expand(-1, *self.size, 3)


scene = sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh="primitive/sphere")])
mean, colours = torch.nn.Sequential(torch.nn.AvgPool2d(32), torch.nn.Flatten()), ["red", "green", "blue"]
target = sa.target(mean, labels=colours, preprocessing=sa.Preprocessing(input_size=(32, 32)))
result = sa.attack(sa.renderer(scene, "sheet"), target)
print(f"{result.original.label} → {result.attacked.label}: {result.outcome}")
