"""Compares the camera with its counterparts in nrtk, setting by setting. Writes results/sensor.json.

Both take the same image, a furniture model drawn by pyrender at 224², of 8 bits. A row has the differences of displayed
values, in 1/255: the mean and the largest over the image, and beside them what the setting itself changes in the mean.
The noise is compared by its standard deviation on even images.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.peers import reach
from benchmarks.report import RESULTS, save
from scene_attack.rendering.color import from_bytes, to_bytes
from scene_attack.rendering.factory import build
from scene_attack.rendering.sensor.photograph import photographed
from scene_attack.rendering.sensor.settings import PLAIN, Sensor
from scene_attack.runs.environment import options_to_run
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve

Bytes = NDArray[np.uint8]
LEVELS = (0.1, 0.25, 0.5, 0.75, 0.9)
"""Displayed values of the even images."""


def main() -> None:
    """Writes the result; see the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mesh", default="furniture/drill")
    parser.add_argument("--out", type=Path, default=RESULTS / "sensor.json")
    options = parser.parse_args()
    reach()
    import cv2
    from nrtk.impls.perturb_image._albumentations.albumentations_perturber import AlbumentationsPerturber
    from nrtk.impls.perturb_image.photometric.enhance import BrightnessPerturber, SharpnessPerturber
    from nrtk.impls.perturb_image.photometric.noise import GaussianNoisePerturber

    image, backend = picture(options.mesh)

    def albumentations(name: str, **parameters: Any) -> Bytes:
        taken, _ = AlbumentationsPerturber(perturber=name, parameters=parameters | {"p": 1.0}).perturb(image=image)
        return np.asarray(taken)

    def rows() -> Iterator[dict[str, Any]]:
        for amount in (0.5, 1.0):
            theirs, _ = SharpnessPerturber(factor=1 + amount).perturb(image=image)
            yield row(image, f"sharpening {amount:g}", Sensor(sharpening=amount), "SharpnessPerturber", theirs)
        for quality in (90, 70, 30):
            theirs = albumentations("ImageCompression", quality_range=(quality, quality))
            yield row(image, f"quality {quality}", Sensor(quality=quality), "ImageCompression", theirs)
        pair = {"downscale": cv2.INTER_AREA, "upscale": cv2.INTER_LINEAR}
        theirs = albumentations("Downscale", scale_range=(0.5, 0.5), interpolation_pair=pair)
        yield row(image, "resolution 0.5", Sensor(resolution=0.5), "Downscale", theirs)
        for radius in (1, 2, 4):
            theirs = albumentations("Defocus", radius=(radius, radius), alias_blur=(0.1, 0.1))
            yield row(image, f"defocus {radius}", Sensor(defocus=radius), "Defocus", theirs)
        theirs = albumentations("MotionBlur", blur_limit=(5, 5), angle_range=(0, 0), allow_shifted=False)
        yield row(image, "motion 5", Sensor(motion=5.0), "MotionBlur", theirs)
        for stops in (-0.5, 0.5):
            theirs, _ = BrightnessPerturber(factor=2**stops).perturb(image=image)
            yield row(image, f"exposure {stops:+g}", Sensor(exposure=stops), "BrightnessPerturber", theirs)

    def noise() -> Iterator[dict[str, Any]]:
        even = {level: np.full((256, 256, 3), round(255 * level), np.uint8) for level in LEVELS}
        ours = {level: deviation(taken(flat, replace(PLAIN, iso=1600.0)), flat) for level, flat in even.items()}
        for level, flat in even.items():
            perturber = GaussianNoisePerturber(mean=0.0, var=(ours[0.5] / 255) ** 2, seed=0)
            yield {"level": level, "ours": ours[level], "theirs": deviation(perturber.perturb(image=flat)[0], flat)}

    about = "the camera's settings against their counterparts in nrtk, in 1/255"
    peers = {name: version(name) for name in ("nrtk", "nrtk-albumentations", "opencv-python-headless", "Pillow")}
    content = {"mesh": options.mesh, "rows": list(rows()), "noise": list(noise()), "peers": peers}
    save(options.out, about, backend, None, **content)


def picture(mesh: str) -> tuple[Bytes, str]:
    """A mesh in the default view, drawn by pyrender: uint8 [224, 224, 3]; and the renderer's backend."""
    options = options_to_run()
    scene = resolve(Scene.model_validate({"objects": [{"mesh": mesh}]}), Library(options.cache_dir, options.data_dir))
    renderer = build(scene, "pyrender", tolerance="exact")
    start = {group: value[None] for group, value in renderer.initial().items()}
    return to_bytes(renderer.render(start)[0]).numpy(), renderer.backend


def taken(image: Bytes, sensor: Sensor) -> Bytes:
    """The image as the camera takes it, rounded to 8 bits."""
    return to_bytes(photographed(from_bytes(torch.from_numpy(image))[None], sensor)[0]).numpy()


def row(image: Bytes, setting: str, sensor: Sensor, peer: str, theirs: Bytes) -> dict[str, Any]:
    """A setting: what it changes, and how far the peer's image is from ours, in 1/255."""
    ours = taken(image, sensor).astype(float)
    apart = np.abs(ours - theirs)
    changed = np.abs(ours - image).mean()
    return {"setting": setting, "peer": peer, "changed": changed, "mean": apart.mean(), "largest": apart.max()}


def deviation(noisy: Bytes, even: Bytes) -> float:
    """Standard deviation of the noise on an even image, in 1/255."""
    return float((noisy.astype(float) - even).std())


if __name__ == "__main__":
    main()
