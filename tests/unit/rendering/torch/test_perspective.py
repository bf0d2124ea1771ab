"""The sum with a viewer of its own for every pixel, against a loop over its terms, and against the distant viewer."""

from math import acos, log

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from scene_attack.rendering.plan import Tolerance
from scene_attack.rendering.torch import dsbrdf, shading
from scene_attack.rendering.torch.dsbrdf import COSINE_FLOOR
from scene_attack.rendering.torch.renderer import TorchRenderer, viewers_of
from scene_attack.rendering.torch.shading import Directions, Lobes, perspective_radiance
from scene_attack.scenes.description import Camera, Scene, SceneObject
from tests.unit.rendering.shading import reference_brdf, sky, sphere_gbuffer, sphere_scene
from tests.unit.rendering.shapes import placed

pytestmark = pytest.mark.usefixtures("kernel")


def inputs(pixels: int = 9, directions: int = 7, channels: int = 3, log_kappa: float = -1.0) -> list[Tensor]:
    random = torch.Generator().manual_seed(0)

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=random)

    forward = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    normals, viewers = (
        normalize(0.5 * noise(pixels, 3) + forward, dim=-1),
        normalize(0.3 * noise(pixels, 3) + forward, dim=-1),
    )
    material = noise(channels, 3, 2, 6)
    material[:, :, 0] += log_kappa
    return [
        normals,
        viewers,
        noise(3, directions).exp(),
        material,
        normalize(noise(directions, 3), dim=-1).T.contiguous(),
    ]


def reference(normals: Tensor, viewers: Tensor, light: Tensor, material: Tensor, towards: Tensor) -> np.ndarray:
    n, v, power, coefficients, w = (value.numpy() for value in (normals, viewers, light, material, towards))
    result = np.zeros((len(n), 3))
    for p in range(len(n)):
        for d in range(w.shape[1]):
            cosine = n[p] @ w[:, d]
            if cosine <= 0:
                continue
            half = (v[p] + w[:, d]) / np.linalg.norm(v[p] + w[:, d])
            theta_h, theta_d = acos(min(1.0, max(COSINE_FLOOR, n[p] @ half))), acos(min(1.0, half @ w[:, d]))
            for c in range(3):
                rho = reference_brdf(coefficients[min(c, len(coefficients) - 1)], theta_h, theta_d)
                result[p, c] += rho * power[c, d] * cosine
    return result


@pytest.mark.parametrize("channels", [1, 3])
def test_the_sum_is_what_it_is_defined_as(channels: int) -> None:
    values = inputs(channels=channels)
    wanted = reference(*values)
    assert wanted.max() > 1
    np.testing.assert_allclose(perspective_radiance(*values).numpy(), wanted, rtol=1e-10)
    np.testing.assert_allclose(perspective_radiance(*(value.float() for value in values)).numpy(), wanted, rtol=1e-4)


@pytest.mark.parametrize("channels", [1, 3])
def test_gradcheck(channels: int) -> None:
    normals, viewers, light, material, towards = inputs(channels=channels, log_kappa=0.5)
    size = perspective_radiance(normals, viewers, light, material, towards).abs().max()

    def scaled(n: Tensor, power: Tensor, m: Tensor) -> Tensor:
        return perspective_radiance(normalize(n, dim=-1), viewers, power, m, towards) / size

    leaves = [value.requires_grad_() for value in (normals, light, material)]
    assert torch.autograd.gradcheck(scaled, leaves)


def test_one_viewer_for_all_is_the_distant_viewer() -> None:
    normals, _, light, material, towards = inputs(pixels=1100, directions=20)
    viewer = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    half, theta_d = dsbrdf.half_vectors(towards.T, viewer)
    log_kappa, gamma = dsbrdf.lobes(material, dsbrdf.basis(theta_d))
    flat = torch.zeros(3, 20, dtype=torch.float64)
    wanted = shading.radiance(normals, light, Lobes(flat, flat, log_kappa, gamma), Directions.of(towards.T, half))
    found = perspective_radiance(normals, viewer.expand(1100, 3), light, material, towards)
    torch.testing.assert_close(found, wanted, rtol=1e-11, atol=1e-13)


