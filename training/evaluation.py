"""Held-out accuracy: views by the project's own renderers, intervals, and errors clustered by model."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import safetensors.numpy
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from services import disk
from services.rendering.color import to_bytes
from services.rendering.factory import build
from services.scenes.description import Camera, Scene, SceneObject
from services.scenes.furniture import PREFIX
from services.scenes.library import Library
from services.scenes.resolve import resolve
from training.batches import normalised
from training.views import INPUT, paper_cameras

RENDERERS = ("torch", "pyrender")
SIZE = 224
"""Side of the held-out views, pixels; a network resizes them to its input, as a target does."""
VIEWS = 6
"""Views of a model by each renderer, at the paper's elevation and distance, all around."""
AT_ONCE = 48


@dataclass(frozen=True)
class Images:
    """Held-out views: uint8 [N, SIZE, SIZE, 3], and of each its class, its model (by number) and its renderer."""

    images: Tensor
    classes: Tensor
    models: Tensor
    renderers: Tensor


def held_out(
    library: Library, models: Sequence[tuple[int, str]], folder: Path, said: Callable[[str, int, int], None]
) -> Images:
    """Returns the exact renderers' views of models (class, slug) in the default scene, to 8 bits; kept in `folder`."""
    model_images, classes, numbers, renderers = [], [], [], []
    for number, (kind, slug) in enumerate(models):
        images = _of_model(library, PREFIX + slug, folder)
        said("rendering held-out models", number + 1, len(models))
        model_images.append(images)
        classes += [kind] * len(images)
        numbers += [number] * len(images)
        renderers += [renderer for renderer in range(len(RENDERERS)) for _ in range(VIEWS)]
    return Images(torch.cat(model_images), torch.tensor(classes), torch.tensor(numbers), torch.tensor(renderers))


@torch.no_grad()
def answers(network: nn.Module, images: Images) -> Tensor:
    """Returns the network's answers, int64 [N]."""
    network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    batches = []
    for part in torch.split(images.images, AT_ONCE):
        x = normalised(part.permute(0, 3, 1, 2).float() / 255)
        x = F.interpolate(x, (INPUT, INPUT), mode="bilinear", antialias=True)
        batches.append(network(x.contiguous(memory_format=torch.channels_last)).argmax(1))
    return torch.cat(batches)


def clustered_error(right: Tensor, models: Tensor) -> float:
    """Returns the standard error of the mean of `right` [N], whose values are independent between models only.

    The sum over models of squared sums of residuals, with the factor m / (m − 1) of m clusters (Liang and Zeger 1986).
    """
    residuals = right.double() - right.double().mean()
    count = int(models.max()) + 1
    sums = torch.zeros(count, dtype=torch.float64).index_add_(0, models, residuals)
    return float((sums.square().sum() * count / max(1, count - 1)).sqrt() / len(right))


def confusion(answered: Tensor, truth: Tensor, classes: int) -> list[list[int]]:
    """Returns counts by true class (row) and answer (column)."""
    return torch.bincount(truth * classes + answered, minlength=classes**2).reshape(classes, classes).tolist()


def _of_model(library: Library, mesh: str, folder: Path) -> Tensor:
    cameras = [Camera(azimuth=camera.azimuth, size=(SIZE, SIZE)) for camera in paper_cameras(VIEWS, SIZE)]
    scenes = [Scene(objects=(SceneObject(mesh=mesh),), camera=camera) for camera in cameras]
    named = json.dumps([1, RENDERERS, [scene.model_dump(mode="json") for scene in scenes]])
    path = folder / f"{hashlib.sha256(named.encode()).hexdigest()[:32]}.safetensors"
    if not path.exists():
        images = []
        for renderer in RENDERERS:
            for scene in scenes:
                built = build(resolve(scene, library), renderer, tolerance="exact")
                images.append(to_bytes(built.exact().render({}))[0])
        disk.write(path, safetensors.numpy.save({"images": torch.stack(images).cpu().numpy()}))
    return torch.from_numpy(safetensors.numpy.load_file(path)["images"])
