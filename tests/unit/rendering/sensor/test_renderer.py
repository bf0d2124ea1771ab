"""The renderer of photographs, and an attack on a camera's settings from the request to the result."""

from typing import Any

import torch

import scene_attack as sa
from scene_attack.rendering.factory import build
from scene_attack.rendering.sensor.photograph import photographed
from scene_attack.rendering.sensor.renderer import worded
from scene_attack.rendering.sensor.settings import GROUPS, of_shares
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.jobs.small import LIBRARY


def scene() -> ResolvedScene:
    described = {"camera": {"size": [48, 64]}, "objects": [{"mesh": "primitive/sphere"}]}
    return resolve(Scene.model_validate(described), LIBRARY)


def test_a_camera_that_changes_nothing_takes_the_base_image_as_it_is_rendered() -> None:
    resolved = scene()
    base = build(resolved, "pyrender", tolerance="exact")
    start = base.render({group: value[None] for group, value in base.initial().items()})
    renderer = build(resolved, "sensor", "pyrender")
    plain = {group: value[None] for group, value in renderer.initial().items()}
    assert torch.equal(renderer.render(plain), start)
    assert torch.equal(renderer.render({}), start)
    blur = torch.tensor([[0.4, 0.2, 0.1], [0.0, 1.0, -1.0]])
    for settings, image in zip(blur, renderer.render({"blur": blur}), strict=True):
        sensor = of_shares(renderer.initial() | {"blur": settings})
        assert torch.equal(image, photographed(start, sensor)[0])


def test_settings_that_change_one_way_start_at_their_bound() -> None:
    renderer = build(scene(), "sensor")
    least = {
        name: float(low)
        for group, (lows, _) in renderer.bounds().items()
        for name, low in zip(renderer.names(group) or [], lows, strict=True)
    }
    assert [name for name, low in least.items() if low == 0] == [
        *("defocus", "motion", "ISO", "sharpening", "resolution", "quality")
    ]


def test_words_name_what_the_camera_does_and_nothing_else() -> None:
    resolved = scene()
    renderer = build(resolved, "sensor")
    change = {"exposure": torch.tensor([-0.5, 0.0, 0.0]), "file": torch.tensor([0.0, 0.5]), "noise": torch.zeros(2)}
    exposure, noise, file = worded(resolved, renderer, change)
    assert exposure.change.sentence == "exposes by −0.5 stops"
    assert noise.change.sentence == "takes the image as it is"
    assert file.change.sentence == "writes a JPEG file of quality 65"
    assert [(size.measure, size.value) for size in file.sizes] == [("quality", -35.0)]


def test_the_first_step_of_every_setting_is_seen_but_that_of_a_path_without_length() -> None:
    """An attack whose first step changes nothing would take the setting for one that does nothing."""
    renderer = build(scene(), "sensor", "pyrender")
    unseen = []
    for group, start in renderer.initial().items():
        steps = 0.05 * torch.eye(len(start))
        images = renderer.render({group: torch.cat([start[None], steps])})
        moved = (images[1:] - images[0]).abs().flatten(1).amax(dim=1)
        unseen += [name for name, most in zip(renderer.names(group) or [], moved, strict=True) if most == 0]
    assert unseen == ["direction"]


def test_an_attack_by_the_camera_is_verified_and_survives_as_many_cameras_each_time() -> None:
    """The natural range needs no U. The survival is that of the stored image, and only cameras that the network has
    right without the attack count."""
    attack = {"renderer": "sensor", "base_renderer": "pyrender", "steps": 25}
    request = sa.Scene.model_validate({"objects": [{"mesh": "furniture/coffee-mug"}]})
    first, second = (
        sa.attack(request, "resnet34-furniture", attack, analysis={"survival": {"draws": 6}}) for _ in range(2)
    )
    assert first.verified
    assert (first.record.verdict, first.record.analyses) == (second.record.verdict, second.record.analyses)
    attacked: Any = first.record.spec["attack"]
    assert (attacked["epsilon"], attacked["truncation"]) == (dict.fromkeys(GROUPS, 1.0), None)
    survival = first.record.analyses.survival
    assert survival is not None
    assert survival.variations == 6
    assert survival.right + round(6 * survival.wrong_share) == 6
    assert survival.fooled <= survival.right
