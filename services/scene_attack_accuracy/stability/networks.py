"""Scores of a network that is certain, undecided, or has nothing to decide; eight bits of mantissa; seeds at the ends
of their range.
"""

import hashlib
from collections.abc import Callable, Iterator
from decimal import Decimal, localcontext
from math import exp

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError
from torch import Tensor

from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, generator
from scene_attack.attacks.request import LARGEST_SEED, Seed
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.color import as_saved, to_display
from scene_attack.rendering.image import ImageRenderer
from scene_attack.scenes.image_file import to_linear
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.scores import probability
from scene_attack_accuracy.placing import placed, sky
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.objects import SIDE, attacked, linear_network
from scene_attack_accuracy.stability.references import displayed
from scene_attack_accuracy.stability.torch_shading import Shading

ROUNDING = 1e-5
"""Relative error of float32 scores after a few sums."""


def _gradient(goal: ResolvedGoal, logits: Tensor) -> Tensor:
    leaf = logits.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(goal.objective(leaf[None]).sum(), leaf)
    need(bool(torch.isfinite(gradient).all()), "the gradient is not finite")
    return gradient


def _by_hand(logits: Tensor, label: int) -> tuple[list[float], float]:
    """∂ log-odds / ∂z and log(1 − p) of one label, in 60 digits."""
    with localcontext(prec=60):
        z = [Decimal(float(v)) for v in logits]
        top = max(z[k] for k in range(len(z)) if k != label)
        weights = [Decimal(0) if k == label else (v - top).exp() for k, v in enumerate(z)]
        total = sum(weights, Decimal(0))
        gradient = [Decimal(1) if k == label else -w / total for k, w in enumerate(weights)]
        odds = z[label] - (top + total.ln())
        return [float(s) for s in gradient], float(-(1 + odds.exp()).ln())


def _margin(margin: float, reach: bool = False) -> Measured:
    """A label ahead of (or, to be reached, behind) all others by a margin: the gradient neither vanishes nor turns."""
    sign = -1.0 if reach else 1.0
    logits = torch.tensor([0.3, sign * margin, -0.7, -0.1, 0.0])
    goal = ResolvedGoal((), 1) if reach else ResolvedGoal((1,), None)
    gradient, (reference, remainder) = sign * _gradient(goal, logits).double(), _by_hand(logits, 1)
    need(float(gradient[1]) == 1.0, f"the gradient of the label itself is {float(gradient[1]):.1e}")
    p = float(probability(logits[None], 1))
    if not reach and margin < 30:  # beyond, 1 − p is below float64's rounding of p
        need(abs((1 - p) / exp(remainder) - 1) < 1e-5, f"1 − p is {1 - p:.3e}")
    advantage = float(goal.advantage(logits[None]))
    ahead = margin + 0.3 if reach else margin - 0.3
    need(abs(advantage - ahead) < ROUNDING * margin, f"the advantage is {advantage}")
    need(not bool(goal.fooled(logits[None])), "it is fooled")
    error = max(abs(a - b) for a, b in zip(gradient.tolist(), reference, strict=True))
    return Measured(error, ROUNDING, "error of the gradient by each score, against 60 digits")


def _steps_alike(scale: float) -> Measured:
    """FGSM on a network whose scores are scaled up goes the way of the network as it was, step for step."""
    first, second = (_perturbed(linear_network(s, classes=2)) for s in (1.0, scale))
    need(largest(first) > 1e-3, "it does not move")
    return Measured(largest(first - second), 0.0, "largest difference of the perturbations after 5 steps")


def _perturbed(network: Classifier) -> Tensor:
    image = torch.rand(SIDE, SIDE, 3, generator=torch.Generator().manual_seed(5))
    renderer = ImageRenderer(image, "random numbers")
    label = int(network.logits(image[None]).argmax())
    problem = AttackProblem.of(renderer, network, ResolvedGoal((label,), None), Limits.of(renderer, ("image",)))
    settings = FGSM(renderer="image", learning_rate={"image": 1e-4}, truncation=None, steps=5)
    return attacked(problem, settings).stored["image"]


def _tied() -> Measured:
    """The first of two equal scores is the answer, and the gradient is shared between them."""
    logits = torch.tensor([-1.0, 2.5, 2.5, 0.0])
    need(not bool(ResolvedGoal((1,), None).fooled(logits[None])), "the first of two equals is not the answer")
    need(bool(ResolvedGoal((2,), None).fooled(logits[None])), "the second of two equals is the answer")
    need(not bool(ResolvedGoal((), 2).fooled(logits[None])), "a tie reaches the second of two equals")
    need(float(ResolvedGoal((1,), None).advantage(logits[None])) == 0.0, "the advantage is not zero")
    batch = logits.repeat(33, 1)
    need(bool((ResolvedGoal((2,), None).fooled(batch)).all()), "the answer depends on the batch")
    gradient = _gradient(ResolvedGoal((3,), None), logits).double()
    need(float(gradient[1] - gradient[2]) == 0.0, "equal scores have different gradients")
    reference, _ = _by_hand(logits, 3)
    error = max(abs(a - b) for a, b in zip(gradient.tolist(), reference, strict=True))
    return Measured(error, ROUNDING, "error of the gradient by each score, against 60 digits")


