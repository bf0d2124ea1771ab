"""Whole jobs of scenes with a background: their images are rendered again to the bit, with what is known behind."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from safetensors.torch import load_file

from scene_attack.rendering.pyrender.parameters import SceneParameters
from scene_attack.runs.execute import execute
from scene_attack.runs.replay import replay
from scene_attack.scenes.resolve import resolve
from tests.unit.jobs.small import LIBRARY, spec
from tests.unit.scenes.test_background import picture

pytestmark = pytest.mark.slow

MAP: dict[str, Any] = {}
PICTURE = {"image": picture()}
SCENE = {"objects": [{"mesh": "primitive/sphere", "scale": 0.5}]}
LIGHT = {"renderer": "torch", "groups": ["illumination"], "learning_rate": {"illumination": 0.5}}
VIEW = {"renderer": "pyrender", "groups": ["camera", "color"], "method": "cma-es", "steps": 6}


@pytest.mark.parametrize("background", [MAP, PICTURE], ids=["map", "picture"])
@pytest.mark.parametrize("attack", [LIGHT, VIEW], ids=["torch", "pyrender"])
def test_the_attacked_image_is_rendered_again_with_what_is_behind_it(
    attack: dict[str, Any], background: dict[str, Any], tmp_path: Path
) -> None:
    request = spec(attack, scene=SCENE | {"background": background})
    result = execute(request, tmp_path, LIBRARY)
    again = replay(tmp_path, LIBRARY)
    assert again.same_backend
    assert again.pixels_differing == 0
    assert again.replayed == result.attacked
    assert any("studio" in line for line in result.provenance.credits) == (background is MAP or attack is LIGHT)

    scene = resolve(request.scene, LIBRARY)
    before, after = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("original", "attacked"))
    assert (before != after).any()
    edge = np.rint(255 * scene.ground)[0]  # the first row shows no object
    assert (before[0] == edge).all()
    if attack is VIEW and background is MAP:
        numbers = SceneParameters(scene)
        camera = numbers.initial()["camera"] + load_file(tmp_path / "perturbation.safetensors")["camera"]
        moved = scene.ground_from(numbers.view(camera.numpy()).clip_from_world)
        assert np.abs(after[0] - np.rint(255 * moved)[0]).max() <= 1
        assert np.abs(after[0] - edge).max() > 1
    else:
        assert (after[0] == edge).all()
