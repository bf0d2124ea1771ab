"""What the differentiable renderer promises as a renderer: batches, groups, shapes, names and memory."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from scene_attack.errors import InvalidRequest
from tests.unit.rendering.shading import sky
from tests.unit.rendering.torch.spheres import GROUPS, TIGHT, moved, sphere

pytestmark = pytest.mark.slow


def test_images_of_a_batch_do_not_meet() -> None:
    """To the last bit, images and gradients."""
    renderer = sphere((20, 20), TIGHT, sky(16, 32))
    batch = {g: v.requires_grad_() for g, v in moved(renderer, batch=3).items()}
    images = renderer.render(batch)
    together = torch.autograd.grad(images.square().sum(), list(batch.values()))
    for b in (2, 0, 1):
        alone = {g: v[b : b + 1].detach().clone().requires_grad_() for g, v in batch.items()}
        image = renderer.render(alone)
        assert torch.equal(image[0], images[b])
        for one, all_ in zip(torch.autograd.grad(image.square().sum(), list(alone.values())), together, strict=True):
            assert torch.equal(one[0], all_[b])


def test_groups_left_out_keep_their_values() -> None:
    renderer = sphere()
    start = {g: v[None] for g, v in renderer.initial().items()}
    whole = renderer.render(start)
    assert whole.shape == (1, 12, 12, 3)
    assert torch.equal(renderer.render({}), whole)
    for group in GROUPS:
        assert torch.equal(renderer.render({group: start[group]}), whole)


def test_wrong_shapes_are_refused() -> None:
    renderer = sphere()
    start = renderer.initial()
    with pytest.raises(ValueError, match="normals"):
        renderer.render({"normals": start["normals"]})
    with pytest.raises(ValueError, match="colour"):
        renderer.render({"colour": torch.zeros(1, 3)})
    with pytest.raises(ValueError, match="batch"):
        renderer.render({g: v.expand(k + 1, *v.shape) for k, (g, v) in enumerate(start.items())})


def test_description_of_the_groups() -> None:
    renderer = sphere(tolerance=TIGHT)
    initial, bounds = renderer.initial(), renderer.bounds()
    assert tuple(initial) == renderer.groups == (*GROUPS, "shape", "translation", "rotation", "camera")
    assert {g: tuple(v.shape) for g, v in initial.items()} == {
        "normals": (12, 12, 2),
        "illumination": (4, 8),
        "illumination_rgb": (4, 8, 3),
        "material": (2, 3, 3, 2, 6),
        "bump": (2, 23, 23, 23),
        "dials": (2, 5),
        "shape": (2, 23, 23, 23, 3),
        "paint": (2, 23, 23, 23, 3),
        "lamp": (7,),
        "translation": (2, 3),
        "rotation": (2, 3),
        "camera": (4,),
    }
    for group, value in initial.items():
        low, high = bounds[group]
        assert ((value >= low) & (value <= high)).all(), group
        assert (low + torch.zeros_like(value)).shape == value.shape
    assert bounds["illumination"][0] == 0
    assert torch.equal(bounds["illumination_rgb"][0][..., 0], -initial["illumination"])
    names = renderer.names("material")
    assert names is not None
    assert len(set(names)) == initial["material"].numel()
    flat = initial["material"].flatten()
    assert float(flat[names.index("object 1 blue lobe 0 gamma 5")]) == float(initial["material"][1, 2, 0, 1, 5])
    assert renderer.names("normals") is renderer.names("illumination") is None
    assert all(word in renderer.backend for word in ("torch", "float32", "threads", "closed form"))


def test_initial_values_are_copies() -> None:
    renderer = sphere()
    renderer.initial()["illumination"].zero_()
    assert renderer.initial()["illumination"].sum() > 0


def test_unknown_preset_names_its_field() -> None:
    with pytest.raises(InvalidRequest) as refused:
        sphere(materials=("matte", "velvet"))
    assert refused.value.field == "scene.objects.1.material"


MEMORY = """
import services  # sets up OpenMP before torch
import re, torch
from pathlib import Path
torch.set_num_threads(2)
from scene_attack.rendering.torch.renderer import TorchRenderer
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene
scene = sphere_scene((448, 448), sky(16, 32), ("plastic",))
gbuffer = sphere_gbuffer(scene, radius=0.62)
assert 55_000 < int((gbuffer.coverage > 0).sum()) < 65_000
renderer = TorchRenderer(scene, gbuffer)
leaves = {g: v[None].clone().requires_grad_() for g, v in renderer.initial().items() if g in renderer.plan.groups}
renderer.render(leaves).sum().backward()
# not getrusage: its maximum is the parent's where that is larger
print(1024 * int(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]))
"""


def test_memory() -> None:
    """60k pixels, 512 directions, forward and backward: 1.5 GB, where one shot takes over 4."""
    root = Path(__file__).parents[4]
    done = subprocess.run([sys.executable, "-c", MEMORY], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 1.5e9
