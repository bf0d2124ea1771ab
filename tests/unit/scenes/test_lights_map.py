"""The map of a scene's own lights: its integrals are the lights' irradiances and the pyrender renderer's ambient."""

import numpy as np
import pytest

from scene_attack.rendering.torch.light import directions, solid_angles
from scene_attack.scenes.description import (
    DirectionalLight,
    Environment,
    Lights,
    PointLight,
    Scene,
    SceneObject,
    SpotLight,
)
from scene_attack.scenes.environment import LIGHTS_ROWS as ROWS
from scene_attack.scenes.environment import lights_map
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve

WAYS = directions(ROWS, 2 * ROWS).numpy()
ANGLES = solid_angles(ROWS, 2 * ROWS).numpy()


def irradiance(lights: Lights, normal: tuple[float, float, float]) -> float:
    radiance = lights_map(lights).radiance.reshape(-1, 3)
    assert (radiance == radiance[:, :1]).all()
    return float((radiance[:, 0] * (WAYS @ normal).clip(min=0) * ANGLES).sum())


def test_ambient_light_is_the_pyrender_renderer_s() -> None:
    """Its Lambertian body reflects ambient · (1 + n.y / 3), so the irradiance is π times that."""
    lights = Lights(ambient=0.4, points=())
    for normal in ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.6, 0.8)):
        assert irradiance(lights, normal) == pytest.approx(0.4 * np.pi * (1 + normal[1] / 3), rel=1e-3)


@pytest.mark.parametrize(
    ("light", "towards", "wanted"),
    [
        ({"points": (PointLight(energy=100, position=(6, 4, 3)),)}, (6, 4, 3), 100 / 61),
        ({"directional": (DirectionalLight(energy=2, direction=(1, -2, 0)),)}, (-1, 2, 0), 2.0),
        ({"spots": (SpotLight(energy=9, position=(0, 3, 0), direction=(0, -1, 0)),)}, (0, 1, 0), 1.0),
        ({"spots": (SpotLight(energy=9, position=(0, 3, 0), direction=(0, 1, 0)),)}, (0, 1, 0), 0.0),
        ({"points": (PointLight(energy=9, position=(0, 0, 0)),)}, (0, 1, 0), 0.0),
    ],
)
def test_a_light_gives_its_irradiance_from_its_direction(light, towards, wanted) -> None:
    normal = np.array(towards) / np.linalg.norm(towards)
    lights = Lights(ambient=0.0, **({"points": ()} | light))
    # A spot of 8.6° has a mean cosine of 1 - 0.15².
    assert irradiance(lights, tuple(normal)) == pytest.approx(wanted * (1 - 0.15**2), rel=2e-3, abs=1e-9)
    radiance = lights_map(lights).radiance[..., 0]
    if wanted:
        assert WAYS[radiance.argmax()] @ normal > np.cos(np.pi / ROWS)


def test_a_scene_names_it_and_its_digest_follows_the_lights(library: Library) -> None:
    scenes = [
        Scene(
            objects=(SceneObject(mesh="primitive/cube"),),
            lights=Lights(points=(PointLight(energy=energy),), environment=Environment(map="lights", size=(8, 16))),
        )
        for energy in (30.0, 31.0)
    ]
    found = [resolve(scene, library) for scene in scenes]
    assert found[0].sha256 != found[1].sha256
    assert found[0].environment.shape == (8, 16, 3)
    assert found[0].map_credit is None
    assert found[0].environment.max() < found[1].environment.max()
