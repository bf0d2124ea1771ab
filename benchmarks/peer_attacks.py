"""Compares FGSM, MI-FGSM, APGD and Square on pixels with Foolbox's and torchattacks'. Writes results/peer_attacks.json.

docs/reports/benchmarks.md says what is compared, and how.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import torch
from torch import Tensor

from benchmarks.peers import Lite0, reach
from benchmarks.report import RESULTS, save
from benchmarks.views import VIEWS
from scene_attack.attacks.attack import ATTACKS, Attack
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, at_random_start, differentiate, evaluate
from scene_attack.attacks.run import AttackRun, Verifier, run_attack
from scene_attack.rendering.color import from_bytes, to_bytes
from scene_attack.rendering.image import ImageRenderer
from scene_attack.runs.environment import options_to_run
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.targets import registry
from scene_attack.targets.protocol import Target

AZIMUTHS = (0.61, -0.61, 1.2)
"""Views of each model, until there are enough that the network gets right."""
SEEDS = (0, 1)
IMAGES = 30
EPSILON, SQUARE_EPSILON = 2, 16
"""ε of the gradient methods and of Square, in 1/255."""
STEPS, QUERIES = 10, 80
"""Steps of APGD, and the most queries of Square."""


@dataclass(frozen=True)
class Case:
    """The 8-bit images [B, H, W, 3], their right labels [B], ε and the networks."""

    saved: Tensor
    labels: Tensor
    epsilon: float
    target: Target
    plain: Lite0

    @property
    def channels_first(self) -> Tensor:
        """The images as the other packages take them, float32 [B, 3, H, W]."""
        return from_bytes(self.saved).permute(0, 3, 1, 2).contiguous()

    def problems(self, loss: str, seed: int) -> list[AttackProblem]:
        """Our problems, one for each image."""
        return [
            AttackProblem.of(
                renderer := ImageRenderer(from_bytes(image), "a file"),
                self.target,
                ResolvedGoal((int(label),), None),
                Limits.of(renderer, ("image",), epsilon={"image": self.epsilon}),
                seed=1000 * seed + index,
                loss=loss,  # type: ignore[arg-type]
            )
            for index, (image, label) in enumerate(zip(self.saved, self.labels, strict=True))
        ]

    def attack(self, name: str, **options: Any) -> Attack:
        """Our attack of this name."""
        request = {"method": name, "renderer": "image", "epsilon": {"image": self.epsilon}} | options
        return ATTACKS[name].model_validate(request)


def ours(case: Case, name: str, steps: int, seed: int | None = None, **options: Any) -> Tensor:
    """All steps of our attack, without ending early. Begins at random if there is a seed, and then keeps the best."""
    images = []
    attack = case.attack(name, steps=steps, **options)
    for candidate in case.problems(options.get("loss", "log-odds"), seed or 0):
        problem = candidate if seed is None else at_random_start(candidate, 1, 0)
        state = attack.init(problem)
        least, best = torch.inf, problem.nothing
        for step in range(steps + 1):
            evaluation = differentiate(problem, evaluate(problem, state["delta"], step, gradient=True))
            objective = float(problem.objective(evaluation.scores))
            if seed is None or objective < least:
                least, best = objective, evaluation.delta
            state = attack.step(problem, state, replace(evaluation, objective=objective))
        images.append(problem.layout.unflatten(problem.initial + best)["image"])
    return to_bytes(torch.stack(images))


def our_square(case: Case, queries: int, seed: int) -> tuple[Tensor, float]:
    """Our Square through the loop, which ends at the first success; the images, and the mean of the queries."""
    attack = case.attack("square", steps=queries)
    runs = [
        run_attack(AttackRun.begin_or_resume(problem, attack, Verifier.of(problem)))
        for problem in case.problems("margin", seed)
    ]
    images = [run.best.saved for run in runs if run.best is not None]
    return torch.stack(images), sum(run.step for run in runs) / len(runs)


def theirs(case: Case, run: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """Another package's attack, which takes images [B, 3, H, W] and labels, rounded to 8 bits [B, H, W, 3]."""
    return to_bytes(run(case.channels_first, case.labels).detach().permute(0, 2, 3, 1))


def torchattacks_square(case: Case, queries: int, seed: int) -> tuple[Tensor, float]:
    """torchattacks' Square and the mean of its queries."""
    import torchattacks

    attack = torchattacks.Square(case.plain, eps=case.epsilon, n_queries=queries, loss="margin")
    attack.init_hyperparam(case.channels_first)
    torch.manual_seed(seed)
    asked, images = attack.attack_single_run(case.channels_first, case.labels)
    return to_bytes(images.permute(0, 2, 3, 1)), float(asked.mean())


