"""Compares our attack on pixels with Foolbox's and torchattacks', on the same network and images. Writes
results/image_attacks.json.

Time: every attack takes the same number of steps, which are so small that no network is fooled and no attack ends
early, on one image. The other packages take turns, and our attack runs before and after each of their runs, because the
speed of a shared machine changes from second to second. The result gives the shortest time per step, and the median
ratio of each run to ours around it. Success: all attacks have the same step size and bound. The same network
classifies every adversary rounded to 8 bits; p is the mean over the adversaries that fool it. The other packages attack
the network as plain torch provides it (contiguous) and in channels_last; ours attacks the network that jobs use.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.peers import Lite0, reach
from benchmarks.report import RESULTS, save
from benchmarks.views import right
from client.settings import settings_to_run
from services.analysis.perceptibility import of_images
from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.goal import ResolvedGoal
from services.attacks.problem import AttackProblem
from services.attacks.run import Budget, Verifier, run
from services.pipeline.prepare import prepare
from services.pipeline.spec import parse
from services.rendering.color import from_bytes, to_bytes
from services.rendering.image_renderer import ImageRenderer
from services.scenes.library import Library
from services.targets import registry
from services.targets.protocol import Target

BOUND = 18 / 255
STEP = 0.002
"""Of the paper's attack on pixels, section 4.1."""
OURS = "ours, momentum 0.9"
"""The attack that the others are put beside."""
STILL = 1e-9
FORMATS = {"contiguous": torch.contiguous_format, "channels_last": torch.channels_last}


@dataclass
class Images:
    """8-bit images that the network classifies correctly, uint8 [B, H, W, 3], and their labels [B]."""

    saved: Tensor
    labels: Tensor


Attacks = Callable[[Images, float, int], Tensor]
"""From images, step size and number of steps to the adversaries, uint8 [B, H, W, 3]."""


def ours(momentum: float) -> Attacks:
    """FGSM on the renderer `image`, whose only group is the pixels; one image after the other."""
    target = registry.load("efficientnet-lite0")

    def attack(subjects: Images, step: float, steps: int) -> Tensor:
        return torch.stack(
            [
                _attacked(target, image, label, step, steps, momentum)
                for image, label in zip(subjects.saved, subjects.labels, strict=True)
            ]
        )

    return attack


def _attacked(target: Target, saved: Tensor, label: Tensor, step: float, steps: int, momentum: float) -> Tensor:
    chosen = Fgsm(method="fgsm", renderer="image", learning_rate={"image": step}, momentum=momentum)
    renderer = ImageRenderer(from_bytes(saved), "a file")
    problem = AttackProblem(renderer, target, ResolvedGoal((int(label),), None), ("image",), truncation=BOUND)
    return run(problem, FgsmMethod(chosen, problem), Verifier(renderer, target), Budget(steps)).image


def torchattacks(network: Lite0, name: str) -> Attacks:
    """Its BIM or MIFGSM."""
    import torchattacks as library

    def attack(subjects: Images, step: float, steps: int) -> Tensor:
        method = getattr(library, name)(network, eps=BOUND, alpha=step, steps=steps)
        return _bytes(method(_channels_first(subjects), subjects.labels))

    return attack


def foolbox(network: Lite0, name: str) -> Attacks:
    """Its LinfBasicIterativeAttack or LinfMomentumIterativeFastGradientMethod."""
    import foolbox as library

    model = library.PyTorchModel(network, bounds=(0, 1), device="cpu")

    def attack(subjects: Images, step: float, steps: int) -> Tensor:
        method = getattr(library.attacks, name)(abs_stepsize=step, steps=steps, random_start=False)
        _, found, _ = method(model, _channels_first(subjects), subjects.labels, epsilons=BOUND)
        return _bytes(found)

    return attack


def _channels_first(subjects: Images) -> Tensor:
    return from_bytes(subjects.saved).permute(0, 3, 1, 2).contiguous()


def _bytes(images: Tensor) -> Tensor:
    return to_bytes(images.permute(0, 2, 3, 1))


def main() -> None:
    """Runs the comparison; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=8, help="images that are attacked (default 8)")
    parser.add_argument("--steps", type=int, default=20, help="steps that are timed (default 20)")
    parser.add_argument("--repeats", type=int, default=3, help="repeats of the timing (default 3)")
    parser.add_argument("--success-steps", type=int, default=20, help="most steps of an attack (default 20)")
    parser.add_argument("--out", type=Path, default=RESULTS / "image_attacks.json")
    options = parser.parse_args()
    reach()
    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    target = registry.load("efficientnet-lite0")
    subjects, views = _images(Library(settings.cache_dir, settings.data_dir), options.views)
    attacks = {"ours, momentum 0": ours(0.0), OURS: ours(0.9)}
    for format_name, memory_format in FORMATS.items():
        network = Lite0(memory_format)
        for name in ("BIM", "MIFGSM"):
            attacks[f"torchattacks {name}, {format_name}"] = torchattacks(network, name)
        for name in ("LinfBasicIterativeAttack", "LinfMomentumIterativeFastGradientMethod"):
            attacks[f"Foolbox {name}, {format_name}"] = foolbox(network, name)
    timing = _time(attacks, Images(subjects.saved[:1], subjects.labels[:1]), options)
    success = [
        {"attack": name} | _success(target, attack, subjects, options.success_steps) for name, attack in attacks.items()
    ]
    save(
        options.out, __doc__ or "", target.backend, None,
        settings={"bound": BOUND, "step": STEP, "views": views}, timing=timing, success=success,
    )  # fmt: skip
    for row in timing + success:
        print(", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{value}" for key, value in row.items()))


def _images(library: Library, count: int) -> tuple[Images, list[str]]:
    saved, labels, views = [], [], list(right(library, count))
    for mesh, label in views:
        prepared = prepare(parse({"scene": {"objects": [{"mesh": mesh}]}, "goal": {"leave": label}}), library)
        saved.append(prepared.original)
        labels.append(int(prepared.logits.argmax()))
    return Images(torch.stack(saved), torch.tensor(labels)), [mesh for mesh, _ in views]


def _time(attacks: dict[str, Attacks], subjects: Images, options: argparse.Namespace) -> list[dict[str, object]]:
    took: dict[str, list[float]] = {name: [] for name in attacks}
    times: dict[str, list[float]] = {name: [] for name in attacks}

    def timed(name: str) -> float:
        began = time.perf_counter()
        attacks[name](subjects, STILL, options.steps)
        took[name].append((time.perf_counter() - began) / options.steps)
        return took[name][-1]

    for name in attacks:  # warms up
        timed(name)
    for seconds in took.values():
        seconds.clear()
    for _ in range(options.repeats):
        before = timed(OURS)
        for name in (name for name in attacks if name != OURS):
            other, after = timed(name), timed(OURS)
            times[name].append(2 * other / (before + after))
            before = after
    return [
        {
            "attack": name,
            "ms a step": 1e3 * min(seconds),
            "times ours": statistics.median(times[name] or [1.0]),
        }
        for name, seconds in took.items()
    ]


def _success(target: Target, attack: Attacks, subjects: Images, steps: int) -> dict[str, object]:
    found = attack(subjects, STEP, steps)
    answers = torch.stack([target.logits(from_bytes(image)[None])[0] for image in found]).argmax(dim=-1)
    fooled = (answers != subjects.labels).tolist()
    p = [of_images(before, after) for before, after, yes in zip(subjects.saved, found, fooled, strict=True) if yes]
    return {"fooled": sum(fooled), "of": len(fooled), "p": statistics.fmean(p) if p else None}


if __name__ == "__main__":
    main()