def test_the_ends_of_the_angles() -> None:
    """Light from the viewer (θ_d = 0), from straight behind (θ_d = π/2, no half vector) and beside it."""
    eps = 1e-9
    viewers = torch.tensor([[0.0, 0.0, 1.0]] * 2, dtype=torch.float64)
    towards = torch.tensor([[0.0, 0, 1], [0, 0, -1], [eps, 0, 1], [1, 0, -eps]], dtype=torch.float64)
    towards = normalize(towards, dim=-1).T.contiguous()
    normals = normalize(torch.tensor([[0.0, 0, 1], [1, 0, -1]], dtype=torch.float64), dim=-1)
    material = inputs()[3]
    light = torch.ones(3, 4, dtype=torch.float64)
    leaves = [normals.requires_grad_(), light.requires_grad_(), material.requires_grad_()]
    shaded = perspective_radiance(normals, viewers, light, material, towards)
    assert all(bool(g.isfinite().all()) for g in torch.autograd.grad(shaded.sum(), leaves))
    straight = perspective_radiance(normals[:1], viewers[:1], light[:, :1], material, towards[:, :1]).detach()
    wanted = sum(float(material[0, l, 0, 0].detach().exp().exp()) - 1 for l in range(3))
    assert float(straight[0, 0]) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("which", [0, 1])
def test_a_curve_at_its_end_has_no_slope(which: int) -> None:
    normals, viewers, light, material, towards = inputs()
    material[:, 1, which] = (log(1e4), log(1e5))[which] + 1
    material.requires_grad_()
    slope = torch.autograd.grad(perspective_radiance(normals, viewers, light, material, towards).sum(), material)[0]
    assert (slope[:, 1, which] == 0).all()
    assert (slope[:, 0] != 0).any()


def seen(viewer: str, distance: float, field_of_view: float, tolerance: Tolerance = "exact") -> TorchRenderer:
    scene = sphere_scene((48, 48), sky(8, 16), ("glossy-paint",))
    camera = Camera(size=(48, 48), distance=distance, field_of_view=field_of_view, viewer=viewer)
    scene = placed(scene.description.model_copy(update={"camera": camera}), *scene.meshes)
    object.__setattr__(scene, "environment", sky(8, 16))
    return TorchRenderer(scene, sphere_gbuffer(scene, albedo=(0.3, 0.25, 0.2)), tolerance=tolerance)


def test_from_far_away_the_two_viewers_are_one() -> None:
    """The difference falls with the angle of view, and is not small near by."""
    differences = [
        float((seen("distant", d, 2 / d).render({}) - seen("perspective", d, 2 / d).render({})).abs().max())
        for d in (2.0, 20.0, 100.0)
    ]
    assert differences[0] > 0.02
    assert differences[0] > 4 * differences[1] > 16 * differences[2]


def test_the_corners_see_the_camera_along_the_frustums_edges() -> None:
    scene = placed(
        Scene(camera=Camera(size=(20, 40), field_of_view=1.0), objects=(SceneObject(mesh="primitive/sphere"),))
    )
    viewers = viewers_of(scene, (20, 40)).reshape(20, 40, 3)
    up = np.tan(0.5) * 19 / 20  # the middle of the outermost pixel
    right = 2 * np.tan(0.5) * 39 / 40
    for row, column, x, y in ((0, 0, right, -up), (0, 39, -right, -up), (19, 0, right, up)):
        wanted = np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])
        np.testing.assert_allclose(viewers[row, column].numpy(), wanted, rtol=1e-6)


def test_float32_within_its_estimate() -> None:
    renderer = seen("perspective", 2.0, 1.0, 1e-3)
    start = {g: v[None] for g, v in renderer.initial().items() if g in renderer.plan.groups}
    exact = renderer.exact().render({g: v.double() for g, v in start.items()})
    assert float((renderer.render(start).double() - exact).abs().max()) <= renderer.plan.error <= 1e-3
    assert "near" in renderer.plan.stages[0].why