def one_step_and_momentum(case: Case, step: float, steps: int) -> dict[str, Tensor]:
    """The methods without random numbers: FGSM of one step, and MI-FGSM."""
    import foolbox
    import torchattacks

    model = foolbox.PyTorchModel(case.plain, bounds=(0, 1), device="cpu")
    fast = foolbox.attacks.LinfFastGradientAttack()
    momentum = foolbox.attacks.LinfMomentumIterativeFastGradientMethod(abs_stepsize=step, steps=steps)
    whole, rate = {"image": case.epsilon}, {"image": step}
    mifgsm = torchattacks.MIFGSM(case.plain, eps=case.epsilon, alpha=step, steps=steps)
    plain: dict[str, Any] = {"truncation": None}
    return {
        "FGSM, ours": ours(case, "fgsm", 1, learning_rate=whole, momentum=0, weight_decay=0, **plain),
        "FGSM, torchattacks": theirs(case, torchattacks.FGSM(case.plain, eps=case.epsilon)),
        "FGSM, Foolbox": theirs(case, lambda x, y: fast(model, x, y, epsilons=case.epsilon)[1]),
        "MI-FGSM, ours": ours(case, "mi-fgsm", steps, learning_rate=rate, **plain),
        "MI-FGSM, torchattacks": theirs(case, mifgsm),
        "MI-FGSM without the norm, Foolbox": theirs(case, lambda x, y: momentum(model, x, y, epsilons=case.epsilon)[1]),
    }


def apgd(case: Case, steps: int) -> dict[str, Tensor]:
    """APGD by cross-entropy and by DLR, from two random starts each."""
    import torchattacks

    images = {}
    for name, ours_by in (("ce", "log-odds"), ("dlr", "dlr")):
        for seed in SEEDS:
            images[f"APGD {name}, ours, seed {seed}"] = ours(case, "apgd", steps, seed, loss=ours_by)
        for seed in SEEDS:
            attack = torchattacks.APGD(case.plain, eps=case.epsilon, steps=steps, loss=name, seed=seed)
            # `best_loss` keeps the best point of each image, as ours does; otherwise it ends at the first success
            run = lambda x, y, attack=attack: attack.perturb(x, y, best_loss=True)[1]  # noqa: E731
            torch.manual_seed(seed)
            images[f"APGD {name}, torchattacks, seed {seed}"] = theirs(case, run)
    return images


def row(name: str, case: Case, images: Tensor, queries: float | None = None) -> dict[str, object]:
    """The network's results on the images, one at a time."""
    logits = torch.stack([case.target.logits(from_bytes(image)[None])[0] for image in images])
    own = logits.gather(1, case.labels[:, None])[:, 0]
    margin = own - logits.scatter(1, case.labels[:, None], -torch.inf).amax(dim=1)
    beyond = (images.int() - case.saved.int()).abs().max().item() - round(255 * case.epsilon)
    assert beyond <= 0, f"{name} is beyond ε by {beyond}/255"
    counts = {"attack": name, "fooled": int((logits.argmax(dim=1) != case.labels).sum()), "of": len(images)}
    return counts | {"margin": float(margin.mean()), "queries": queries}


def right_images(library: Library) -> tuple[Tensor, Tensor, list[str]]:
    """The first IMAGES views that the network gets right: 8-bit images, labels, and the views' names."""
    images, labels, names = [], [], []
    for azimuth, (mesh, _) in product(AZIMUTHS, json.loads(VIEWS.read_text("utf-8"))["views"]):
        scene = {"objects": [{"mesh": mesh}], "camera": {"azimuth": azimuth}}
        prepared = prepare(parse({"scene": scene}), library)
        label = int(prepared.original.logits.argmax())
        if label in prepared.settled.truth:
            images.append(prepared.original.saved)
            labels.append(label)
            names.append(f"{mesh} at {azimuth:g}")
        if len(images) == IMAGES:
            break
    return torch.stack(images), torch.tensor(labels), names


def main() -> None:
    """Runs the comparison; see --help."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    reach()
    settings = options_to_run()
    torch.set_num_threads(settings.threads)
    target, plain = registry.load("efficientnet-lite0"), Lite0(torch.channels_last)
    saved, labels, names = right_images(Library(settings.cache_dir, settings.data_dir))
    case = Case(saved, labels, EPSILON / 255, target, plain)
    wide = replace(case, epsilon=SQUARE_EPSILON / 255)
    attacked = one_step_and_momentum(case, 0.25 * case.epsilon, 8) | apgd(case, STEPS)
    rows = [row("none", case, saved)]
    for name, images in attacked.items():
        rows.append(row(name, case, images))
    for who, square in (("ours", our_square), ("torchattacks", torchattacks_square)):
        for seed in SEEDS:
            rows.append(row(f"Square, {who}, seed {seed}", wide, *square(wide, QUERIES, seed)))
    used = {
        "epsilon": EPSILON, "steps": STEPS, "square epsilon": SQUARE_EPSILON, "queries": QUERIES, "seeds": SEEDS
    }  # fmt: skip
    save(RESULTS / "peer_attacks.json", __doc__ or "", target.backend, SEEDS[0], rows=rows, views=names, settings=used)


if __name__ == "__main__":
    main()
