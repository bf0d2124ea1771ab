"""Images as displayed: exposure, the display curve, the ground behind silhouettes, and rounding to 8 bits."""

import numpy as np
import pytest
import torch

from scene_attack.rendering.color import as_saved, to_display
from scene_attack.rendering.pyrender.parameters import ENERGY
from scene_attack.rendering.pyrender.renderer import EXPOSURE, PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight
from tests.unit.rendering.pyrender.closed_form import ambient_coat, body_and_coat, plane
from tests.unit.rendering.shapes import mesh, placed, quad, scene, sphere


@pytest.mark.parametrize("delta", [1e-3, 1e-3 / ENERGY])
def test_float_images_follow_the_derivative_in_energy_and_eight_bits_do_not(delta: float) -> None:
    """d image / d energy is exact: radiance is linear in energy, and the derivative of the display curve is known."""
    dim = Lights(ambient=0.3, points=(PointLight(energy=5.0, position=(0.5, 0.8, 1.4)),))
    description = scene((48, 64), lights=dim, azimuth=0.4, elevation=0.3)
    points, normal, eye = plane(description)
    body, coat = body_and_coat(points, normal, eye, dim.points[0].position)
    color = np.array([0.2, 0.5, 0.8])
    derivative = ENERGY * EXPOSURE * (body[..., None] * color + coat[..., None])
    ambient = 0.3 * (color + ambient_coat(normal, points, eye)[..., None])
    linear = EXPOSURE * ambient + derivative * 5 / ENERGY
    assert (linear < 1).all()  # not clipped anywhere
    assert (linear > 0.0031308).all()  # on the power branch of the curve
    exact = derivative * 1.055 / 2.4 * linear ** (1 / 2.4 - 1)

    renderer = PyrenderRenderer(placed(description, mesh(quad(9.0, color=(*color, 1)))))
    step = torch.zeros(5, dtype=torch.float64)
    step[1] = delta
    start = renderer.initial()["illumination"]
    up, down = renderer.render({"illumination": torch.stack([start + step, start - step])})

    def error(difference: torch.Tensor) -> float:
        return float(np.linalg.norm(difference.double().numpy() / (2 * delta) - exact) / np.linalg.norm(exact))

    assert error(up - down) < 0.01
    assert error(as_saved(up) - as_saved(down)) > 0.5  # after rounding to 8 bits the change is lost


def test_the_image_is_displayed_radiance_over_the_displayed_ground() -> None:
    description = scene((48, 48)).model_copy(update={"ground": (0.2, 0.4, 0.6)})
    renderer = PyrenderRenderer(placed(description, mesh(sphere(0.5, color=(0.5, 0.4, 0.3, 1)))))
    radiance, image = renderer.radiance({})[0], renderer.render({})[0]
    coverage = radiance[..., 3:]
    surface = to_display(EXPOSURE * radiance[..., :3] / coverage.clamp_min(1e-6))
    ground = torch.tensor([0.2, 0.4, 0.6])
    torch.testing.assert_close(image, coverage * surface + (1 - coverage) * ground, rtol=0, atol=1e-6)
    assert torch.equal(image[0, 0], ground)
    assert ((coverage > 0) & (coverage < 1)).sum() > 50  # silhouettes are anti-aliased
    assert image.dtype == torch.float32
    assert image.min() >= 0
    assert image.max() <= 1


def test_the_default_light_exposes_white_and_grey_well() -> None:
    for color, low, high in ((1.0, 0.6, 0.97), (0.2, 0.3, 0.7)):
        description = scene((96, 96), azimuth=0.61, elevation=0.35)
        renderer = PyrenderRenderer(placed(description, mesh(sphere(0.5, color=(color,) * 3 + (1,)))))
        image, coverage = renderer.render({})[0, ..., 0], renderer.radiance({})[0, ..., 3]
        inside = image[coverage == 1]
        assert low < inside.mean() < high
        assert (inside == 1).float().mean() < 0.1