def _all_tied() -> Measured:
    """A thousand equal scores."""
    logits = torch.full((1000,), 7.0)
    gradient = _gradient(ResolvedGoal((0,), None), logits).double()
    need(not bool(ResolvedGoal((0,), None).fooled(logits[None])), "the first of equals is not the answer")
    need(abs(float(probability(logits[None], 0)) - 1e-3) < 1e-12, "the probability is not 1/1000")
    return Measured(largest(gradient[1:] + 1 / 999), 1e-8, "error of the gradient, closed form −1/999")


def _two() -> Measured:
    """With two classes the log-odds are the difference of the scores."""
    random = torch.randn(50, 2, generator=torch.Generator().manual_seed(2)) * 100
    goal = ResolvedGoal((0,), None)
    need(bool((goal.fooled(random) == (random[:, 1] > random[:, 0])).all()), "fooled is not z₁ > z₀")
    error = (goal.objective(random) - (random[:, 0] - random[:, 1])).abs().max()
    return Measured(float(error), 0.0, "difference of the objective from z₀ − z₁, closed form")


def _one(ask: Callable[[ResolvedGoal, Tensor], Tensor]) -> Measured:
    """With one class there is no other answer."""
    return Measured(float(ask(ResolvedGoal((0,), None), torch.tensor([[3.0]])).sum()), -1.0, "an answer")


def _attacked(classes: int = 4, bias: float | None = None) -> Measured:
    """An attack on a network of so many classes, whose last bias is another number."""
    network = linear_network(classes=classes)
    if bias is not None:
        network.network.get_parameter("1.bias")[-1] = bias
    return Measured(largest(_perturbed(network)), -1.0, "largest perturbation")


def _large() -> Measured:
    """Scores near the end of float32: sums of their exponentials stay in range."""
    logits = torch.tensor([1e38, -1e38, 0.0])
    gradient = _gradient(ResolvedGoal((0,), None), logits).double()
    need(bool(torch.isfinite(ResolvedGoal((0,), None).objective(logits[None])).all()), "the objective is not finite")
    return Measured(largest(gradient - torch.tensor([1.0, 0.0, -1.0])), 0.0, "error of the gradient, closed form")


def logit_cases() -> Iterator[Case]:
    """The cases of this family."""
    way, none = "the gradient is that of the log-odds", "a clear error names the target"
    stopped = "the job ends, and says that its numbers are not finite"
    nan, inf, target = float("nan"), float("inf"), "target.name"
    yield case("margin of 20", "p = 1 − 2e-9: float32 has lost it", way, _margin, 20.0)
    yield case("margin of 90", "exp(90) overflows float32", way, _margin, 90.0)
    yield case("margin of 1000", "exp(1000) overflows float64", way, _margin, 1000.0)
    yield case("1000 behind", "a label to reach with p = exp(−1000)", way, _margin, 1000.0, reach=True)
    yield case("scores × 1000", "every score saturated", "the same steps as unscaled", _steps_alike, 1000.0)
    yield case("scores × 1e-6", "hardly any gradient", "the same steps as unscaled", _steps_alike, 1e-6)
    yield case("scores of ±1e38", "the end of float32", way, _large)
    yield case("two tied", "no first answer", "the first of equals is the answer, in any batch", _tied)
    yield case("1000 tied", "no first answer", "the first of equals is the answer", _all_tied)
    yield case("two classes", "one other answer", "log-odds are z₀ − z₁", _two)
    yield case("one class, its gradient", "no other answer", none, _one, ResolvedGoal.objective, refusal=target)
    yield case("one class, its advantage", "no other answer", none, _one, ResolvedGoal.advantage, refusal=target)
    yield case("one class, attacked", "no other answer", none, _attacked, 1, refusal=target)
    yield case("NaN score", "not a number", stopped, _attacked, bias=nan, refusal="non-finite")
    yield case("infinite score", "not a number", stopped, _attacked, bias=inf, refusal="non-finite")


def _parameters() -> Measured:
    """Parameters in bfloat16 are those numbers, no worse: the image is computed in the renderer's own type."""
    shading = Shading.of(placed(radiance=sky()))
    short = {g: shading.renderer.initial()[g].to(torch.bfloat16) for g in shading.renderer.plan.groups}
    image = shading.renderer.render({g: v[None] for g, v in short.items()})
    need(image.dtype == torch.float32, f"the image is {image.dtype}")
    errors = shading.errors(short)
    return errors.within(shading.due)


