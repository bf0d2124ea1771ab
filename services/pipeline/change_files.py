"""Writes what an attack changed: the perturbation, the images before and after it, and images of the parameters."""

from pathlib import Path

from torch import Tensor

from services.analysis import images
from services.analysis.physical import change_images
from services.pipeline.perturbation_file import PERTURBATION, save_perturbation
from services.pipeline.prepare import Prepared
from services.rendering.protocol import Parameters


def save_change(prepared: Prepared, stored: Parameters, attacked: Tensor, out: Path) -> None:
    """Writes the files into the directory `out`. attacked: the exact image of `stored`, uint8 [H, W, 3]."""
    images.save_png(prepared.original, out / "original.png")
    images.save_png(attacked, out / "attacked.png")
    images.save_png(images.magnified(prepared.original, attacked), out / "perturbation.png")
    for name, image in change_images(prepared.renderer, stored).items():
        images.save_png(image, out / name)
    save_perturbation(stored, prepared.renderer, out / PERTURBATION)