def _image() -> Measured:
    """An image in bfloat16 is saved as the 8 bits nearest to what it holds."""
    values = torch.linspace(0, 1, 4096).to(torch.bfloat16)
    reference = torch.from_numpy(np.rint(values.double().numpy() * 255) / 255)
    shown = ImageRenderer(values.reshape(64, 64, 1).expand(-1, -1, 3), "numbers").initial()["image"]
    need(shown.dtype == torch.float32, f"the image is {shown.dtype}")
    return Measured(largest(as_saved(values).double() - reference), 1e-7, "difference from rounding in float64")


def _curve() -> Measured:
    """The display curve, its inverse and its derivative by the standard's formula, in both types, ends included."""
    linear = np.concatenate([np.linspace(-0.5, 1.5, 4001), [0.0, 1.0, 0.0031308, 1e-7]])
    reference = displayed(linear)
    worst = 0.0
    for dtype in (torch.float32, torch.float64):
        values = torch.from_numpy(linear).to(dtype).requires_grad_(True)
        shown = to_display(values)
        (gradient,) = torch.autograd.grad(shown.sum(), values)
        worst = max(worst, largest(shown.detach().double().numpy() - reference))
        inside = (linear > 1e-5) & (linear < 1 - 1e-5) & (np.abs(linear - 0.0031308) > 1e-5)
        steep = (displayed(linear[inside] + 1e-6) - displayed(linear[inside] - 1e-6)) / 2e-6
        worst = max(worst, 0.1 * largest(gradient.double().numpy()[inside] / steep - 1))
        need(not bool(gradient[(values < 0) | (values > 1)].any()), "what is clipped has a gradient")
    worst = max(worst, largest(to_linear(reference) - np.clip(linear, 0, 1)))
    # Float32 has 1e-7, three times over; the standard's constants meet at the knee to 3e-8.
    return Measured(worst, 5e-7, "error of displayed and linear values, and a tenth of the gradient's relative one")


def _scores() -> Measured:
    """Log-odds of bfloat16 scores lose nothing more: sums of exponentials are not taken in bfloat16."""
    scores = torch.randn(20, 1000, generator=torch.Generator().manual_seed(4)).to(torch.bfloat16)
    goal = ResolvedGoal((7,), None)
    reference, objective = goal.objective(scores.double()), goal.objective(scores)
    error = largest(objective.double() - reference) / largest(reference)
    return Measured(error, 1e-6, "relative error of the log-odds, against float64")


def _network() -> Measured:
    """A network in bfloat16 hands out float32 scores, as close as its own type allows."""
    images = torch.rand(8, SIDE, SIDE, 3, generator=torch.Generator().manual_seed(6))
    short, long = (linear_network(dtype=t).logits(images) for t in (torch.bfloat16, torch.float64))
    need(short.dtype == torch.float32, f"the scores are {short.dtype}")
    error = float((short.double() - long.double()).abs().max() / long.abs().max())
    # Weights and pixels rounded to 8 bits of mantissa, 192 products that err at random, and the score itself.
    return Measured(error, 2 * 2.0**-8, "error of a score relative to the largest, against float64")


def _seeds() -> Measured:
    """Streams at the ends of the range are reproducible, different, and depend on the seed's every bit."""
    ends = (0, 1, LARGEST_SEED - 1, LARGEST_SEED)
    first, second = ([torch.rand(8, generator=generator(seed, "zoo", 3)) for seed in ends] for _ in range(2))
    need(all(torch.equal(a, b) for a, b in zip(first, second, strict=True)), "the same seed gives other numbers")
    different = min(largest(a - b) for i, a in enumerate(first) for b in first[:i])
    need(different > 1e-3, "two seeds give the same numbers")
    text = hashlib.sha256(f"{LARGEST_SEED}/zoo/3".encode()).digest()
    again = torch.rand(8, generator=torch.Generator().manual_seed(int.from_bytes(text[:8], "big") % 2**63))
    return Measured(largest(again - first[3]), 0.0, "difference from the stream derived by hand")


def _refused(seed: int) -> Measured:
    try:
        TypeAdapter(Seed).validate_python(seed)
    except ValidationError as error:
        raise InvalidRequest("seed", error.errors()[0]["msg"]) from error
    return Measured(float(seed), -1.0, "the seed")


def precision_cases() -> Iterator[Case]:
    """The cases of this family."""
    refused = "a clear error names the field"
    yield case("bf16 parameters", "8 bits of mantissa", "shaded in float32", _parameters)
    yield case("display curve", "from −0.5 to 1.5", "the standard's formula, there and back", _curve)
    yield case("bf16 image", "8 bits of mantissa", "the nearest of 256 values", _image)
    yield case("bf16 scores", "a sum of 1,000 exponentials", "log-odds as of float64", _scores)
    yield case("bf16 network", "8 bits of mantissa", "float32 scores, as close as bf16 allows", _network)
    yield case("seeds 0 and 2⁶³ − 1", "the ends of the range", "reproducible, and all different", _seeds)
    yield case("seed −1", "below the range", refused, _refused, -1, refusal="seed")
    yield case("seed 2⁶³", "above the range", refused, _refused, 2**63, refusal="seed")
